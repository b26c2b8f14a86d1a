"""What the live server costs and holds: hull, ICP and EKF nodes fed the silhouettes of several cameras in real time.

    python bench/live.py --quick                     # 6 cameras at 60 Hz, 10 s, this tree and the one before
    python bench/live.py --seconds 60                # the whole minute
    python bench/live.py --hz 100 --cameras 5        # faster
    python bench/live.py --processes three           # a process a node
    python bench/live.py --size 1280x1024            # clients alone: two simulated cameras of that size at 60 Hz
    python bench/live.py --overload                  # twice what it holds, then half: answered, how late, how soon over
    python bench/live.py --scaling                   # in this process, over cameras, voxels, people (live_scaling.py)

A player sends every camera's silhouette and camera_info over loopback, all of an instant at once and stamped then; the
server is what `sagoma up` starts. Beside it the server of an older commit (--before) runs in a domain of its own, and
the two are played to in turns, so that whatever else the machine does hits both. Processor time is the server
processes' own (user and system) over the counted turns; per answered set, as sets that are dropped cost less. Latency
runs from the stamp to the joint state's arrival at a subscriber in another process. Silhouettes: a session of the test
data as camera clients segment it or, where there is none, exact ones of the built-in studio. Last,
camera clients of this tree on simulated GigE cameras (bench/camera.py). --overload looks for what the server holds
first, with a server that thins nothing out: the rate rises by a tenth until sets are dropped or wait. The last line is
JSON: this tree's figures, and those of the older one under "before".
"""

from __future__ import annotations

import argparse
import contextlib
import os
import shutil
import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from report import Table, add_settings, execute, finish, machine_line, parser

import camera
import numpy as np
from clips import Clip, session_clip
from live_scaling import scaling
from live_servers import PROCESSES, TREE, Server, running, tree_of
from scenes import SHARED, studio_clip

from capture_rig import Rig
from sagoma_tools.arguments import parse_settings

SESSION = "walk_ring5top"
BEFORE = "c7539e6"  # three processes, every message converted, before the server was made to hold full rate
STUDIO_S = 4.0
FEWER_CAMERAS = {"hull_server.min_seeing": 4}  # as of all six: with three of five, a ghost stands beside the T-pose
FIRST_DOMAIN = 90  # of the servers; beside another bench, give --domain
CLIENTS, CLIENT_FPS, CLIENT_S = 2, 60.0, 10.0
QUICK_S, QUICK_TURNS = 10.0, 2
FIRST_HZ, STEP = 45.0, 1.1
SETTLE_S, TRY_S = 1.5, 2.5
HELD_SHARE, HELD_P95_MS = 0.99, 100.0  # answered, and within this, at a rate that is held
OVERLOAD_S, LOW_S = 15.0, 6.0


@dataclass(frozen=True)
class Figures:
    """All turns of one server together; ms and Hz as in the JSON line, ``dropped`` the sets never answered."""

    server_ms_per_set: float
    hz_sent: float
    hz_sustained: float
    latency_p50_ms: float
    latency_p95_ms: float
    sent: int
    answered: int
    tracked: int
    incomplete: int
    dropped: int

    @classmethod
    def of(cls, turns: Sequence[dict[str, Any]]) -> Figures:
        """From the fields of `live_player.Turn`."""
        total = {key: sum(turn[key] for turn in turns) for key in turns[0] if key != "ages_ms"}
        ages = np.array([age for turn in turns for age in turn["ages_ms"]])
        p50, p95 = np.percentile(ages, (50, 95)) if len(ages) else (np.nan, np.nan)
        sent, answered = total["sent"], total["answered"]
        return cls(
            server_ms_per_set=round(1e3 * total["cpu_s"] / max(answered, 1), 2),
            hz_sent=round(sent / total["span_s"], 1),
            hz_sustained=round(answered / total["span_s"], 1),
            latency_p50_ms=round(float(p50), 2),
            latency_p95_ms=round(float(p95), 2),
            sent=sent,
            answered=answered,
            tracked=total["tracked"],
            incomplete=total["incomplete"],
            dropped=sent - answered,
        )


