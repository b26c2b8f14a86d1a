"""The request to ``sagoma calibrate extrinsics``, and the checks of its arguments."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from capture_rig.errors import InputError
from capture_rig.rig import FARTHEST_M
from rig_calibration.boards.board import Board
from rig_calibration.boards.specification import read_board
from rig_calibration.extrinsics.carried_board import FloorAt
from rig_calibration.extrinsics.verdict import TapeMeasure
from rig_calibration.extrinsics.world import CENTRE, FIRST_CORNER, WorldChoice

NO_FLOOR = "none"


@dataclass(frozen=True)
class RigRequest:
    """What to calibrate, from which pictures.

    floor, moving, wand : sources of footage. board, floor_board : as written and as read; None where none is needed.
    floor_at : when the carried board lies on the floor; None when other pictures show the floor, or it is not wanted.
    live : take the pictures from the running cameras (of live_cameras, or all), with carried_live those of a carried
    board, too. refine_intrinsics : adjust the lenses, too. click : cameras whose corners are to be clicked, () for
    those in which no board is found, None for none.
    """

    intrinsics: Path
    output: Path
    floor: tuple[str, ...] = ()
    moving: tuple[str, ...] = ()
    wand: tuple[str, ...] = ()
    wand_marks_m: tuple[float, ...] = ()
    board: Board | None = None
    floor_board: Board | None = None
    floor_points: Path | None = None
    floor_at: FloorAt | None = None
    corners: Path | None = None
    click: tuple[str, ...] | None = None
    without: tuple[str, ...] = ()
    refine_intrinsics: bool = False
    choice: WorldChoice = field(default_factory=WorldChoice)
    tape: tuple[TapeMeasure, ...] = ()
    live: bool = False
    carried_live: bool = False
    live_cameras: tuple[str, ...] = ()
    text: dict[str, Any] = field(default_factory=dict)
    """The arguments as typed, for the report."""


def read_boards(board: str | None, floor_board: str | None, needed: bool) -> tuple[Board | None, Board | None]:
    """Return the carried board and the one on the floor; the latter is the former where it is not given."""
    if board is None and floor_board is None and needed:
        remedy = 'Say what was printed, e.g. --board "checkerboard 9x6 25mm".'
        raise InputError("no board is described", where="--board", remedy=remedy)
    carried = read_board(board) if board is not None else None
    lying = read_board(floor_board) if floor_board is not None else carried
    return carried or lying, lying


def read_choice(origin: str, heading_deg: float, thickness_m: float) -> WorldChoice:
    """Return the world's origin and heading on the floor board. Raises InputError."""
    heading = math.radians(heading_deg)
    if origin == CENTRE:
        return WorldChoice(CENTRE, heading, thickness_m)
    if origin == FIRST_CORNER:
        return WorldChoice(FIRST_CORNER, heading, thickness_m)
    x, y = _numbers(origin, 2, "--origin", "Give centre, first-corner, or x,y in metres: 0.5,-0.3.")
    return WorldChoice((x, y), heading, thickness_m)


def read_floor_at(text: str | None, has_floor: bool, has_moving: bool) -> FloorAt | None:
    """Return when the carried board lies on the floor: as given, else at its lowest place if nothing else shows it."""
    if text is not None and text != NO_FLOOR and (has_floor or not has_moving):
        raise InputError(
            "says when the carried board lies on the floor, but "
            + ("other pictures show the floor" if has_floor else "no board is carried"),
            where="--floor-at",
            remedy="Leave it out.",
        )
    if text == NO_FLOOR or has_floor or not has_moving:
        return None
    if text is None or text == "lowest":
        return "lowest"
    if text == "first":
        return "first"
    if text == "last":
        return "last"
    if not text.isdigit():
        remedy = "Give a frame's number (from 0), first, last, lowest, or none."
        raise InputError(f"'{text}' is no frame", where="--floor-at", remedy=remedy)
    return int(text)


def read_tape(distances: Sequence[Sequence[str]], heights: Sequence[Sequence[str]]) -> tuple[TapeMeasure, ...]:
    """Tape measures: NAME NAME METRES, NAME METRES."""
    pairs = [TapeMeasure(a, b, *_numbers(m, 1, "--check", "Write --check cam01 cam02 3.42.")) for a, b, m in distances]
    alone = [
        TapeMeasure(a, None, *_numbers(m, 1, "--check-height", "Write --check-height cam01 2.31.")) for a, m in heights
    ]
    return (*pairs, *alone)


def read_marks(text: str | None, has_wand: bool) -> tuple[float, ...]:
    """Positions of the markers along a wand, metres."""
    if not has_wand:
        return ()
    if text is None:
        raise InputError(
            "the wand's markers are not given", where="--wand-marks", remedy="Write --wand-marks 0,0.25,0.4."
        )
    marks = _numbers(text, None, "--wand-marks", "Write two to four positions along the wand: 0,0.25,0.4.")
    return tuple(marks)


def _numbers(text: str, count: int | None, where: str, remedy: str) -> list[float]:
    try:
        numbers = [float(part) for part in text.split(",")]
    except ValueError:
        numbers = []
    within = all(abs(one) <= FARTHEST_M for one in numbers)  # NaN is not
    if not numbers or (count is not None and len(numbers) != count) or not within:
        raise InputError(f"'{text}' cannot be read", where=where, remedy=remedy)
    return numbers
