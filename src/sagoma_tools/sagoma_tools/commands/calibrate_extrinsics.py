"""``sagoma calibrate extrinsics``: the cameras' poses, from a board on the floor and a board carried about."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from rich.console import Console

from capture_rig.errors import InputError
from capture_rig.number import number
from capture_rig.stop_signals import StopOnSignal
from capture_rig.verdict import REDO

from ..calibration.rig_request import RigRequest, read_boards, read_choice, read_floor_at, read_marks, read_tape
from ..console import command_console

NOT_GOOD_ENOUGH = 1
WIDTH = 120
EPILOG = """\
A SOURCE is a folder (cam01.mp4, cam02.png, cam03/*.jpg ...), one video or still, or NAME=PATH.
The world: z up, origin on the floor in the middle of the floor board, x along its rows."""


def add_parser(steps: argparse._SubParsersAction) -> None:
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
    help_click = "click the outer corners, of these cameras or of all in which it is not found"
    option("--click", nargs="*", default=None, metavar="NAME", help=help_click)
    option = parser.add_argument
    help_refine = "adjust focal lengths and principal points as well, as far as NAME.report.yaml leaves them uncertain"
    option("--refine-intrinsics", action="store_true", help=help_refine)
    option("--without", nargs="+", default=[], metavar="NAME", help="leave these cameras out")
    many = {"action": "append", "default": []}
    help_check = "distance between two lenses, measured with a tape"
    option("--check", nargs=3, metavar=("NAME", "NAME", "METRES"), help=help_check, **many)
    help_height = "height of a lens above the floor, measured with a tape"
    option("--check-height", nargs=2, metavar=("NAME", "METRES"), help=help_height, **many)
    help_output = "rig file to write; report and pictures come beside it (default: rig.yaml)"
    option("--output", default="rig.yaml", metavar="FILE", help=help_output)
    parser.set_defaults(run=run)


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
    help_origin = f"on the floor board: centre (default), first-corner, or x,y {corner}"
    option("--origin", default="centre", metavar="WHERE", help=help_origin)
    help_heading = "from the board's rows to world x, counterclockwise from above"
    option("--heading", type=number("degrees", -360, 360), default=0.0, metavar="DEG", help=help_heading)
    option("--board-thickness", type=number("m", 0, 0.5), default=0.0, metavar="METRES", help="of the floor board")
    when = "a frame's number, first, last, lowest (default: found), or none (no floor is known)"
    option("--floor-at", metavar="WHEN", help=f"without --floor: when the carried board lies on the floor: {when}")
    option("--floor-points", metavar="FILE", help="YAML of points measured on the floor and seen by cameras")


def run(args: argparse.Namespace) -> int:
    """Calibrate; 0 when the rig can be used, 1 when it should be calibrated again."""
    request = request_from(args)
    console = command_console(width=WIDTH)
    grade = _from_cameras(request, console) if request.live else _from_footage(request, console)
    return NOT_GOOD_ENOUGH if grade == REDO else 0


def _from_footage(request: RigRequest, console: Console) -> str:
    from ..calibration.extrinsics import calibrate_extrinsics  # the solver and numba take a second to load
    from ..calibration.rig_detections import FootageSources

    sources = FootageSources(request.floor, request.moving, request.wand, request.without, command_console(stderr=True))
    return calibrate_extrinsics(request, sources, console).verdict.grade


def _from_cameras(request: RigRequest, console: Console) -> str:
    from ..calibration.extrinsics import calibrate_extrinsics
    from ..calibration.rig_live import LiveSources
    from ..graph.ros_link import RosLink

    def ask(what: str) -> None:
        if sys.stdin.isatty():
            console.input(f"{what}, then press Enter: ")
        else:
            console.print(what)

    with RosLink("sagoma_calibrate") as link, StopOnSignal() as stop:
        sources = LiveSources(
            link.node, request.live_cameras, request.without, request.carried_live, console, ask, stop
        )
        return calibrate_extrinsics(request, sources, console).verdict.grade


def request_from(args: argparse.Namespace) -> RigRequest:
    """Return the arguments, checked against each other. Raises InputError."""
    moving = tuple(args.moving or ())
    if args.moving == [] and not args.live:
        raise InputError("no footage is given", where="--moving", remedy="Name its folder, or add --live.")
    if not args.live and not (args.floor or moving or args.wand or args.floor_points):
        raise InputError("no pictures are given", remedy="Give --floor, --moving or --wand, or --live.")
    if args.live and (args.floor or moving or args.wand):
        remedy = "Leave out the footage; write --moving alone to record a carried board."
        raise InputError("pictures come from the cameras", where="--live", remedy=remedy)
    if args.floor and args.floor_points:
        raise InputError("both give the floor", where="--floor, --floor-points", remedy="Leave one of them out.")
    has_floor = bool(args.floor or args.floor_points or args.live)
    board, floor_board = read_boards(args.board, args.floor_board, bool(args.floor or moving or args.live))
    return RigRequest(
        intrinsics=Path(args.intrinsics),
        output=Path(args.output),
        floor=tuple(args.floor),
        moving=moving,
        wand=tuple(args.wand),
        wand_marks_m=read_marks(args.wand_marks, bool(args.wand)),
        board=board,
        floor_board=floor_board,
        floor_points=Path(args.floor_points) if args.floor_points else None,
        floor_at=read_floor_at(args.floor_at, has_floor, bool(moving)),
        corners=Path(args.corners) if args.corners else None,
        click=None if args.click is None else tuple(args.click),
        without=tuple(args.without),
        refine_intrinsics=args.refine_intrinsics,
        choice=read_choice(args.origin, args.heading, args.board_thickness),
        live=args.live,
        carried_live=args.live and args.moving is not None,
        live_cameras=tuple(args.cameras),
        tape=read_tape(args.check, args.check_height),
        text={key: value for key, value in vars(args).items() if key != "run" and value not in (None, [], False)},
    )
