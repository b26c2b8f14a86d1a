"""``sagoma calibrate board | intrinsics | extrinsics``: boards to print, each camera's lens, the rig."""

from __future__ import annotations

import argparse
import json
import sys
from pathlib import Path

from capture_rig.errors import InputError
from capture_rig.lens import COEFFICIENTS
from capture_rig.number import number
from capture_rig.verdict import REDO
from rig_calibration.boards.drawing import PAPER_MM, print_size_m, save_for_print
from rig_calibration.boards.specification import board_text, read_board
from rig_calibration.intrinsics.calibrate import AUTO

from ..arguments import SECONDS
from ..calibration.intrinsics import calibrate_footage, figures, print_results
from ..console import command_console
from . import calibrate_extrinsics

INTRINSICS_FOLDER = "output/intrinsics"
MODELS = (*COEFFICIENTS, AUTO)
FAILED = 1


def add_parser(subparsers: argparse._SubParsersAction) -> None:
    """Add the command and its three steps."""
    parser = subparsers.add_parser("calibrate", help="calibrate cameras and rig with a printed board")
    steps = parser.add_subparsers(title="steps", required=True, metavar="STEP")
    _add_board(steps)
    _add_intrinsics(steps)
    calibrate_extrinsics.add_parser(steps)


def _add_board(steps: argparse._SubParsersAction) -> None:
    parser = steps.add_parser("board", help="write a calibration board as SVG or PDF to print true to scale")
    inner, fields = '"checkerboard 9x6 25mm" (inner corners)', '"charuco 8x11 20mm 15mm DICT_5X5_100" (fields)'
    parser.add_argument("board", help=f"a YAML file (config/board/...), or {inner}, {fields}")
    parser.add_argument("--output", type=Path, default=Path("board.pdf"), metavar="FILE", help=".pdf or .svg")
    help_paper = "larger boards are laid over several pages (default: A4)"
    parser.add_argument("--paper", choices=sorted(PAPER_MM, reverse=True), default="A4", help=help_paper)
    parser.set_defaults(run=write_board)


def _add_intrinsics(steps: argparse._SubParsersAction) -> None:
    parser = steps.add_parser("intrinsics", help="each camera's lens, from footage of a board or live")
    help_sources = "a folder with a video or a folder of stills a camera, one video, or NAME=PATH"
    parser.add_argument("sources", nargs="*", metavar="SOURCE", help=help_sources)
    parser.add_argument("--topic", help="live: a camera's image topic, such as /cam01/image_raw")
    parser.add_argument("--board", required=True, help="its YAML file, or e.g. 'checkerboard 9x6 25mm' (inner corners)")
    help_model = f"lens: {', '.join(MODELS)} (the default: whichever predicts better)"
    parser.add_argument("--model", choices=MODELS, default=AUTO, metavar="MODEL", help=help_model)
    help_output = f"folder of the results (default: {INTRINSICS_FOLDER})"
    parser.add_argument("--output", default=INTRINSICS_FOLDER, help=help_output)
    parser.add_argument("--json", action="store_true", help="the last line is the figures as JSON")
    live = parser.add_argument_group("live, with --topic")
    live.add_argument("--name", help="the camera's name (default: from the topic)")
    live.add_argument("--seconds", type=SECONDS, help="end after so long, with what there is")
    views, help_views = number("views", 1, 1000, whole=True), "end after so many (default: when the lens is known well)"
    live.add_argument("--views", type=views, help=help_views)
    live.add_argument("--wait", type=SECONDS, default=10.0, help="give up when no image comes for so long, in seconds")
    help_set = "hand the result to the running camera client (its service set_camera_info)"
    live.add_argument("--set", action="store_true", dest="offer", help=help_set)
    parser.set_defaults(run=calibrate_cameras)


def write_board(args: argparse.Namespace) -> int:
    """Write the board, and print how to print it."""
    board = read_board(args.board)
    files = save_for_print(board, args.output, args.paper)
    width, height = (1e3 * side for side in print_size_m(board))
    print(f"{board_text(board)}: {width:g} x {height:g} mm, written to {', '.join(map(str, files))}")
    print("Print at 100 % (actual size), measure the 100 mm line, and glue the print flat onto a stiff plate.")
    print(f'For the other steps: --board "{board_text(board)}"')
    return 0


def calibrate_cameras(args: argparse.Namespace) -> int:
    """Calibrate every camera's lens; 0 when all results are usable, 1 when a camera must be done again."""
    if bool(args.sources) == bool(args.topic):
        remedy = "For example: sagoma calibrate intrinsics FOLDER --board 'checkerboard 9x6 25mm'."
        raise InputError("give either footage or --topic", where="sagoma calibrate intrinsics", remedy=remedy)
    board, console = read_board(args.board), command_console(stderr=args.json)
    failures: list[InputError] = []
    if args.topic:
        from ..calibration.live_lens import calibrate_live  # ROS takes a second to load

        results = [calibrate_live(args, board, console)]
    else:
        results, failures = calibrate_footage(args.sources, board, args.model, Path(args.output), console)
    print_results(console, results)
    for failure in failures:
        print(f"sagoma: {failure}", file=sys.stderr)
    if args.json:
        print(json.dumps({"cameras": [figures(result) for result in results], "failed": [str(f) for f in failures]}))
    return FAILED if failures or any(result.verdict.grade == REDO for result in results) else 0
