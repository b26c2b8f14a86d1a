"""``sagoma background``: empty the room, let every camera learn it, say what came of it; ``show`` a saved one."""

from __future__ import annotations

import argparse
import contextlib
import json
import sys
import threading
from collections.abc import Iterator, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from rich.console import Console
from rich.live import Live
from rich.table import Table
from rich.text import Text

from camera_client.background.model import BackgroundModel, load_background, shape_text
from camera_client.background.verdict import find_regions
from capture_rig.errors import InputError
from capture_rig.verdict import GOOD, REDO, USABLE

from ..arguments import StopOnSignal
from ..graph.background_training import (
    TIMEOUT_S,
    TrainingOutcome,
    camera_of,
    count_down,
    find_clients,
    needing_training,
    progress_of,
    train_backgrounds,
)
from ..graph.diagnostics_table import DiagnosticsTable
from ..graph.ros_link import RosLink

# --- Lessons of the background and saved backgrounds, as tables for people and as figures for programs.

STYLE = {GOOD: "green", USABLE: "yellow", REDO: "red"}
STATUS = {GOOD: 0, USABLE: 1, REDO: 2}  # exit status


def exit_status(lessons: Sequence[TrainingOutcome]) -> int:
    """0 when all are good, 1 when one is only usable, 2 when one has to be redone."""
    return max((STATUS[lesson.grade] for lesson in lessons), default=0)


def training_table(lessons: Sequence[TrainingOutcome]) -> Table:
    """One line a camera, and one more for each further finding."""
    table = Table(box=None, pad_edge=False)
    for title in ("camera", "verdict"):
        table.add_column(title, no_wrap=True)
    for title in ("frames", "noise", "moved %"):
        table.add_column(title, justify="right", no_wrap=True)
    table.add_column("why", ratio=1)
    table.add_column("what to do", ratio=1)
    for lesson in sorted(lessons, key=lambda lesson: lesson.camera):
        first, *others = _reasons(lesson)
        table.add_row(lesson.camera, Text(lesson.grade, STYLE[lesson.grade]), *_figures(lesson), *first)
        for other in others:
            table.add_row("", "", "", "", "", *other)
    return table


def _figures(lesson: TrainingOutcome) -> tuple[str, str, str]:
    report = lesson.report
    if report is None or not report.frames:
        return "", "", ""
    return str(report.frames), f"{report.noise:.2f}", f"{100 * report.moved:.2f}"


def _reasons(lesson: TrainingOutcome) -> list[tuple[str, str]]:
    """What was found and what to do, one a line; at least one."""
    report = lesson.report
    if report is None or (report.grade == REDO and not report.findings):
        return [(lesson.said, "see that its frames come (sagoma up, sagoma doctor), and run it again")]
    found = [(finding.what, finding.remedy) for finding in report.findings]
    if report.grade != REDO and not report.saved:
        found.append(("in use, but not saved", "set background_file in the camera's parameter file"))
    return found or [("", "")]


def figures(lessons: Sequence[TrainingOutcome]) -> dict[str, Any]:
    """The same, for programs."""
    return {
        lesson.camera: {"said": lesson.said, **(asdict(lesson.report) if lesson.report else {}), "grade": lesson.grade}
        for lesson in lessons
    }


def provenance_table(model: BackgroundModel, title: str) -> Table:
    """Where a saved background comes from."""
    table = Table("", "", title=title, title_justify="left", box=None, pad_edge=False, show_header=False)
    for key, value in asdict(model.provenance).items():
        if value != "":
            table.add_row(key, f"{value:.3f}" if isinstance(value, float) else str(value))
    table.add_row("image", shape_text(model.shape))
    table.add_row("moved", f"{100 * model.moving_share:.2f} % of the pixels")
    return table


# --- Pictures of a background model: its mean, and its noise with the places where something moved.

BRIGHTEST_SIGMA = 10.0  # grey levels; as much noise and more has the brightest colour
FRAME_BGR = (0, 0, 255)


def mean_picture(model: BackgroundModel) -> np.ndarray:
    """(H, W) or (H, W, 3) uint8: the empty room."""
    return np.rint(model.mean).clip(0, 255).astype(np.uint8)


