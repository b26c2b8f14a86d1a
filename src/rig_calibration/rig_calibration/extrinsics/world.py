"""The world frame (``map``): z up, origin on the floor, given by the board that lies there (thesis 6.1, REP-105)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
import numpy.typing as npt

from ..bundle.rigid import inverse

Array = npt.NDArray[np.float64]

CENTRE: Literal["centre"] = "centre"
FIRST_CORNER: Literal["first-corner"] = "first-corner"


@dataclass(frozen=True)
class WorldChoice:
    """Where the world lies on the floor board.

    origin : "centre" (the middle of the board's corners), "first-corner", or (x, y) in the board frame, metres: x along
    the rows, y towards the top of the print, from the first corner. heading : the angle from the board's rows to world
    x, rad, counterclockwise seen from above. thickness_m : how high the print lies above the floor.
    """

    origin: Literal["centre", "first-corner"] | tuple[float, float] = CENTRE
    heading: float = 0.0
    thickness_m: float = 0.0


def board_in_world(corners_board: Array, choice: WorldChoice) -> Array:
    """T_world_board (4, 4) of a board that lies on the floor, its print upwards; ``corners_board`` (n, 3)."""
    if choice.origin == CENTRE:
        origin_board = (corners_board.min(axis=0) + corners_board.max(axis=0)) / 2
    elif choice.origin == FIRST_CORNER:
        origin_board = corners_board[0]
    else:
        origin_board = np.array([*choice.origin, 0.0])
    c, s = np.cos(choice.heading), np.sin(choice.heading)
    T_world_board = np.eye(4)
    T_world_board[:3, :3] = [[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]]
    T_world_board[:3, 3] = [0.0, 0.0, choice.thickness_m] - T_world_board[:3, :3] @ origin_board
    return T_world_board


def world_from_floor(T_reference_board: Array, T_world_board: Array) -> Array:
    """T_world_reference (4, 4), when the board lies at ``T_reference_board`` on the floor."""
    return T_world_board @ inverse(T_reference_board)


def world_of_level_camera(T_camera_reference: Array) -> Array:
    """T_world_reference (4, 4) when no floor is known: the camera is taken for level, world x is where it looks, and
    the world's origin is its centre. Directions and distances are right but for that tilt; heights mean nothing."""
    T_world_camera = np.eye(4)
    T_world_camera[:3, :3] = [[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]]
    return T_world_camera @ T_camera_reference
