"""Calibrates a rig's extrinsics, from pictures to files: the recipe of ``sagoma calibrate extrinsics``."""

from __future__ import annotations

import argparse
import math
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeAlias

from rich.console import Console

from capture_rig.errors import InputError
from capture_rig.files import make_folder
from capture_rig.rig import FARTHEST_M
from rig_calibration.boards.board import Board, read_board
from rig_calibration.boards.wand import WAND, wand_looks_alike, wand_points
from rig_calibration.extrinsics.board_frames import LOWEST, FloorAt
from rig_calibration.extrinsics.calibrate import RigCalibration, TapeMeasure, Target, calibrate_rig
from rig_calibration.extrinsics.world import WorldChoice

from .rig_detections import (
    CamerasDetections,
    Corners,
    FootageSources,
    detections_of,
    read_corners,
    write_corner_help,
    write_template,
)
from .rig_inputs import RigInputs, read_floor_points, read_intrinsics, read_lens_deviations, require_seen
from .rig_report import print_report, write_outputs

if TYPE_CHECKING:  # ROS takes a second to load
    from .rig_live import LiveSources
Sources: TypeAlias = "FootageSources | LiveSources"


def calibrate_extrinsics(request: RigRequest, sources: Sources, console: Console) -> RigCalibration:
    """Detect, solve, print, write. Raises InputError with the remedy for an unsolvable rig."""
    points = None if request.floor_points is None else read_floor_points(request.floor_points)
    names = {*sources.names, *(points.seen if points else ())} - set(request.without)
    cameras = read_intrinsics(request.intrinsics, names)
    corners = read_corners(request.corners) if request.corners is not None else {}
    floor = _detect_floor(request, sources, corners)
    moving = sources.detect_moving(request.board, cameras) if request.board is not None else {}
    wands = sources.detect_wand(request.wand_marks_m, cameras) if request.wand_marks_m else {}
    inputs = RigInputs()
    if points is not None:
        inputs.add_floor_points(points, cameras)
    if request.floor_board is not None:
        target = Target.of(request.floor_board, request.choice)
        seen = detections_of(floor)
        if set(corners) >= {detection.camera for detection in seen}:  # their order gives the way round the board lies
            target = replace(target, looks_alike=False)
        inputs.add_floor(seen, request.floor_board, target)
    if request.board is not None and (carried := detections_of(moving)):
        lying = inputs.add_moving(cameras, carried, request.board, request.choice, request.floor_at)
        if lying:
            console.print(f"floor: the carried board in frames {', '.join(map(str, lying))}")
    if wands:
        marks_m = request.wand_marks_m
        inputs.add_carried(detections_of(wands), WAND, Target(wand_points(marks_m), wand_looks_alike(marks_m)))
    searched = [("floor", floor, request.floor_board), ("moving", moving, request.board), ("wand", wands, None)]
    require_seen(cameras, inputs, searched)
    lens_sd = read_lens_deviations(request.intrinsics, cameras)
    calibrated = calibrate_rig(cameras, inputs.detections, inputs.targets, intrinsics_sd=lens_sd, tape=request.tape)
    print_report(console, calibrated)
    pictures = {name: seen.picture for name, seen in floor.items() if seen.picture is not None}
    for path in write_outputs(request.output, calibrated, pictures, request.text):
        console.print(f"written: {path}")
    return calibrated


def _detect_floor(request: RigRequest, sources: Sources, corners: Corners) -> CamerasDetections:
    board = request.floor_board
    if board is None:
        return {}
    unknown = sorted(set(corners) - set(sources.names) - set(request.without))
    if unknown:
        remedy = f"Known cameras: {', '.join(sources.names)}."
        raise InputError(f"there is no camera '{unknown[0]}'", where=str(request.corners), remedy=remedy)
    floor = sources.detect_floor(board, corners)
    if request.click is not None and floor:
        request_corners(request, floor)
    return floor


def request_corners(request: RigRequest, floor: CamerasDetections) -> None:
    """Raise InputError that asks for the corners in the requested cameras, or in all without a detection.

    Writes their pictures under a grid and a file to fill in beside the output.
    """
    wanted = [name for name in request.click or [name for name, seen in floor.items() if not seen.detections]]
    unknown = sorted(set(wanted) - set(floor))
    if unknown:
        remedy = f"Cameras with one: {', '.join(sorted(floor))}."
        raise InputError(f"there is no picture of the floor by '{unknown[0]}'", where="--click", remedy=remedy)
    if not wanted:
        return
    folder, template = make_folder(request.output.parent), request.output.with_suffix(".corners.yaml")
    shown = {name: floor[name].picture for name in wanted}
    pictures = [write_corner_help(folder, name, image) for name, image in shown.items() if image is not None]
    write_template(template, wanted)
    raise InputError(
        f"the board's corners are wanted of {', '.join(wanted)}",
        where="--click",
        remedy=f"Read the outer corners off {', '.join(map(str, pictures))}, write them into {template}, and run this "
        f"again with --corners {template}.",
    )


# the request ----------------------------------------------------------------------------------------------------------


