"""The floor from a board that is carried, and lies on the floor at some moment."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Literal

from capture_rig.camera import CameraModel
from capture_rig.errors import InputError

from ..boards.board import Board
from ..boards.sighting import Sighting
from ..bundle.rigid import inverse
from ..bundle.solve import solve_rig
from ..bundle.target_shape import turns_of
from .lying import find_lying, resting_around
from .moments import choose_moments

FloorAt = int | Literal["first", "last", "lowest"]


def moments_on_floor(
    cameras: Mapping[str, CameraModel], moving: Sequence[Sighting], board: Board, when: FloorAt
) -> tuple[int, ...]:
    """The moments at which the carried ``board`` lies on the floor, at one place.

    ``when``: a frame, the first or last one that shows the board, or "lowest": found by solving for the rig without a
    floor. Raises InputError when there is no such moment.
    """
    if not moving:
        raise InputError("no picture shows the carried board", remedy="Check --board and --moving.")
    if when == "first":
        return resting_around(moving, min(sighting.moment for sighting in moving))
    if when == "last":
        return resting_around(moving, max(sighting.moment for sighting in moving))
    if when != "lowest":
        return resting_around(moving, when)
    chosen = set(choose_moments(moving))
    if not chosen:
        raise InputError(
            "at no moment do two cameras show the carried board",
            remedy="Carry it where two or more cameras see it at once.",
        )
    some = [sighting for sighting in moving if sighting.moment in chosen]
    solution = solve_rig(
        cameras, some, {some[0].target: board.corners_board}, turnable={some[0].target: turns_of(board)}
    )
    poses = {moment: T for (_, moment), T in solution.T_reference_target.items()}
    centres = [inverse(T)[:3, 3] for T in solution.T_camera_reference.values()]
    return find_lying(poses, board.corners_board, centres)
