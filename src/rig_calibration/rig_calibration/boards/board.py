"""The calibration boards, plain checkerboards and ChArUco boards, and what one image shows of a target.

Board frame: seen from in front, x to the right along the rows of the print, y up, z out of the print towards the
viewer (so z is up when the board lies on the floor); origin at the first corner, the upper left one; metres.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TypeAlias

import cv2
import numpy as np
import numpy.typing as npt

from capture_rig.lens import Array


@dataclass(frozen=True)
class Checkerboard:
    """A checkerboard of ``columns`` x ``rows`` inner corners; ``field_m`` is (width, height) of one field.

    Fields need not be square: a floor board may be made of sheets of paper.
    """

    columns: int
    rows: int
    field_m: tuple[float, float]

    @property
    def corners_board(self) -> Array:
        """(columns * rows, 3) inner corners in reading order, board frame."""
        return _grid(self.columns, self.rows, self.field_m)

    @property
    def half_turn_is_visible(self) -> bool:
        """Whether the board looks different after half a turn: when one of its numbers is odd and the
        other even: the colours of opposite outer fields differ then."""
        return (self.columns + self.rows) % 2 == 1


@dataclass(frozen=True)
class CharucoBoard:
    """A ChArUco board (Garrido-Jurado et al. 2014; OpenCV's aruco module) of ``columns`` x ``rows`` fields.

    ``square_m`` and ``marker_m`` are the sides of a field and of a marker; ``dictionary`` is OpenCV's name, as
    "DICT_5X5_100"; ``legacy`` boards (OpenCV before 4.6) begin with a white field where the number of rows is even.
    """

    columns: int
    rows: int
    square_m: float
    marker_m: float
    dictionary: str
    legacy: bool = False

    @property
    def corners_board(self) -> Array:
        """((columns - 1) * (rows - 1), 3) inner corners in reading order, board frame."""
        return _grid(self.columns - 1, self.rows - 1, (self.square_m, self.square_m))

    @property
    def half_turn_is_visible(self) -> bool:
        """Whether a half turn shows: always, by its markers."""
        return True

    @property
    def starts_black(self) -> bool:
        """Whether the upper left field is black."""
        return not (self.legacy and self.rows % 2 == 0)


Board: TypeAlias = Checkerboard | CharucoBoard


def _grid(columns: int, rows: int, field_m: tuple[float, float]) -> Array:
    row, column = np.mgrid[:rows, :columns].reshape(2, -1)
    return np.column_stack([column * field_m[0], -row * field_m[1], np.zeros(columns * rows)])


@dataclass(frozen=True, eq=False)
class TargetDetection:
    """Corners of a target found in one image of one camera.

    camera : the camera's name. frame : which frame (what several cameras show in the same frame is in the same
    place). target : which of several targets, "" when there is only one. ids (n,) : which corners, rows of the
    target's ``corners_board``. pixels (n, 2) : where, in the raw (distorted) image; pixel centres at whole numbers.
    image_size : (width, height), px. sigma_px : standard deviation of a corner's coordinate, as far as it is known.
    blur_px : that of the blur across the board's edges, 0 where it was not measured.
    """

    camera: str
    frame_index: int
    ids: npt.NDArray[np.int64]
    pixels: Array
    image_size: tuple[int, int]
    target: str = ""
    sigma_px: float = 0.2
    blur_px: float = 0.0

    def __len__(self) -> int:
        return len(self.ids)


def opencv_board(board: CharucoBoard) -> cv2.aruco.CharucoBoard:
    """Make OpenCV's board, whose corner ids are ours."""
    dictionary = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, board.dictionary))
    theirs = cv2.aruco.CharucoBoard((board.columns, board.rows), board.square_m, board.marker_m, dictionary)
    theirs.setLegacyPattern(board.legacy)
    return theirs