NO_FLOOR = "none"


@dataclass(frozen=True)
class RigRequest:
    """What to calibrate, beside the pictures.

    board, floor_board : the carried one and the one on the floor; None where none is needed. floor_at : when the
    carried board lies on the floor; None when other pictures show the floor, or it is not wanted.
    click : cameras whose corners a person is to give, () for those in which no board is found, None for none.
    text : the arguments as typed, for the report.
    """

    intrinsics: Path
    output: Path
    board: Board | None = None
    floor_board: Board | None = None
    floor_points: Path | None = None
    floor_at: FloorAt | None = None
    wand_marks_m: tuple[float, ...] = ()
    corners: Path | None = None
    click: tuple[str, ...] | None = None
    without: tuple[str, ...] = ()
    choice: WorldChoice = field(default_factory=WorldChoice)
    tape: tuple[TapeMeasure, ...] = ()
    text: dict[str, Any] = field(default_factory=dict)


def request_from(args: argparse.Namespace) -> RigRequest:
    """Return the arguments of the command, checked against each other. Raises InputError."""
    _check_sources(args)
    texts = args.board, args.floor_board or args.board
    carried, lying = (None if text is None else read_board(text) for text in texts)
    marks = _numbers(args.wand_marks, None, "--wand-marks", "0,0.25,0.4") if args.wand else []
    apart = [TapeMeasure(a, b, *_numbers(m, 1, "--check", "cam01 cam02 3.42")) for a, b, m in args.check]
    high = [TapeMeasure(a, None, *_numbers(m, 1, "--check-height", "cam01 2.31")) for a, m in args.check_height]
    at = None if args.origin == "centre" else _numbers(args.origin, 2, "--origin", "centre, or x,y in metres")
    return RigRequest(
        intrinsics=Path(args.intrinsics),
        output=Path(args.output),
        board=carried or lying,
        floor_board=lying,
        floor_points=Path(args.floor_points) if args.floor_points else None,
        floor_at=_floor_at(args.floor_at, bool(args.floor or args.floor_points or args.live), bool(args.moving)),
        wand_marks_m=tuple(marks),
        corners=Path(args.corners) if args.corners else None,
        click=None if args.click is None else tuple(args.click),
        without=tuple(args.without),
        choice=WorldChoice(None if at is None else (at[0], at[1]), math.radians(args.heading), args.board_thickness),
        tape=(*apart, *high),
        text={key: value for key, value in vars(args).items() if key != "run" and value not in (None, [], False)},
    )


def _check_sources(args: argparse.Namespace) -> None:
    """Raise InputError where pictures, or what they show, are missing or given twice."""
    footage = bool(args.floor or args.moving or args.wand)
    if args.moving == [] and not args.live:
        raise InputError("no footage is given", where="--moving", remedy="Name its folder, or add --live.")
    if not (args.live or footage or args.floor_points):
        raise InputError("no pictures are given", remedy="Give --floor, --moving or --wand, or --live.")
    if args.live and footage:
        remedy = "Leave out the footage; write --moving alone to record a carried board."
        raise InputError("pictures come from the cameras", where="--live", remedy=remedy)
    if args.floor and args.floor_points:
        raise InputError("both give the floor", where="--floor, --floor-points", remedy="Leave one of them out.")
    if args.wand and args.wand_marks is None:
        remedy = "Write --wand-marks 0,0.25,0.4."
        raise InputError("the wand's markers are not given", where="--wand-marks", remedy=remedy)
    if not (args.board or args.floor_board) and (args.floor or args.moving or args.live):
        remedy = 'Say what was printed, e.g. --board "checkerboard 9x6 25mm".'
        raise InputError("no board is described", where="--board", remedy=remedy)


def _floor_at(text: str | None, has_floor: bool, has_moving: bool) -> FloorAt | None:
    """Return when the carried board lies on the floor: as given, else at its lowest place if nothing else shows it."""
    if text not in (None, NO_FLOOR) and (has_floor or not has_moving):
        why = "other pictures show the floor" if has_floor else "no board is carried"
        what = f"says when the carried board lies on the floor, but {why}"
        raise InputError(what, where="--floor-at", remedy="Leave it out.")
    if text == NO_FLOOR or has_floor or not has_moving:
        return None
    if text is None or text == LOWEST:
        return LOWEST
    if not text.isdigit():
        remedy = f"Give a frame's number (from 0), {LOWEST}, or {NO_FLOOR}."
        raise InputError(f"'{text}' is no frame", where="--floor-at", remedy=remedy)
    return int(text)


def _numbers(text: str, count: int | None, where: str, example: str) -> list[float]:
    """Return comma-separated numbers, metres, none larger than a rig may be."""
    try:
        numbers = [float(part) for part in text.split(",")]
    except ValueError:
        numbers = []
    within = all(abs(one) <= FARTHEST_M for one in numbers)  # NaN is not
    if not numbers or (count is not None and len(numbers) != count) or not within:
        raise InputError(f"'{text}' cannot be read", where=where, remedy=f"Write {where} {example}.")
    return numbers