def sigma_picture(model: BackgroundModel) -> np.ndarray:
    """(H, W, 3) uint8: dark where the pixel was steady, yellow at BRIGHTEST_SIGMA; boxes where something moved."""
    sigma = model.sigma if model.sigma.ndim == 2 else model.sigma.max(axis=2)
    levels = np.rint(sigma * (255 / BRIGHTEST_SIGMA)).clip(0, 255).astype(np.uint8)
    picture = cv2.applyColorMap(levels, cv2.COLORMAP_VIRIDIS)
    for place in find_regions(model.moving_pixels):
        cv2.rectangle(picture, (place.left, place.top), (place.right, place.bottom), FRAME_BGR)
    return picture


def write_pictures(model: BackgroundModel, folder: Path, name: str) -> list[Path]:
    """NAME_mean.png and NAME_sigma.png in ``folder``. Raises InputError when they cannot be written."""
    written = []
    for kind, picture in (("mean", mean_picture(model)), ("sigma", sigma_picture(model))):
        path = folder / f"{name}_{kind}.png"
        try:
            folder.mkdir(parents=True, exist_ok=True)
            path.write_bytes(cv2.imencode(".png", picture)[1].tobytes())
        except OSError as error:
            raise InputError(
                f"cannot be written ({error.strerror})", where=str(path), remedy="Choose another folder with --output."
            ) from None
        written.append(path)
    return written


COUNTDOWN_S = 10
CONTACT_S = 3.0  # within this every client tells its state
LOG_WIDTH = 150
ERROR = b"\2"
EPILOG = "exit status: 0 all good, 1 a camera is only usable, 2 one has to be done again or did not answer"


def add_parser(subparsers: argparse._SubParsersAction) -> None:
    """Add the subcommand."""
    parser = subparsers.add_parser(
        "background", help="let the cameras of a running graph learn the empty room", epilog=EPILOG
    )
    parser.add_argument(
        "--countdown",
        type=int,
        default=COUNTDOWN_S,
        metavar="S",
        help=f"seconds to leave the room (default: {COUNTDOWN_S})",
    )
    parser.add_argument("--cameras", nargs="+", metavar="CAM", help="only these (default: all that are found)")
    parser.add_argument(
        "--repeat", action="store_true", help="only those that have none, or whose background is no good"
    )
    parser.add_argument(
        "--retries",
        type=int,
        default=1,
        metavar="N",
        help="so often those that have to be redone are tried again at once (default: 1)",
    )
    parser.add_argument(
        "--expect", type=int, default=1, metavar="N", help="wait until so many camera clients are there"
    )
    parser.add_argument("--wait", type=float, default=5.0, metavar="S", help="... but no longer than this")
    parser.add_argument("--timeout", type=float, default=TIMEOUT_S, metavar="S", help="for a camera's frames to come")
    parser.add_argument("--json", action="store_true", help="print the result as one line of JSON, too")
    parser.set_defaults(run=run)
    show = parser.add_subparsers(metavar="show").add_parser("show", help="what saved backgrounds (.npz) hold")
    show.add_argument("files", nargs="+", metavar="FILE", help="saved backgrounds")
    show.add_argument("--output", metavar="FOLDER", help="where pictures go (default: beside each file)")
    show.set_defaults(run=run_show)


def run(args: argparse.Namespace) -> int:
    """Find the clients, empty the room, learn, report; the exit status tells the worst verdict."""
    console = Console() if sys.stdout.isatty() else Console(width=LOG_WIDTH)
    with StopOnSignal() as stop, RosLink("sagoma_background") as link:
        board = DiagnosticsTable(link.node)
        names = chosen(find_clients(link.node, args.expect, args.wait), args.cameras)
        board.wait_for(names, CONTACT_S)
        if args.repeat:
            names = needing_training(board, names)
        if not names:
            console.print("every background is fine")
            return 0
        warn_of_absent(console, board, names)
        learned = BackgroundTraining(console, link, board, stop, args.timeout).learn(
            names, args.countdown, args.retries
        )
    console.print(training_table(learned))
    if args.json:
        print(json.dumps(figures(learned)))
    return exit_status(learned)


