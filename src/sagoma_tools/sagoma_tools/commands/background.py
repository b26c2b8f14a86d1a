"""``sagoma background``: trains the background of every camera in the empty room; ``show`` prints a saved one.

Without an empty room, ``--from-footage`` makes one of videos with people in them.
"""

from __future__ import annotations

import argparse
import contextlib
import json
import threading
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from rich.console import Console
from rich.text import Text

from camera_client.background.model import BackgroundModel, load_background, shape_text
from camera_client.background.training import background_of_footage
from camera_client.background.training_verdict import find_regions, judge_background, turn_findings
from camera_client.sources.footage_reader import FootageReader
from capture_rig.errors import InputError
from capture_rig.files import make_folder, write_bytes
from capture_rig.session import load_session
from capture_rig.settings import SECONDS, number
from capture_rig.stop_signals import StopOnSignal
from capture_rig.verdict import GOOD, REDO, USABLE
from capture_rig.video import Video

from ..arguments import NODES
from ..console import GRADE_STYLE, INTERRUPTED, CommandConsole, doing, until_stopped
from ..graph import START_TIMEOUT_S
from ..graph.background_training import TrainingOutcome, find_clients, needing_training, progress_of, train_backgrounds
from ..graph.diagnostics_table import STALE_S, DiagnosticsTable
from ..graph.ros_link import RosLink, add_namespace_argument, label_of, namespace_argument, namespace_of

COUNTDOWN_S = 10
STATUS = {GOOD: 0, USABLE: 1, REDO: 2}
BRIGHTEST_SIGMA = 10.0  # grey levels of noise that the picture shows in its brightest colour
REGION_BGR = (0, 0, 255)
MOST_FRAMES = 60  # of a video: a second more of memory and time brings no more
MOST_REGIONS, MUCH_UNCERTAIN = 3, 0.1  # named a camera; share of the picture that makes a background a poor one


def add_parser(subparsers: argparse._SubParsersAction) -> None:
    """Add the subcommand."""
    help_text = "let the cameras of a running graph learn the empty room"
    parser = subparsers.add_parser("background", help=help_text)
    option = parser.add_argument
    help_countdown = f"seconds to leave the room (default: {COUNTDOWN_S})"
    help_footage = "no graph: make backgrounds of videos, or of a session's, with people in them"
    option("--from-footage", nargs="+", metavar="VIDEO|SESSION", help=help_footage)
    option("--countdown", type=number("s", 0, 3600, whole=True), default=COUNTDOWN_S, metavar="S", help=help_countdown)
    option("--cameras", nargs="+", metavar="CAM", help="only these (default: all that are found)")
    option("--repeat", action="store_true", help="only those without a background, or whose background is no good")
    option("--expect", type=NODES, default=1, metavar="N", help="wait until so many camera clients are found")
    option("--wait", type=SECONDS, default=5.0, metavar="S", help="... but no longer than this")
    option("--timeout", type=SECONDS, default=START_TIMEOUT_S, metavar="S", help="for a camera's frames to come")
    add_namespace_argument(parser)
    option("--json", action="store_true", help="print the result as one line of JSON, too")
    parser.set_defaults(run=run)
    show = parser.add_subparsers(metavar="show").add_parser("show", help="what saved backgrounds (.npz) hold")
    show.add_argument("files", nargs="+", metavar="FILE", help="saved backgrounds")
    show.add_argument("--output", metavar="FOLDER", help="where pictures go (default: beside each file)")
    show.add_argument("--against", metavar="FILE", help="an earlier one: what changed since, of light, noise and room")
    show.set_defaults(run=run_show)


def run(args: argparse.Namespace) -> int:
    """Find the clients, wait for the empty room, train, report; the exit status is the worst verdict's."""
    console = CommandConsole()
    if args.from_footage:
        return run_from_footage(console, args.from_footage)
    with StopOnSignal() as stop, RosLink("sagoma_background", namespace=namespace_argument(args)) as link:
        diagnostics = DiagnosticsTable(link.node)
        found = find_clients(link.node, args.expect, args.wait)
        names = select_clients(found, args.cameras, namespace_of(link.node))
        diagnostics.wait_for(names, STALE_S)
        if args.repeat:
            names = needing_training(diagnostics, names)
        if not names:
            console.print("every background is fine")
            return 0

        def wanted() -> bool:
            show("   ".join(f"{label_of(name)} {progress_of(diagnostics, name) or '...'}" for name in names))
            return not stop.is_set()

        if not count_down(console, args.countdown, stop):
            return INTERRUPTED
        console.print(f"learning: {', '.join(map(label_of, names))}")
        show = doing("frames")
        outcomes = train_backgrounds(link.node, diagnostics, names, args.timeout, wanted)
        until_stopped()
        console.bell()
    print_outcomes(console, outcomes)
    if args.json:
        print(json.dumps(figures(outcomes)))
    return INTERRUPTED if stop.is_set() else exit_status(outcomes)


def run_from_footage(console: Console, sources: Sequence[str]) -> int:
    """Write VIDEO_background.npz beside every video, and print where it is uncertain; 1 where much of one is."""
    worst = 0
    named = (load_session(path).videos.values() if path.is_dir() else [path] for path in map(Path, sources))
    for video in (video for of_source in named for video in of_source):
        model, uncertain = background_of_footage(sampled_frames(video), str(video))
        path = video.with_name(f"{video.stem}_background.npz")
        model.save(path)
        share = float(uncertain.mean())
        console.print(f"{path}: of {model.provenance.frames} frames, {100 * share:.1f} % uncertain")
        for region in find_regions(uncertain)[:MOST_REGIONS]:
            columns, rows = f"{region.left} to {region.right}", f"{region.top} to {region.bottom}"
            text = f"  columns {columns}, rows {rows}: something stood there for a third of the time, or never rested"
            console.print(text)
        worst = max(worst, int(share > MUCH_UNCERTAIN))
    return worst


