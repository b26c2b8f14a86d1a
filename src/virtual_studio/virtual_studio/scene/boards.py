"""A board as a thing: its print on a stiff sheet, of which the studio's cameras see the front or the back."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import cv2
import numpy as np
from numba import njit
from numpy.typing import NDArray

from rig_calibration.boards.board import Board, CharucoBoard
from rig_calibration.boards.drawing import draw_board, print_size_m

from ..people import Capsules
from ..rendering.board_caster import Array

BLACK, WHITE, BACK = 0.06, 0.85, 0.35
"""Albedos of ink, of paper, and of the sheet's other side."""
MARGIN = 0.6
"""White around the fields, in fields."""
TEXELS_PER_M = 1000.0
"""One a millimetre: edges of fields that measure whole millimetres lie between texels, which need no blending then."""
FINE_TEXELS_PER_M = 3000.0
"""For markers, whose cells are small."""


@dataclass(frozen=True, eq=False)
class BoardPrint:
    """A board and its picture at true scale.

    texture (r, c): 0 black to 255 white; texels_board (3, 3) maps [x, y, 1] of the board frame, m, to [column, row, 1];
    texel (i, j) covers [j, j + 1) x [i, i + 1).
    """

    board: Board
    texture: NDArray[np.uint8]
    texels_board: Array

    @cached_property
    def clear(self) -> NDArray[np.uint8]:
        """(r, c) texels around that have the same grey and are on the print; at most 255."""
        edge = np.zeros(self.texture.shape, bool)
        for axis in (0, 1):
            differs = np.diff(self.texture, axis=axis) != 0
            edge |= np.insert(differs, 0, True, axis) | np.insert(differs, differs.shape[axis], True, axis)
        away = cv2.distanceTransform(np.where(edge, 0, 255).astype(np.uint8), cv2.DIST_L2, cv2.DIST_MASK_PRECISE)
        return np.clip(np.floor(away - 1.0), 0, 255).astype(np.uint8)

    @cached_property
    def sheet_board(self) -> Array:
        """(4, 3) the sheet's corners, board frame, m, in reading order: first row's, then the last's."""
        rows, columns = self.texture.shape
        texels = np.array([[0, 0, 1], [columns, 0, 1], [0, rows, 1], [columns, rows, 1]], float)
        places = texels @ np.linalg.inv(self.texels_board).T
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


def print_of(board: Board) -> BoardPrint:
    """The print of a board, with a white margin."""
    charuco = isinstance(board, CharucoBoard)
    field = board.square_m if isinstance(board, CharucoBoard) else max(board.field_m)
    drawn = draw_board(board, FINE_TEXELS_PER_M if charuco else TEXELS_PER_M, MARGIN * field)
    centre_to_corner = np.array([[1, 0, 0.5], [0, 1, 0.5], [0, 0, 1.0]])
    return BoardPrint(board, np.ascontiguousarray(drawn.image), centre_to_corner @ drawn.T_pixel_board)


# --- A wand of bright balls, in a room with dimmed lamps.

DIMMED = 0.2
"""Of the room's light, while the wand is swung."""
GLOW = 1.2
"""Light of a ball; beyond what the sensor takes."""
STICK_ALBEDO, STICK_RADIUS_M = 0.10, 0.008


@dataclass(frozen=True)
class Wand:
    """Balls on a straight stick: where along it, m from the first one's centre, and how large."""

    marks_m: tuple[float, ...] = (0.0, 0.25, 0.4)
    radius_m: float = 0.02

    def balls_world(self, T_world_wand: Array) -> Array:
        """(n, 3) the balls' centres, m; the wand's frame has its origin in the first ball, x along the stick."""
        return np.multiply.outer(np.array(self.marks_m), T_world_wand[:3, 0]) + T_world_wand[:3, 3]

    def stick(self, T_world_wand: Array) -> Capsules:
        """The stick between the balls."""
        balls = self.balls_world(T_world_wand)
        return Capsules(balls[:1], balls[-1:], np.full((1, 2), STICK_RADIUS_M), np.array([STICK_ALBEDO]))


@njit(cache=True, nogil=True)
def cast_ball(ideal, centre, radius, glow, places, box, light):
    """Draws a glowing ball: ``centre`` (3,) camera frame, m; the other arguments as of ``cast_board``."""
    c2 = centre[0] ** 2 + centre[1] ** 2 + centre[2] ** 2 - radius**2
    for py in range(box[1], box[3]):
        for px in range(box[0], box[2]):
            covered = 0.0
            for i in range(len(places)):
                sx, sy = places[i, 0], places[i, 1]
                a, b, c, d = (1.0 - sy) * (1.0 - sx), (1.0 - sy) * sx, sy * (1.0 - sx), sy * sx
                x = a * ideal[py, px, 0] + b * ideal[py, px + 1, 0] + c * ideal[py + 1, px, 0]
                y = a * ideal[py, px, 1] + b * ideal[py, px + 1, 1] + c * ideal[py + 1, px, 1]
                x, y = x + d * ideal[py + 1, px + 1, 0], y + d * ideal[py + 1, px + 1, 1]
                ahead = x * centre[0] + y * centre[1] + centre[2]
                if ahead > 0.0 and ahead * ahead > c2 * (1.0 + x * x + y * y):
                    covered += 1.0 / len(places)
            light[py, px] = (1.0 - covered) * light[py, px] + covered * glow


def ball_box(pixel: Array, reach_px: float, width: int, height: int) -> NDArray[np.int64]:
    """Pixels x0, y0, x1, y1 (end excluded) around a ball's picture; none where it is not in the picture."""
    if not np.isfinite(pixel).all():
        return np.zeros(4, np.int64)
    size = np.array([width, height])
    low, high = np.floor(pixel - reach_px - 1), np.ceil(pixel + reach_px + 2)
    return np.concatenate([np.clip(low, 0, size), np.clip(high, 0, size)]).astype(np.int64)
