"""``sagoma calibrate intrinsics``: each camera's lens, from footage of a board or live."""

from __future__ import annotations

import argparse
import json
import sys
from pathlib import Path

from rich.console import Console
from rich.progress import Progress

from capture_rig.errors import InputError
from capture_rig.lens import COEFFICIENTS
from capture_rig.verdict import REDO
from rig_calibration.boards.board import Board
from rig_calibration.boards.specification import read_board
from rig_calibration.intrinsics.calibrate import calibrate_intrinsics
from rig_calibration.intrinsics.model_choice import AUTO
from rig_calibration.intrinsics.result import Intrinsics
from rig_calibration.intrinsics.selection import BoardImageProcessor

from ...calibration.footage import CameraFootage, open_footage_of_cameras
from ...calibration.intrinsics import figures, print_results, save_results, watch_footage

DEFAULT_FOLDER = "output/intrinsics"
MODELS = (*COEFFICIENTS, AUTO)
FAILED = 1
TABLE_WIDTH = 150


def add_parser(subparsers: argparse._SubParsersAction) -> None:
    """Add the step."""
    parser = subparsers.add_parser("intrinsics", help="each camera's lens, from footage of a board or live")
    parser.add_argument(
        "sources",
        nargs="*",
        metavar="SOURCE",
        help="a folder with a video or a folder of stills a camera, one video, or NAME=PATH",
    )
    parser.add_argument("--topic", help="live: a camera's image topic, such as /cam01/image_raw")
    parser.add_argument("--board", required=True, help="its YAML file, or e.g. 'checkerboard 9x6 25mm' (inner corners)")
    parser.add_argument("--model", choices=MODELS, default="plumb_bob", help="lens; auto: whichever predicts better")
    parser.add_argument("--output", default=DEFAULT_FOLDER, help=f"folder of the results (default: {DEFAULT_FOLDER})")
    parser.add_argument("--json", action="store_true", help="the last line is the figures as JSON")
    live = parser.add_argument_group("live, with --topic")
    live.add_argument("--name", help="the camera's name (default: from the topic)")
    live.add_argument("--seconds", type=float, help="end after so long, with what there is")
    live.add_argument("--views", type=int, help="end after so many views (default: when the lens is known well enough)")
    live.add_argument("--wait", type=float, default=10.0, help="give up when no image comes for so long, in seconds")
    live.add_argument(
        "--set",
        action="store_true",
        dest="offer",
        help="hand the result to the running camera client (its service set_camera_info)",
    )
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Calibrate every camera; 0 when all will do, 1 when one must be done again."""
    if bool(args.sources) == bool(args.topic):
        raise InputError(
            "give either footage or --topic",
            where="sagoma calibrate intrinsics",
            remedy="For example: sagoma calibrate intrinsics FOLDER --board 'checkerboard 9x6 25mm'.",
        )
    board = read_board(args.board)
    console = Console(stderr=args.json)
    console = console if console.is_terminal else Console(stderr=args.json, width=TABLE_WIDTH)
    if args.topic:
        from ...calibration.live_lens import calibrate_live  # ROS takes a second to load

        results, failures = [calibrate_live(args, board, console)], list[InputError]()
    else:
        results, failures = _calibrate_footage(args, board, console)
    print_results(console, results)
    for failure in failures:
        print(f"sagoma: {failure}", file=sys.stderr)
    if args.json:
        print(json.dumps({"cameras": [figures(result) for result in results], "failed": [str(f) for f in failures]}))
    return FAILED if failures or any(result.verdict.grade == REDO for result in results) else 0


def _calibrate_footage(
    args: argparse.Namespace, board: Board, console: Console
) -> tuple[list[Intrinsics], list[InputError]]:
    """Camera by camera; one that cannot be calibrated keeps no other from it. Raises InputError when none can."""
    results: list[Intrinsics] = []
    failures: list[InputError] = []
    for footage in open_footage_of_cameras(args.sources).values():
        try:
            result = _calibrate_one(footage, board, args.model, console)
            save_results(Path(args.output), result, board, ", ".join(args.sources))
            results.append(result)
        except InputError as error:
            failures.append(error)
    if not results:
        for failure in failures[:-1]:
            print(f"sagoma: {failure}", file=sys.stderr)
        raise failures[-1]
    console.print(f"results in {args.output}")
    return results, failures


def _calibrate_one(footage: CameraFootage, board: Board, model: str, console: Console) -> Intrinsics:
    collecting = "plumb_bob" if model == AUTO else model
    with Progress(console=console, transient=True, disable=not console.is_terminal) as bar:
        task = bar.add_task(footage.name, total=None)

        def progress(watcher: BoardImageProcessor) -> None:
            said = f"{footage.name}: board in {watcher.found} of {watcher.examined}, {len(watcher.collector)} views"
            bar.update(task, description=said, completed=watcher.examined)

        watcher = watch_footage(footage, board, collecting, progress)
    console.print(
        f"{footage.name}: {watcher.examined} images, board found in {watcher.found}, "
        f"{len(watcher.collector)} views kept",
        highlight=False,
    )
    return calibrate_intrinsics(watcher.collector.best(), board, name=footage.name, model=model)
