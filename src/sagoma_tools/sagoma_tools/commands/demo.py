"""``sagoma demo``: runs the whole graph live on the built-in session or a folder of videos, scores and draws it."""

from __future__ import annotations

import argparse
import json
import os
import shutil
from pathlib import Path

from rich.console import Console

from stick_figure.body import Body
from virtual_studio.recording.session import write_session
from virtual_studio.rig import ring

from ..arguments import add_settings_argument, parse_settings
from ..evaluation.live_inputs import FootageInput, LiveInput, StudioInput
from ..evaluation.live_run import LiveRun, draw, evaluate_run, run_live
from ..evaluation.scores import Scores
from ..evaluation.tables import print_latency, print_nodes, print_scores
from ..graph.ros_link import StopOnSignal

CAMERA_FPS = 12.0  # five cameras, studio and graph together reach it on two cores (make demo)
KEPT_UP = 0.9  # of the frame sets, at least, are answered where a machine keeps up
RING_CAMERAS, STATURE_M, SECONDS = 4, 1.75, 6.0  # and a camera on the ceiling


def add_parser(subparsers: argparse._SubParsersAction) -> None:
    """Add the subcommand."""
    parser = subparsers.add_parser("demo", help="run the whole graph live on footage, record, measure and draw it")
    option = parser.add_argument
    option("--session", help="folder of footage (default: a synthetic session, made once)")
    option("--output", default="output/demo", help="where bag, logs and pictures go (default: output/demo)")
    option("--fps", type=float, default=CAMERA_FPS, help=f"of the simulated cameras (default: {CAMERA_FPS:g})")
    speed = "at this speed, or at 0 as fast as the graph keeps up, dropping nothing"
    option("--rate", type=float, metavar="R", help=f"no cameras: the clients read the videos, {speed}")
    help_start = "first pose: from a T-pose, or from the session's reference"
    option("--start", choices=("auto", "t_pose", "session"), default="auto", help=help_start)
    add_settings_argument(parser)
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Make the session if need be, run, report; 0 when at least 90 % of the frame sets were answered, else 1."""
    os.environ.setdefault("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    console = Console()
    output = Path(args.output)
    session = Path(args.session) if args.session else built_in_session(output / "session", console)
    shutil.rmtree(output / "bag", ignore_errors=True)
    live_input: LiveInput
    if args.rate is None:
        live_input = StudioInput(session, output / "studio", args.fps)
        console.print(
            f"{len(live_input.session.rig.names)} simulated GigE cameras at {args.fps:g} Hz look at {session}"
        )
    else:
        live_input = FootageInput(session, args.rate)
        console.print(f"the camera clients read the videos of {session}")
    console.print(f"running the graph live (logs: {output / 'logs'})")
    with StopOnSignal() as stop:
        live = run_live(live_input, output, start=args.start, settings=parse_settings(args.settings), cancel=stop)
    outcome = evaluate_run(live)
    report(console, live, outcome.scores)
    for path in draw(live, output, outcome):
        console.print(f"picture: {path}")
    console.print(f"bag: {live.bag}  (replay it: sagoma replay {live.bag} --graph --lockstep --output OUT)")
    if live.answered < live.sets:
        console.print(
            "this machine did not keep up with every frame set: give the cameras a lower rate (--fps), or read the "
            "videos as fast as it can (--rate 0)",
            style="yellow",
        )
    print(json.dumps(figures(live, outcome.scores)))
    return 0 if live.answered >= KEPT_UP * live.sets else 1


def built_in_session(folder: Path, console: Console) -> Path:
    """Return the synthetic session of the demo, made by the virtual studio when it is not there yet."""
    if not (folder / "session.yaml").is_file():
        console.print(f"making a synthetic session in {folder}")
        folder.parent.mkdir(parents=True, exist_ok=True)
        write_session(folder, ring(RING_CAMERAS, True), Body.from_stature(STATURE_M), seconds=SECONDS)
    return folder


def report(console: Console, live: LiveRun, scores: Scores | None) -> None:
    """Print everything that the run measured."""
    print_nodes(console, live.usage, live.cpu_ms_per_set, live.diagnostics)
    print_latency(console, live.latency_ms)
    console.print(
        f"{live.sets} frame sets sent, {live.answered} answered by the EKF ({live.sets_per_s:.0f} a second; the "
        f"footage has {live.session.fps:.0f}), {live.incomplete} incomplete; "
        f"capture stamps of one set differ by at most {live.spread_ms:.3f} ms"
    )
    if scores is not None:
        print_scores(console, scores)


def figures(live: LiveRun, scores: Scores | None) -> dict[str, object]:
    """Return the run's figures as plain data for the line of JSON."""
    return {
        "sets": live.sets,
        "answered": live.answered,
        "incomplete": live.incomplete,
        "sets_per_s": round(live.sets_per_s, 1),
        "memory_mib": {name: round(used.resident_mib, 1) for name, used in live.usage.items()},
        "cpu_ms_per_set": {name: round(ms, 2) for name, ms in live.cpu_ms_per_set.items()},
        **(scores.figures() if scores is not None else {}),
    }
