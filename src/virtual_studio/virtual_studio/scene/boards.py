"""Calibration targets as objects in the room: boards printed on stiff sheets, and a wand of glowing balls."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import cv2
import numpy as np
from numpy.typing import NDArray

from capture_rig.rigid import transform
from rig_calibration.boards.board import Board, CharucoBoard
from rig_calibration.boards.drawing import draw_board, print_size_m

from ..people import Capsules

Array = NDArray[np.float64]
PosePath = Callable[[float], Array]
"""Time, s, to a pose (4, 4)."""

BLACK, WHITE, BACK = 0.06, 0.85, 0.35
"""Albedos of ink, of paper, and of the sheet's other side."""
MARGIN = 0.6
"""White around the fields, in fields."""
TEXELS_PER_M = 1000.0
"""One a millimetre: edges of fields that measure whole millimetres lie between texels, which need no blending then."""
FINE_TEXELS_PER_M = 3000.0
"""For markers, whose cells are small."""
DIMMED = 0.2
"""Of the room's light, while the wand is swung."""
GLOW = 1.2
"""Light of a ball; beyond what the sensor takes."""
STICK_ALBEDO, STICK_RADIUS_M = 0.10, 0.008


@dataclass(frozen=True, eq=False)
class BoardPrint:
    """A board and its print at true scale.

    texture (r, c): 0 black to 255 white; H_texel_board (3, 3) maps [x, y, 1] of the board frame, m, to
    [column, row, 1]; texel (i, j) covers [j, j + 1) x [i, i + 1).
    """

    board: Board
    texture: NDArray[np.uint8]
    H_texel_board: Array

    @cached_property
    def edge_distance(self) -> NDArray[np.uint8]:
        """(r, c) texels to the nearest change of grey or end of the print; at most 255."""
        edge = np.zeros(self.texture.shape, bool)
        for axis in (0, 1):
            differs = np.diff(self.texture, axis=axis) != 0
            edge |= np.insert(differs, 0, True, axis) | np.insert(differs, differs.shape[axis], True, axis)
        away = cv2.distanceTransform(np.where(edge, 0, 255).astype(np.uint8), cv2.DIST_L2, cv2.DIST_MASK_PRECISE)
        return np.clip(np.floor(away - 1.0), 0, 255).astype(np.uint8)

    @cached_property
    def sheet_board(self) -> Array:
        """(4, 3) the sheet's corners, board frame, m: the first row's from left to right, then the last row's."""
        rows, columns = self.texture.shape
        texels = np.array([[0, 0, 1], [columns, 0, 1], [0, rows, 1], [columns, rows, 1]], float)
        places = texels @ np.linalg.inv(self.H_texel_board).T
        return np.column_stack([places[:, :2], np.zeros(4)])

    @cached_property
    def share_of_fields(self) -> Array:
        """(3,) of the sheet's width and height that its fields take; the rest is margin."""
        size = self.sheet_board.max(0) - self.sheet_board.min(0)
        return np.append(np.array(print_size_m(self.board)) / size[:2], 1.0)

    @cached_property
    def middle_board(self) -> Array:
        """(3,) the middle of the corners, board frame, m."""
        return self.board.corners_board.mean(axis=0)

    def centred(self, T_frame_middle: Array) -> Array:
        """Returns the board's pose T_frame_board (4, 4) that puts its middle into a pose."""
        return T_frame_middle @ transform(np.eye(3), -self.middle_board)


def print_of(board: Board) -> BoardPrint:
    """Prints a board, with a white margin."""
    charuco = isinstance(board, CharucoBoard)
    field = board.square_m if isinstance(board, CharucoBoard) else max(board.field_m)
    drawn = draw_board(board, FINE_TEXELS_PER_M if charuco else TEXELS_PER_M, MARGIN * field)
    centre_to_corner = np.array([[1, 0, 0.5], [0, 1, 0.5], [0, 0, 1.0]])
    return BoardPrint(board, np.ascontiguousarray(drawn.image), centre_to_corner @ drawn.T_pixel_board)


@dataclass(frozen=True, eq=False)
class PosedBoard:
    """A board in the room: ``T_world_board`` (K, 4, 4), one pose for each instant of the exposure (1: it is still)."""

    print: BoardPrint
    T_world_board: Array

    @property
    def middle(self) -> Array:
        """(4, 4) the pose in the middle of the exposure."""
        return self.T_world_board[len(self.T_world_board) // 2]

    @property
    def corners_world(self) -> Array:
        """(n, 3) the inner corners, m, in the middle of the exposure."""
        return self.print.board.corners_board @ self.middle[:3, :3].T + self.middle[:3, 3]


@dataclass(frozen=True)
class Wand:
    """Balls on a straight stick: where along it, m from the first one's centre, and how large."""

    marks_m: tuple[float, ...] = (0.0, 0.25, 0.4)
    radius_m: float = 0.02

    def balls_world(self, T_world_wand: Array) -> Array:
        """Return (n, 3) the balls' centres, m; the wand's frame has its origin in the first ball, x along the stick."""
        return np.multiply.outer(np.array(self.marks_m), T_world_wand[:3, 0]) + T_world_wand[:3, 3]

    def stick(self, T_world_wand: Array) -> Capsules:
        """Return the stick between the balls."""
        balls = self.balls_world(T_world_wand)
        return Capsules(balls[:1], balls[-1:], np.full((1, 2), STICK_RADIUS_M), np.array([STICK_ALBEDO]))
