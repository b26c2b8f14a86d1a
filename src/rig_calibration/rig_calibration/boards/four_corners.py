"""Finds a board from its four outer corners, roughly pointed at, where it cannot be found by itself."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from capture_rig.errors import InputError
from capture_rig.lens import Array

from .board import Board, CharucoBoard, TargetDetection
from .corner_grid import is_black_first, turned
from .detector import FlatBoard, as_grey, detection_of, followed
from .lattice import HALF

OUTER = ((0, 0, -1, -1), (0, -1, -1, 0))  # rows and columns of the outermost corners, in reading order
ORDER = "Give the outermost inner corners in reading order: first, end of first row, last, start of last row."


def find_from_outer_corners(
    image: npt.NDArray[np.uint8],
    board: Board,
    outer_px: npt.ArrayLike,
    *,
    camera: str = "",
    frame_index: int = 0,
    target: str = "",
) -> TargetDetection:
    """Find the board whose outermost inner corners lie near ``outer_px`` (4, 2) pixels, up to 6 pixels or half a field
    off: in any order where the board's colours tell which way round it lies; else in the print's reading order: first,
    end of the first row, last, start of the last row.

    The detection holds the corners that the image shows, to a part of a pixel. InputError when there is no such board.
    """
    where = f"camera '{camera}', frame {frame_index}" if camera else ""
    grey, outer = as_grey(image), np.asarray(outer_px, float)
    if outer.shape != (4, 2) or not np.isfinite(outer).all():
        raise InputError(
            f"four corners (x, y) in pixels are needed, not {np.shape(outer_px)}", where=where, remedy=ORDER
        )
    view = FlatBoard(board)
    colours_tell, orders = sum(view.shape) % 2 == 1, [outer]
    if colours_tell:  # clockwise as seen; which of them is the first is settled below
        away = outer - outer.mean(axis=0)
        around = outer[np.argsort(np.arctan2(away[:, 1], away[:, 0]))]
        orders = [around, np.roll(around, 1, axis=0)]
    _require_clockwise(orders[0], where)
    outer_ids = np.ravel_multi_index(OUTER, view.shape, mode="wrap")
    grid = max((followed(grey, view, outer_ids, order) for order in orders), key=lambda grid: grid.count)
    if grid.count < HALF * grid.found.size:
        raise InputError(
            f"only {grid.count} of {grid.found.size} corners are seen where the four given ones put the board",
            where=where,
            remedy=f"{ORDER} Check that the board has {view.shape[1]} x {view.shape[0]} of them, and is in focus.",
        )
    if not all(line.any() for line in (grid.found[0], grid.found[-1], grid.found[:, 0], grid.found[:, -1])):
        what = "the corners given seem to be a field off: an outer line of corners is not seen"
        raise InputError(what, where=where, remedy=ORDER)
    if colours_tell and is_black_first(grid) != (not isinstance(board, CharucoBoard) or board.starts_black):
        grid = turned(grid, 2)
    return detection_of(grid, grey.shape, camera=camera, frame_index=frame_index, target=target)


def _require_clockwise(outer: Array, where: str) -> None:
    sides = np.roll(outer, -1, axis=0) - outer
    turns = sides[:, 0] * np.roll(sides[:, 1], -1) - sides[:, 1] * np.roll(sides[:, 0], -1)
    if not np.all(turns > 0):
        wrong = "run round the board the wrong way" if np.all(turns < 0) else "are no convex quadrilateral"
        raise InputError(f"the four corners {wrong}", where=where, remedy=ORDER)