def clip_of(session: Path, cameras: int) -> Clip:
    """The silhouettes of a session's first cameras or, without the session, of the studio's."""
    if not session.is_dir():
        print(f"{session} is not there: the studio's person instead")
        return studio_clip("walk", STUDIO_S, cameras)
    clip = session_clip(session, exact=False)
    kept = clip.rig.names[:cameras]
    rig = Rig(tuple(clip.rig.camera(name) for name in kept), clip.rig.volume)
    packed = [{name: frame[name] for name in kept} for frame in clip.packed]
    fewer = FEWER_CAMERAS if len(kept) < len(clip.rig.names) else {}
    return Clip(clip.name, rig, clip.fps, packed, clip.truth, {**clip.start, **fewer})


def measure(servers: Sequence[Server], hz: float, seconds: float, turns: int) -> list[Figures]:
    """Play to the servers in turns, ``seconds`` to each in total."""
    played: list[list[dict[str, Any]]] = [[] for _ in servers]
    for _ in range(turns):
        for server, own in zip(servers, played, strict=True):
            own.append(server.play(hz, seconds / turns))
    return [Figures.of(own) for own in played]


# --- overload


@dataclass(frozen=True)
class OverloadFigures:
    """Rates in Hz; ``overload_share``: of the held rate that is answered, whole, at twice that rate."""

    hz_held: float
    overload_hz_sent: float
    overload_hz_answered: float
    overload_share: float
    overload_incomplete: int
    overload_latency_p50_ms: float
    overload_latency_p95_ms: float
    recovery_s: float


def measure_overload(
    clip: Clip, processes: str, folder: Path, domain: int, settings: Mapping[str, Any], hz: float | None = None
) -> OverloadFigures:
    """Find the rate that is held (or take ``hz``), play twice that rate, then half of it."""
    if hz is None:
        with running(
            "held", TREE, processes, clip, folder / "held", domain, {**settings, "hull_server.thin_out": False}
        ) as s:
            hz = held_hz(s)
    with running("overload", TREE, processes, clip, folder / "overload", domain + 2, settings) as server:
        _, over, low = server.play_phases([(0.5 * hz, SETTLE_S), (2.0 * hz, OVERLOAD_S), (0.5 * hz, LOW_S)])
    ages = [age for _, age in over["ages"]]
    answered_hz = (len(over["answered_s"]) - over["incomplete"]) / OVERLOAD_S
    return OverloadFigures(
        hz_held=round(hz, 1),
        overload_hz_sent=round(2 * hz, 1),
        overload_hz_answered=round(answered_hz, 1),
        overload_share=round(answered_hz / hz, 3),
        overload_incomplete=over["incomplete"],
        overload_latency_p50_ms=round(float(np.percentile(ages, 50)), 1),
        overload_latency_p95_ms=round(float(np.percentile(ages, 95)), 1),
        recovery_s=round(recovery_s(low["answered_s"], low["hz"], low["seconds"]), 2),
    )


def held_hz(server: Any) -> float:
    """The highest rate, in steps of a tenth, at which sets are neither dropped nor wait."""
    hz, held = FIRST_HZ, 0.0
    while True:
        _, tried = server.play_phases([(hz, SETTLE_S), (hz, TRY_S)])
        answered, sent = len(tried["answered_s"]), tried["sent"]
        p95 = float(np.percentile([age for _, age in tried["ages"]], 95)) if tried["ages"] else np.inf
        print(f"{hz:.0f} Hz: {answered} of {sent} answered, 95 % within {p95:.0f} ms", flush=True)
        if answered < HELD_SHARE * sent or p95 > HELD_P95_MS:
            return held or hz
        held, hz = hz, hz * STEP


def recovery_s(answered_s: list[float], hz: float, seconds: float) -> float:
    """When the last exposure lay that was not answered, since the phase began; its length where it never ended."""
    gaps = np.diff([0.0, *answered_s, seconds])
    late = np.flatnonzero(gaps > 1.5 / hz)
    return 0.0 if len(late) == 0 else float([0.0, *answered_s, seconds][late[-1] + 1])


def print_overload(figures: OverloadFigures) -> None:
    """One row."""
    table = Table(
        "held Hz:>8.1f | offered Hz:>11.1f | answered Hz:>12.1f | share:>6.2f | incomplete:>11d | p50 ms:>7.1f"
        " | p95 ms:>7.1f | recovery s:>11.2f",
        "twice the rate that is held, then half of it: sets answered, latency, time until every set is answered again",
    )
    table.row(*vars(figures).values())