class BackgroundTraining:
    """Empties the room and teaches the clients, as often as it takes."""

    def __init__(
        self,
        console: Console,
        link: RosLink,
        board: DiagnosticsTable,
        stop: threading.Event,
        timeout_s: float = TIMEOUT_S,
    ) -> None:
        self._console, self._link, self._board, self._stop, self._timeout_s = console, link, board, stop, timeout_s

    def learn(self, names: Sequence[str], countdown_s: int, retries: int) -> list[TrainingOutcome]:
        """The last lesson of each client ``names``; those that came to nothing are tried ``retries`` times more."""
        lessons = {camera_of(name): TrainingOutcome(camera_of(name), "cancelled") for name in names}
        pending, what = list(names), "leave the room"
        for attempt in range(1 + retries):
            if not count_down(self._console, what, countdown_s, self._stop):
                break
            lessons |= {lesson.camera: lesson for lesson in self._train(pending)}
            pending = [name for name in pending if should_repeat(lessons[camera_of(name)])]
            if not pending:
                break
            what = f"leave the room for {', '.join(map(camera_of, pending))}"
            if attempt < retries:
                self._console.print(training_table([lessons[camera_of(name)] for name in pending]))
        self._console.bell()
        return list(lessons.values())

    def _train(self, names: Sequence[str]) -> list[TrainingOutcome]:
        with self._progress(names):
            return train_backgrounds(
                self._link.node, self._board, names, self._timeout_s, lambda: not self._stop.is_set()
            )

    @contextlib.contextmanager
    def _progress(self, names: Sequence[str]) -> Iterator[None]:
        """While it lasts, one line tells how far every camera is; into a file, only who learns."""

        def line() -> Text:
            progress = (f"{camera_of(name)} {progress_of(self._board, name) or '...'}" for name in names)
            return Text("   ".join(["learning", *progress]))

        if not self._console.is_terminal:
            self._console.print(f"learning: {', '.join(map(camera_of, names))}", highlight=False)
            yield
            return
        with Live(console=self._console, get_renderable=line, refresh_per_second=4, transient=True):
            yield


def should_repeat(lesson: TrainingOutcome) -> bool:
    """Was something learned that must be learned again? Where no frames come nobody needs to leave the room."""
    return lesson.report is not None and lesson.grade == REDO


def chosen(names: Sequence[str], cameras: Sequence[str] | None) -> list[str]:
    """Those of ``names`` that belong to ``cameras``, or all. Raises InputError for a camera that is not there."""
    if cameras is None:
        return list(names)
    by_camera = {camera_of(name): name for name in names}
    absent = sorted(set(cameras) - set(by_camera))
    if absent:
        raise InputError(
            f"no client of {', '.join(absent)} is there",
            where="--cameras",
            remedy=f"There are: {', '.join(sorted(by_camera))}.",
        )
    return [by_camera[camera] for camera in sorted(set(cameras))]


def warn_of_absent(console: Console, board: DiagnosticsTable, names: Sequence[str]) -> None:
    """Name those that cannot learn now, before somebody leaves the room for nothing."""
    for name in names:
        report = board.report(name)
        if report is None:
            console.print(f"{camera_of(name)} is silent: its node sends no diagnostics", style="yellow", markup=False)
        elif report.level == ERROR or report.message in ("unconfigured", "configured, inactive", "suspended"):
            console.print(f"{camera_of(name)} says: {report.message}", style="yellow", markup=False)


def run_show(args: argparse.Namespace) -> int:
    """Print where each background comes from, and write its pictures."""
    console = Console() if sys.stdout.isatty() else Console(width=LOG_WIDTH)
    for file in map(Path, args.files):
        model = load_background(file)
        console.print(provenance_table(model, str(file)))
        folder = Path(args.output) if args.output else file.parent
        mean, sigma = write_pictures(model, folder, file.stem)
        console.print(f"pictures: {mean}, {sigma} (brightest: {BRIGHTEST_SIGMA:g} grey levels of noise or more)")
    return 0
