"""``sagoma background``: empty the room, let every camera learn it, say what came of it; ``show`` a saved one."""

from __future__ import annotations

import argparse
import contextlib
import json
import sys
import threading
from collections.abc import Iterator, Sequence
from pathlib import Path

from rich.console import Console
from rich.live import Live
from rich.text import Text

from camera_client.background_model import load_background
from capture_rig.errors import InputError
from capture_rig.verdict import REDO

from ..background_pictures import BRIGHTEST_SIGMA, write_pictures
from ..background_tables import exit_status, figures, lessons_table, provenance_table
from ..backgrounds import TIMEOUT_S, Lesson, camera_of, find_clients, need_one, progress_of, teach
from ..board import Board
from ..countdown import count_down
from ..ros_link import RosLink
from .common import StopOnSignal

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
        board = Board(link.node)
        names = chosen(find_clients(link.node, args.expect, args.wait), args.cameras)
        board.wait_for(names, CONTACT_S)
        if args.repeat:
            names = need_one(board, names)
        if not names:
            console.print("every background is fine")
            return 0
        warn_of_absent(console, board, names)
        learned = Classroom(console, link, board, stop, args.timeout).learn(names, args.countdown, args.retries)
    console.print(lessons_table(learned))
    if args.json:
        print(json.dumps(figures(learned)))
    return exit_status(learned)


class Classroom:
    """Empties the room and teaches the clients, as often as it takes."""

    def __init__(
        self, console: Console, link: RosLink, board: Board, stop: threading.Event, timeout_s: float = TIMEOUT_S
    ) -> None:
        self._console, self._link, self._board, self._stop, self._timeout_s = console, link, board, stop, timeout_s

    def learn(self, names: Sequence[str], countdown_s: int, retries: int) -> list[Lesson]:
        """The last lesson of each client ``names``; those that came to nothing are tried ``retries`` times more."""
        lessons = {camera_of(name): Lesson(camera_of(name), "cancelled") for name in names}
        pending, what = list(names), "leave the room"
        for attempt in range(1 + retries):
            if not count_down(self._console, what, countdown_s, self._stop):
                break
            lessons |= {lesson.camera: lesson for lesson in self._teach(pending)}
            pending = [name for name in pending if worth_repeating(lessons[camera_of(name)])]
            if not pending:
                break
            what = f"leave the room for {', '.join(map(camera_of, pending))}"
            if attempt < retries:
                self._console.print(lessons_table([lessons[camera_of(name)] for name in pending]))
        self._console.bell()
        return list(lessons.values())

    def _teach(self, names: Sequence[str]) -> list[Lesson]:
        with self._progress(names):
            return teach(self._link.node, self._board, names, self._timeout_s, lambda: not self._stop.is_set())

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


def worth_repeating(lesson: Lesson) -> bool:
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


def warn_of_absent(console: Console, board: Board, names: Sequence[str]) -> None:
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