# --- camera clients, and the command


def clients(folder: Path, domain: int, size: str, hz: float, seconds: float) -> camera.Run:
    """Camera clients on simulated GigE cameras, as bench/camera.py measures them."""
    os.environ["ROS_DOMAIN_ID"] = str(domain)
    session = camera.built_in_session(folder / "session", CLIENTS, size=size)
    return camera.measure(session, folder / "clients", hz, 0.0, seconds)


def arguments() -> argparse.ArgumentParser:
    """Of this bench."""
    given = parser(__doc__, quick=f"{QUICK_S:g} s a server; with --scaling fewer sets")
    given.add_argument("--hz", type=float, default=60.0)
    given.add_argument("--cameras", type=int, default=6)
    given.add_argument("--seconds", type=float, default=60.0, help="counted time a server, all its turns together")
    given.add_argument("--turns", type=int, default=QUICK_TURNS)
    given.add_argument("--processes", choices=PROCESSES, default=next(iter(PROCESSES)), help="of this tree's server")
    given.add_argument("--overload", action="store_true", help="twice the rate that is held, instead of --hz")
    given.add_argument("--scaling", action="store_true", help="processor time over cameras, voxels and people")
    given.add_argument(
        "--size", metavar="WxH", help=f"camera clients alone, {CLIENTS} of pictures of that size, at --hz"
    )
    given.add_argument("--before", default=BEFORE, metavar="COMMIT", help=f"older commit ({BEFORE}); '': none")
    given.add_argument("--session", type=Path, default=SHARED / "sessions" / SESSION, help="what the cameras see")
    given.add_argument(
        "--domain", type=int, default=FIRST_DOMAIN, help="ROS domain of this tree's server; the other: + 1"
    )
    add_settings(given)
    return given


def main() -> None:
    """Measure, print a row a server, and the JSON line."""
    args = arguments().parse_args()
    if args.scaling:
        finish(scaling(args.quick))
        return
    settings, seconds = parse_settings(args.settings), QUICK_S if args.quick else args.seconds
    if args.size:
        with tempfile.TemporaryDirectory(prefix="sagoma_bench_live_") as own:
            run = clients(Path(own), args.domain, args.size, args.hz, seconds)
        camera.print_runs([run])
        print(machine_line())
        finish(asdict(run))
        return
    clip = clip_of(args.session, args.cameras)
    if args.overload:
        with tempfile.TemporaryDirectory(prefix="sagoma_bench_live_") as held:
            figures = measure_overload(clip, args.processes, Path(held), args.domain, settings)
        print_overload(figures)
        finish(asdict(figures))
        return
    folder = Path(tempfile.mkdtemp(prefix="sagoma_bench_live_"))  # stays, with the logs, when the bench fails
    trees = [("now", TREE, args.processes, settings)]
    trees += [(args.before, tree_of(args.before), "three", {})] if args.before else []
    with contextlib.ExitStack() as stack:
        servers = [
            stack.enter_context(running(name, tree, processes, clip, folder / name, args.domain + k, own))
            for k, (name, tree, processes, own) in enumerate(trees)
        ]
        figures = measure(servers, args.hz, seconds, args.turns)
    client_ms = clients(folder, args.domain, "640x480", CLIENT_FPS, CLIENT_S).client_ms_per_frame
    shutil.rmtree(folder, ignore_errors=True)
    table = Table(
        "server:<9 | processes:>9 | ms/set:>7.2f | Hz sent:>8.1f | Hz answered:>11.1f | latency p50 ms:>14.1f"
        " | p95 ms:>8.1f | sets:>7d | answered:>8d | tracked:>8d | incomplete:>10d | dropped:>8d",
        f"{clip.name}, {len(clip.rig.names)} cameras at {args.hz:g} Hz -> server -> joint states",
    )
    for (name, _, processes, _), f in zip(trees, figures, strict=True):
        table.row(name, processes, *asdict(f).values())
    print(machine_line())
    print(
        f"a camera client on a simulated GigE camera at {CLIENT_FPS:g} Hz: {client_ms:.2f} ms of processor time a frame"
    )
    finish(
        {**asdict(figures[0]), "client_ms_per_frame": client_ms}
        | ({"before": asdict(figures[1])} if args.before else {})
    )


if __name__ == "__main__":
    execute(main)