def sampled_frames(video: Path) -> list[np.ndarray]:
    """Return MOST_FRAMES frames at most, evenly over a video. InputError for one that cannot be read."""
    with contextlib.closing(FootageReader(Video(video), "auto")) as reader:
        reader.probe()
        every, frames, number = max(1, -(-reader.frame_count // MOST_FRAMES)), list[np.ndarray](), 0
        while (image := reader.read()) is not None:
            if number % every == 0:
                frames.append(image)
            number += 1
    return frames


def count_down(console: Console, seconds: int, stop: threading.Event) -> bool:
    """Ask to leave the room, show the seconds down to 1, then beep; False when ``stop`` was set meanwhile."""
    show = doing("leave the room")
    if seconds and not console.is_terminal:
        console.print(f"leave the room: {seconds} s")
    for left in range(seconds, 0, -1):
        show(f"{left} s")
        if stop.wait(1.0):
            return False
    console.bell()
    return True


def select_clients(names: Sequence[str], cameras: Sequence[str] | None, namespace: str = "") -> list[str]:
    """Return the clients of ``cameras``, as they are called in the namespace, among the full ``names``, or all.

    Raises InputError for a camera without a client.
    """
    if cameras is None:
        return list(names)
    by_camera = {label_of(name.removeprefix(namespace)): name for name in names}
    absent = sorted(set(cameras) - set(by_camera))
    if absent:
        remedy = f"There are: {', '.join(sorted(by_camera))}."
        raise InputError(f"no client of {', '.join(absent)} is there", where="--cameras", remedy=remedy)
    return [by_camera[camera] for camera in sorted(set(cameras))]


def exit_status(outcomes: Sequence[TrainingOutcome]) -> int:
    """0 when all are good, 1 when one is only usable, 2 when one has to be redone."""
    return max((STATUS[outcome.grade] for outcome in outcomes), default=0)


def figures(outcomes: Sequence[TrainingOutcome]) -> dict[str, Any]:
    """Return the outcomes as plain data for --json."""
    reports = {outcome.camera: asdict(outcome.report) if outcome.report else {} for outcome in outcomes}
    return {one.camera: {"said": one.message, **reports[one.camera], "grade": one.grade} for one in outcomes}


def print_outcomes(console: Console, outcomes: Sequence[TrainingOutcome]) -> None:
    """Print each camera's verdict, figures, and findings with remedies."""
    for outcome in sorted(outcomes, key=lambda outcome: outcome.camera):
        report, redo = outcome.report, outcome.grade == REDO
        console.print(Text(f"{outcome.camera}: {outcome.grade}", GRADE_STYLE[outcome.grade]))
        if report is None or (redo and not report.findings):
            console.print(f"  {outcome.message}: see that its frames come (sagoma up, sagoma doctor), and run it again")
            continue
        console.print(f"  {report.frames} frames, noise {report.noise:.2f}, moved {100 * report.moved:.2f} %")
        for finding in report.findings:
            console.print(f"  {finding.line}")
        if not (redo or report.saved):
            console.print("  in use, but not saved: set background_file in the camera's parameter file")


def run_show(args: argparse.Namespace) -> int:
    """Print origin and findings of each saved background, and write its pictures."""
    console, before = CommandConsole(), load_background(args.against) if args.against else None
    for file in map(Path, args.files):
        model = load_background(file)
        shown = {**asdict(model.provenance), "image": shape_text(model.shape), "moved": f"{model.moving_share:.2%}"}
        console.print(f"{file}: {', '.join(f'{key} {value}' for key, value in shown.items() if value != '')}")
        for finding in judge_background(model, (), before).findings + turn_findings(model.provenance):
            console.print(Text(f"{finding.grade}: {finding.line}", GRADE_STYLE[finding.grade]))
        folder = Path(args.output) if args.output else file.parent
        mean, sigma = write_pictures(model, folder, file.stem)
        console.print(f"pictures: {mean}, {sigma} (brightest: {BRIGHTEST_SIGMA:g} grey levels of noise or more)")
    return 0


def write_pictures(model: BackgroundModel, folder: Path, name: str) -> list[Path]:
    """Write NAME_mean.png and NAME_sigma.png into ``folder``. Raises InputError when they cannot be written."""
    mean = np.rint(model.mean).clip(0, 255).astype(np.uint8)
    written = []
    for kind, picture in (("mean", mean), ("sigma", sigma_picture(model))):
        path = folder / f"{name}_{kind}.png"
        write_bytes(make_folder(folder) / path.name, cv2.imencode(".png", picture)[1].tobytes())
        written.append(path)
    return written


def sigma_picture(model: BackgroundModel) -> np.ndarray:
    """(H, W, 3) uint8 BGR: dark where the noise is 0, yellow at BRIGHTEST_SIGMA; boxes around regions that moved."""
    sigma = model.sigma if model.sigma.ndim == 2 else model.sigma.max(axis=2)
    levels = np.rint(sigma * (255 / BRIGHTEST_SIGMA)).clip(0, 255).astype(np.uint8)
    picture = cv2.applyColorMap(levels, cv2.COLORMAP_VIRIDIS)
    for region in find_regions(model.moving_pixels):
        cv2.rectangle(picture, (region.left, region.top), (region.right, region.bottom), REGION_BGR)
    return picture
