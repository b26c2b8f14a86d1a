"""What the live page costs: processor time of the page and of the graph, watched and unwatched, in turns of one run.

A graph plays a session over and over; the page runs in a process of its own, and a headless Chromium opens and leaves
it. Each turn measures, one after the other: nobody looks; somebody looks; somebody looks at the cameras' pictures, too.
Frames a second are those in which the browser painted the scene, and of these the ones that show somebody in a new
pose: no more than the graph tracks. The browser has no GPU, and its processor time is that of all its processes.
`--before TREE` measures the page of another tree in turns with this one's.

    python bench/page.py SESSION [--turns 3] [--seconds 10] [--rate 0.5] [--before TREE]
"""

from __future__ import annotations

import argparse
import os
import re
import subprocess
import sys
import time
from collections import defaultdict
from contextlib import ExitStack
from pathlib import Path
from statistics import median
from tempfile import TemporaryDirectory

from report import Table, execute, finish, parser

import psutil

from sagoma_tools.graph.ros_link import RosLink
from sagoma_tools.graph.topics import LOSSLESS, PREDICTION_TOPIC, message_class, type_of

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests" / "support"))
from browser import Browser, Painted, browser

PHASES = ("nobody looks", "watched", "with pictures")
SETTLE_S = 2.0  # from a change until it is measured: subscriptions are made and left once a second
WINDOW = 1280, 860
FRAMES_UNTIL_READY = 60  # shaders are compiled, and the canvas has the resolution that the browser can hold
TREE = str(Path(__file__).resolve().parents[1])
TITLES = {
    "page": "page, % of a core",
    "graph": "graph, ms a set",
    "rate": "sets/s",
    "frames": "painted/s",
    "poses": "new poses/s",
    "browser": "browser, %",
    "frame": "ms a frame",
}
COMMAND = [sys.executable, "-m", "sagoma_tools.cli"]


def main() -> None:
    """Measure, and print a table: percent of a core, ms of the graph a frame set, frames a second."""
    given = parser(__doc__)
    given.add_argument("session")
    given.add_argument("--turns", type=int, default=3)
    given.add_argument("--seconds", type=float, default=10.0, help="of each phase")
    given.add_argument("--rate", default="0.5", help="speed of the footage")
    given.add_argument("--before", help="another tree, whose page is measured in turns with this one's")
    args = given.parse_args()
    with TemporaryDirectory() as folder, Started("up", args.session, "--loop", "--rate", args.rate, folder) as graph:
        pages = {f"{Path(tree).name}: " if args.before else "": tree for tree in filter(None, (args.before, TREE))}
        with ExitStack() as stack, Sets() as sets:
            viewers = {name: stack.enter_context(Viewer(tree, args.session, folder)) for name, tree in pages.items()}
            measure(args, graph.process, viewers, sets)


class Viewer:
    """The page of a tree, in a process of its own; address : where it is served."""

    def __init__(self, tree: str, session: str, folder: str) -> None:
        view = ["view", "--port", "0", "--takes", f"{folder}/takes", "--rig", f"{session}/rig.yaml"]
        packages = os.pathsep.join(sorted(str(path) for path in Path(tree, "src").iterdir()))
        environment = {**os.environ, "PYTHONPATH": packages}
        self._popen = subprocess.Popen([*COMMAND, *view], stdout=subprocess.PIPE, text=True, env=environment)

    def __enter__(self) -> Viewer:
        assert self._popen.stdout is not None
        self.address = next(match[1] for line in self._popen.stdout if (match := re.search(r"page: (http\S+)", line)))
        self.process = psutil.Process(self._popen.pid)
        return self

    def __exit__(self, *error: object) -> None:
        self._popen.terminate()
        self._popen.wait()


class Started:
    """A graph of its own processes, ended with the block."""

    def __init__(self, *arguments: str) -> None:
        *command, folder = arguments
        self._command = [*COMMAND, *command, "--run-folder", f"{folder}/run"]

    def __enter__(self) -> Started:
        self.process = psutil.Popen(self._command, stdout=subprocess.DEVNULL)
        return self

    def __exit__(self, *error: object) -> None:
        self.process.terminate()
        self.process.wait()


