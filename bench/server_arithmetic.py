"""Times the server's arithmetic (hull, ICP, EKF) stage by stage, in turns with another state of the project.

    python bench/server_arithmetic.py [--quick] [--before COMMIT] [SESSION...]

Sessions are folders of the test data (walk_ring5top, charleston_ring5top and zombie_he3 unless given). Their footage is
segmented once, as the camera client does it; the same silhouettes then go through the pipeline of this tree and of
COMMIT (c7539e6 unless given; taken from git into a temporary folder), each in a process of its own, which take turns of
20 sets: what else the machine does falls on both. Times are processor time of one thread; the first 80 sets, in which
code is loaded and the body acquired, do not count. Stages that are due a few times a second (camera faults, extrinsic
monitor, support report) have a mean and almost no median.

Without ROS: no messages, no decoding of masks, no waiting; bench/live.py measures those. The last line is JSON:
server_ms : mean sum of a set over all sessions; before_ms : the same of COMMIT; ratio : before over now;
same_bits : share of the sets whose packets and filtered points are the same bit for bit;
mean_mm, before_mean_mm : mean error of the 15 filtered points, by session.
"""

from __future__ import annotations

import contextlib
import json
import os
import pickle
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from report import Table, execute, finish, parser

import numpy as np
from clips import Clip, session_clip
from scenes import SHARED
from server_arithmetic_worker import Work

from capture_rig.errors import InputError

TREE = Path(__file__).resolve().parents[1]
SESSIONS = ("sessions/walk_ring5top", "sessions/charleston_ring5top", "sessions/zombie_he3")
BEFORE = "c7539e6"
TURN, WARM_UP = 20, 80  # sets
QUICK_SETS = 160


@dataclass
class Runner:
    """One tree's process, and what it answered so far."""

    process: subprocess.Popen[str]
    sets: list[dict[str, Any]] = field(default_factory=list)

    @classmethod
    def start(cls, tree: Path, work: Path) -> Runner:
        """Start the process; it waits for its first turn."""
        paths = os.pathsep.join(str(path) for path in sorted((tree / "src").iterdir()))
        command = [sys.executable, str(TREE / "bench" / "server_arithmetic_worker.py"), str(work)]
        pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE, "text": True}
        return cls(subprocess.Popen(command, env=os.environ | {"PYTHONPATH": paths}, **pipes))  # type: ignore[call-overload]

    def turn(self, sets: int) -> None:
        """Process the next sets. InputError where the tree cannot."""
        assert self.process.stdin and self.process.stdout
        self.process.stdin.write(f"{sets}\n")
        self.process.stdin.flush()
        answer = self.process.stdout.readline()
        if not answer:
            raise InputError("this tree's pipeline cannot be timed; its message is above")
        self.sets += json.loads(answer)

    def end(self) -> None:
        """End the process."""
        assert self.process.stdin
        self.process.stdin.close()
        self.process.wait()

    def ms(self, stage: str) -> np.ndarray:
        """Processor time (n,) of a stage in each set that counts; 0 where it was not due."""
        return np.array([one["ms"].get(stage, 0.0) for one in self.sets[WARM_UP:]])

    def mean_mm(self, truth: np.ndarray) -> float:
        """Mean error of the filtered points."""
        errors = [
            np.linalg.norm(np.array(one["points"]) - truth[frame], axis=1)
            for frame, one in enumerate(self.sets)
            if one["points"] is not None
        ]
        return 1e3 * float(np.nanmean(errors)) if errors else float("nan")


@contextlib.contextmanager
def checked_out(commit: str) -> Iterator[Path]:
    """Put a commit's files into a temporary folder. InputError for a commit that git does not know."""
    with tempfile.TemporaryDirectory() as folder:
        archive = subprocess.run(["git", "-C", TREE, "archive", commit], capture_output=True)
        if archive.returncode:
            raise InputError(archive.stderr.decode().strip(), where=commit, remedy="Give a commit of this repository.")
        subprocess.run(["tar", "-x", "-C", folder], input=archive.stdout, check=True)
        yield Path(folder)


def compare(clip: Clip, folder: Path, sets: int, trees: list[Path]) -> list[Runner]:
    """Process the clip's first sets with each tree, in turns."""
    count = min(len(clip), sets)
    stamps = [clip.stamp_ns(frame) for frame in range(count)]
    settings = {"hull_server.backend": "cpu", **clip.start_from_t_pose}
    with tempfile.NamedTemporaryFile(suffix=".pickle") as file:
        file.write(pickle.dumps(tuple(Work(str(folder), settings, stamps, clip.packed[:count]))))
        file.flush()
        runners = [Runner.start(tree, Path(file.name)) for tree in trees]
        try:
            for first in range(0, count, TURN):
                for runner in runners:
                    runner.turn(min(TURN, count - first))
        finally:
            for runner in runners:
                runner.end()
    return runners


def show(clip: Clip, now: Runner, before: Runner) -> dict[str, float]:
    """Print a session's stages; return its figures."""
    table = Table(
        {"stage": "<24", "median": ">8.2f", "mean": ">8.2f", "before": ">8.2f", "mean ": ">8.2f", "ratio": ">6.2f"},
        f"{clip.name}: {len(clip.rig.names)} cameras, {clip.fps:g} Hz; ms of processor time a set",
    )
    stages = [stage for runner in (now, before) for stage in runner.sets[-1]["ms"]]
    for stage in dict.fromkeys([s for s in stages if s != "sum"] + ["sum"]):
        new, old = now.ms(stage), before.ms(stage)
        ratio = old.mean() / new.mean() if new.mean() > 0.0 else None
        table.row(stage, float(np.median(new)), new.mean(), float(np.median(old)), old.mean(), ratio)
    same = [a["digest"] == b["digest"] for a, b in zip(now.sets, before.sets, strict=True)]
    figures = {"now": now.ms("sum").mean(), "before": before.ms("sum").mean(), "same_bits": float(np.mean(same))}
    figures |= {"mean_mm": now.mean_mm(clip.truth), "before_mean_mm": before.mean_mm(clip.truth)}
    print(
        f"same bits: {figures['same_bits']:.1%} of {len(same)} sets; error {figures['mean_mm']:.2f} mm, "
        f"before {figures['before_mean_mm']:.2f} mm"
    )
    return figures


def main() -> None:
    """Print the tables and the line of JSON."""
    arguments = parser(__doc__, quick=f"the first {QUICK_SETS} sets of a session")
    arguments.add_argument("sessions", nargs="*", default=SESSIONS, metavar="SESSION")
    arguments.add_argument("--before", default=BEFORE, metavar="COMMIT", help=f"compare with this one ({BEFORE})")
    options = arguments.parse_args()
    found = {}
    with checked_out(options.before) as old:
        for name in options.sessions:
            clip = session_clip(SHARED / name, exact=False)
            sets = QUICK_SETS if options.quick else len(clip)
            found[clip.name] = show(clip, *compare(clip, SHARED / name, sets, [TREE, old]))
    now, before, same = (float(np.mean([f[key] for f in found.values()])) for key in ("now", "before", "same_bits"))
    finish(
        {
            "server_ms": round(now, 2),
            "before_ms": round(before, 2),
            "ratio": round(before / now, 2),
            "same_bits": round(same, 4),
            "mean_mm": {name: round(f["mean_mm"], 2) for name, f in found.items()},
            "before_mean_mm": {name: round(f["before_mean_mm"], 2) for name, f in found.items()},
        }
    )


if __name__ == "__main__":
    execute(main)
