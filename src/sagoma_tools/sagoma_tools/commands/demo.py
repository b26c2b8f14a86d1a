"""``sagoma demo``: runs the whole graph live on the built-in session or a folder of videos, scores and draws it."""

from __future__ import annotations

import argparse
import json
import os
import shutil
from collections.abc import Sequence
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console

from capture_rig.session import load_session
from capture_rig.settings import FRAME_RATE, PLAYING_SPEED
from capture_rig.stop_signals import StopOnSignal
from stick_figure.body import Body
from virtual_studio.gige.__main__ import speed_argument
from virtual_studio.recording.session import write_session
from virtual_studio.rig import ring

from ..arguments import add_settings_argument, add_start_argument, next_steps, parse_settings
from ..console import INTERRUPTED, CommandConsole, doing
from ..evaluation.live_inputs import FootageInput
from ..evaluation.live_run import KEPT_UP, LiveRun, evaluate_run, run_live, run_studio
from ..evaluation.scores import Scores
from ..evaluation.tables import print_ages, print_nodes, print_scores
from ..evaluation.track import REMEDY, explain
from ..graph.processes import busy_machine
from ..takes.measure import finish_take

TRACKED = 0.5  # least share of answered sets with a body: the rest precedes the first pose
RING_CAMERAS, STATURE_M, SECONDS = 4, 1.75, 6.0  # and a camera on the ceiling


def add_parser(subparsers: argparse._SubParsersAction) -> None:
    """Add the subcommand."""
    parser = subparsers.add_parser("demo", help="run the whole graph live on footage, record, measure and draw it")
    option = parser.add_argument
    option("--session", help="folder of footage (default: a synthetic session, made once)")
    option("--output", default="output/demo", help="where bag, logs and pictures go (default: output/demo)")
    rate = "of the simulated cameras (default: the session's; the graph keeps what it holds)"
    option("--fps", type=FRAME_RATE, help=rate)
    speed = "at this speed, or at 0 as fast as the graph keeps up, dropping nothing"
    option("--rate", type=PLAYING_SPEED, metavar="R", help=f"no cameras: the clients read the videos, {speed}")
    slow = "of the simulated cameras' time, as 1/4 (default: 1, or as much slower as this machine needs for 25 Hz)"
    option("--speed", type=speed_argument, metavar="S", help=slow)
    add_start_argument(parser)
    add_settings_argument(parser)
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Make the session if need be, run, report; 0 when the capture is sound, however busy the machine, else 1."""
    os.environ.setdefault("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    console = CommandConsole()
    output = Path(args.output)
    folder = Path(args.session) if args.session else built_in_session(output / "session", console)
    shutil.rmtree(output / "bag", ignore_errors=True)
    with StopOnSignal() as stop:
        options: dict[str, Any] = {"start": args.start, "settings": parse_settings(args.settings), "cancel": stop}
        if args.rate is None:
            session = load_session(folder)
            cameras, fps = len(session.rig.names), args.fps or session.fps
            console.print(f"{cameras} simulated GigE cameras at {fps:g} Hz look at {folder} (logs: {output / 'logs'})")
            live = run_studio(folder, output, fps, args.speed, **options)
        else:
            console.print(f"the camera clients read the videos of {folder} (logs: {output / 'logs'})")
            live = run_live(FootageInput(folder, args.rate), output, **options)
    finish_take(live.bag)
    if stop.is_set():
        return INTERRUPTED
    from ..evaluation.pictures import draw

    doing("evaluating and drawing")
    outcome = evaluate_run(live) if len(live.track) else None
    scores = outcome.scores if outcome else None
    report(console, live, scores)
    for path in draw(output, outcome) if outcome else ():
        console.print(f"picture: {path}")
    console.print(f"bag: {live.bag}  (replay it: sagoma replay {live.bag} --graph --lockstep --output OUT)")
    console.print(next_steps(live.bag))
    trouble = unsound(live.sets, live.answered, len(live.track))
    if args.rate is None:
        console.print(pace(live, cameras, fps), style="bold")
    if trouble:
        why = live.reasons if len(live.track) < TRACKED * live.answered else ()
        console.print(f"{trouble}; {next_step(args.rate, why)}", style="yellow")
    print(json.dumps(figures(live, scores)))
    return 1 if trouble else 0


def built_in_session(folder: Path, console: Console) -> Path:
    """Return the synthetic session of the demo, made by the virtual studio when it is not there yet."""
    if not (folder / "session.yaml").is_file():
        console.print(f"making a synthetic session in {folder}")
        folder.parent.mkdir(parents=True, exist_ok=True)
        rig, body = ring(RING_CAMERAS, True), Body.from_stature(STATURE_M)
        write_session(folder, rig, body, seconds=SECONDS, progress=doing("rendering frames"))
    return folder


def unsound(sets: int, answered: int, tracked: int) -> str:
    """Return why a capture is not sound, by the sets that the clients sent; empty when it is."""
    if answered < KEPT_UP * sets:
        return f"only {answered} of {sets} frame sets were answered"
    if tracked < TRACKED * answered:
        return f"a person was tracked in {f'only {tracked}' if tracked else 'none'} of {answered} frame sets"
    return ""


def pace(live: LiveRun, cameras: int, fps: float) -> str:
    """Return the share of the cameras' rate that the machine held, or the speed of their time, in words."""
    if live.speed < 1:
        speed = Fraction(live.speed).limit_denominator(1000)
        return f"shown at {speed} of the speed of {cameras} cameras at {fps:g} Hz"
    if live.hz_held > KEPT_UP * fps:
        return f"this machine holds all the cameras' {fps:g} Hz"
    return f"this machine holds {live.hz_held:.0f} Hz of the cameras' {fps:g} Hz; all left out the same frames"


def next_step(rate: float | None, reasons: Sequence[Sequence[str]] = ()) -> str:
    """Return the remedy for a capture that is not sound.

    rate : of the footage, None of cameras; reasons : of each set, why nobody was tracked in it, where that is wrong.
    """
    if any(reasons):
        return f"{explain(reasons)}. {REMEDY}"
    logs = "look into the logs of the nodes"
    slower = f"read the videos as fast as this machine can (--rate 0); {busy_machine() or logs}"
    return logs if rate == 0.0 else slower  # at 0 nothing is dropped, however busy the machine


def report(console: Console, live: LiveRun, scores: Scores | None) -> None:
    """Print everything that the run measured."""
    print_nodes(console, live.usage, live.diagnostics)
    if live.ages_ms:
        print_ages(console, live.ages_ms)
    console.print(
        f"{live.sets} frame sets sent, {live.answered} answered by the EKF ({live.sets_per_s:.0f} a second; the "
        f"footage has {live.session.fps:.0f}), {live.incomplete} incomplete"
    )
    if scores is not None:
        print_scores(console, scores)


def figures(live: LiveRun, scores: Scores | None) -> dict[str, object]:
    """Return the run's figures as plain data for JSON; exposure to joint state where stamps are those of exposures."""
    ages_ms = np.percentile(live.ages_ms["published_ms"], [50, 95]).round(1).tolist() if live.ages_ms else ()
    return {
        "sets": live.sets,
        "answered": live.answered,
        "incomplete": live.incomplete,
        "sets_per_s": round(live.sets_per_s, 1),
        "hz_held": round(live.hz_held, 1),
        "speed": live.speed,
        **dict(zip(("latency_p50_ms", "latency_p95_ms"), ages_ms, strict=False)),
        "memory_mib": {name: round(used.resident_mib, 1) for name, used in live.usage.items()},
        **(scores.figures() if scores is not None else {}),
    }
