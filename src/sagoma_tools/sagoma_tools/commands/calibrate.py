"""``sagoma calibrate board | intrinsics | extrinsics``: boards to print, each camera's lens, the rig."""

from __future__ import annotations

import argparse
import json
import sys
from functools import partial
from pathlib import Path

from rich.console import Console

from capture_rig.errors import InputError
from capture_rig.settings import SECONDS, number
from capture_rig.stop_signals import StopOnSignal
from capture_rig.verdict import REDO
from rig_calibration.boards.board import board_text, read_board
from rig_calibration.boards.drawing import PAPER_MM, print_size_m, save_for_print
from rig_calibration.intrinsics.calibrate import AUTO
from rig_calibration.intrinsics.lens_model import MODELS

from ..calibration.intrinsics import calibrate_footage, figures, print_results
from ..console import FAILED, CommandConsole

INTRINSICS_FOLDER = "output/intrinsics"


def add_parser(subparsers: argparse._SubParsersAction) -> None:
    """Add the command and its three steps."""
    parser = subparsers.add_parser("calibrate", help="calibrate cameras and rig with a printed board")
    steps = parser.add_subparsers(title="steps", required=True, metavar="STEP")
    _add_board(steps)
    _add_intrinsics(steps)
    _add_extrinsics(steps)


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
    help_model = f"lens: {', '.join(MODELS)} or {AUTO} (the default: whichever predicts better)"
    parser.add_argument("--model", choices=(*MODELS, AUTO), default=AUTO, metavar="MODEL", help=help_model)
    help_output = f"folder of the results (default: {INTRINSICS_FOLDER})"
    parser.add_argument("--output", default=INTRINSICS_FOLDER, help=help_output)
    parser.add_argument("--json", action="store_true", help="the last line is the figures as JSON")
    live = parser.add_argument_group("live, with --topic")
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
    board, console = read_board(args.board), CommandConsole(stderr=args.json)
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


# extrinsics -----------------------------------------------------------------------------------------------------------


EPILOG = """\
A SOURCE is a folder (cam01.mp4, cam02.png, cam03/*.jpg ...), one video or still, or NAME=PATH.
The world: z up, origin on the floor in the middle of the floor board, x along its rows."""


def _add_extrinsics(steps: argparse._SubParsersAction) -> None:
    """Add the step."""
    parser = steps.add_parser(
        "extrinsics",
        help="where the cameras stand: a board on the floor, a board carried through the room",
        epilog=EPILOG,
    )
    _add_pictures(parser.add_argument_group("pictures"))
    _add_world(parser.add_argument_group("world"))
    option = parser.add_argument_group("where the floor board is not found").add_argument
    option("--corners", metavar="FILE", help="YAML: NAME: four [x, y] outer corners, in pixels")
    help_click = "write pictures with a grid, and a file of corners to fill in, of these cameras or of all without it"
    option("--click", nargs="*", default=None, metavar="NAME", help=help_click)
    option = parser.add_argument
    option("--without", nargs="+", default=[], metavar="NAME", help="leave these cameras out")
    many = {"action": "append", "default": []}
    help_check = "distance between two lenses, measured with a tape"
    option("--check", nargs=3, metavar=("NAME", "NAME", "METRES"), help=help_check, **many)
    help_height = "height of a lens above the floor, measured with a tape"
    option("--check-height", nargs=2, metavar=("NAME", "METRES"), help=help_height, **many)
    help_output = "rig file to write; report and pictures come beside it (default: rig.yaml)"
    option("--output", default="rig.yaml", metavar="FILE", help=help_output)
    parser.set_defaults(run=run_extrinsics)


def _add_pictures(group: argparse._ArgumentGroup) -> None:
    option = group.add_argument
    help_intrinsics = "one NAME.yaml (camera_info) a camera; or a rig file to take the lenses from"
    option("--intrinsics", required=True, metavar="FOLDER", help=help_intrinsics)
    option("--floor", nargs="+", default=[], metavar="SOURCE", help="the board lying still on the floor")
    help_moving = "a board carried through the room; same frame number = same moment"
    option("--moving", nargs="*", default=None, metavar="SOURCE", help=help_moving)
    option("--wand", nargs="+", default=[], metavar="SOURCE", help="a wand with bright markers, carried")
    option("--wand-marks", metavar="M,M,...", help="positions of its markers along it, metres")
    option("--board", metavar="TEXT|FILE", help='e.g. "checkerboard 9x6 25mm" (inner corners), or a YAML file')
    option("--floor-board", metavar="TEXT|FILE", help="the board on the floor, where it is another one")
    option("--live", action="store_true", help="take the pictures from the running cameras' image_raw topics")
    help_cameras = "with --live: these cameras (default: all that publish)"
    option("--cameras", nargs="+", default=[], metavar="NAME", help=help_cameras)


def _add_world(group: argparse._ArgumentGroup) -> None:
    option = group.add_argument
    corner = "in metres from its first corner, along its rows and towards the top of the print"
    help_origin = f"on the floor board: centre (default), or x,y {corner}"
    option("--origin", default="centre", metavar="WHERE", help=help_origin)
    help_heading = "from the board's rows to world x, counterclockwise from above"
    option("--heading", type=number("degrees", -360, 360), default=0.0, metavar="DEG", help=help_heading)
    option("--board-thickness", type=number("m", 0, 0.5), default=0.0, metavar="METRES", help="of the floor board")
    when = "a frame's number, lowest (default: found), or none (no floor is known)"
    option("--floor-at", metavar="WHEN", help=f"without --floor: when the carried board lies on the floor: {when}")
    option("--floor-points", metavar="FILE", help="YAML of points measured on the floor and seen by cameras")


def run_extrinsics(args: argparse.Namespace) -> int:
    """Calibrate; 0 when the rig can be used, 1 when it should be calibrated again."""
    from ..calibration.extrinsics import calibrate_extrinsics, request_from  # solver and numba take a second to load

    request, console = request_from(args), CommandConsole()
    if args.live:
        from ..calibration.rig_live import LiveSources
        from ..graph.ros_link import RosLink

        with RosLink("sagoma_calibrate") as link, StopOnSignal() as stop:
            wanted = args.cameras, args.without, args.moving is not None
            live = LiveSources(link.node, *wanted, partial(_prompt, console), stop)
            calibrated = calibrate_extrinsics(request, live, console)
    else:
        from ..calibration.rig_detections import FootageSources

        footage = FootageSources(args.floor, args.moving or (), args.wand, args.without)
        calibrated = calibrate_extrinsics(request, footage, console)
    return FAILED if calibrated.verdict.grade == REDO else 0


def _prompt(console: Console, what: str) -> None:
    """Prompt a person; on a terminal, wait for Enter."""
    if sys.stdin.isatty():
        console.input(f"{what}, then press Enter: ")
    else:
        console.print(what)