def measure(args: argparse.Namespace, graph: psutil.Process, viewers: dict[str, Viewer], sets: Sets) -> None:
    """Go through all turns, and print the medians."""
    used: dict[str, list[dict[str, float]]] = defaultdict(list)
    for viewer in viewers.values():
        with browser(*WINDOW) as tab:  # until somebody is tracked
            tab.open(viewer.address)
            tab.wait_for_text("tracking: ")
    for _ in range(args.turns):
        for name, viewer in viewers.items():
            time.sleep(SETTLE_S)
            used[name + PHASES[0]].append(measured(viewer.process, graph, sets, args.seconds, None))
            with browser(*WINDOW) as tab:  # a tab that goes elsewhere keeps its connection for a while
                tab.count_frames()
                for phase in PHASES[1:]:
                    enter(tab, viewer.address, phase)
                    used[name + phase].append(measured(viewer.process, graph, sets, args.seconds, tab))
    table = Table({"phase": "<20", **dict.fromkeys(TITLES.values(), ">18.1f")})
    medians = {phase: {key: median(row[key] for row in rows) for key in TITLES} for phase, rows in used.items()}
    for phase, values in medians.items():
        table.row(phase, *values.values())
    finish(medians)


def enter(tab: Browser, address: str, phase: str) -> None:
    """Open the page, or switch the cameras' pictures on."""
    if phase == PHASES[1]:
        tab.open(address)
        tab.wait_for(f"painted.frames > {FRAMES_UNTIL_READY}")
    else:
        tab.press("Cameras")
        tab.check("pictures")
        tab.wait_for('document.querySelectorAll(\'img[src^="blob:"], img[src^="data:image/jpeg"]\').length > 0')
    time.sleep(SETTLE_S)


def measured(
    viewer: psutil.Process, graph: psutil.Process, sets: Sets, seconds: float, tab: Browser | None
) -> dict[str, float]:
    """Return what :data:`TITLES` names."""
    chromium = psutil.Process(tab.pid) if tab is not None else None

    def used() -> list[float]:
        drawn_s = tree_cpu_s(chromium) if chromium is not None else 0.0
        return [cpu_s(viewer), tree_cpu_s(graph), drawn_s, sets.count, time.monotonic()]

    before = used()
    painted = tab.frames_a_second(seconds) if tab is not None else Painted(0.0, 0.0)
    if tab is None:
        time.sleep(seconds)
    page_s, graph_s, drawn_s, count, wall_s = (b - a for a, b in zip(before, used(), strict=True))
    return {
        "page": 100 * page_s / wall_s,
        "graph": 1e3 * graph_s / max(count, 1),
        "rate": count / wall_s,
        "frames": painted.frames,
        "poses": painted.poses,
        "browser": 100 * drawn_s / wall_s,
        "frame": 1e3 * drawn_s / wall_s / max(painted.frames, 0.1),
    }


class Sets:
    """Counts the frame sets that the graph answers."""

    def __init__(self) -> None:
        self.count = 0
        self._link = RosLink("page_bench")
        kind = message_class(type_of(PREDICTION_TOPIC) or "")
        self._link.node.create_subscription(kind, PREDICTION_TOPIC, self._take, LOSSLESS, raw=True)

    def _take(self, data: bytes) -> None:
        self.count += 1

    def __enter__(self) -> Sets:
        return self

    def __exit__(self, *error: object) -> None:
        self._link.close()


def cpu_s(process: psutil.Process) -> float:
    """Return the processor time of a process so far."""
    times = process.cpu_times()
    return float(times.user + times.system)


def tree_cpu_s(process: psutil.Process) -> float:
    """Return the processor time of a process and of all that it started."""
    return sum(map(cpu_s, [process, *process.children(recursive=True)]))


if __name__ == "__main__":
    execute(main)
