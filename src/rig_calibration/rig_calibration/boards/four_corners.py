"""Finds a board from its four outer corners, roughly pointed at, where it cannot be found by itself."""

from __future__ import annotations

from dataclasses import replace
from itertools import product

import numpy as np
import numpy.typing as npt
from scipy.spatial import cKDTree

from capture_rig.camera import CameraModel
from capture_rig.errors import InputError
from capture_rig.lens import Array

from .board import Board, CharucoBoard, TargetDetection
from .corner_grid import CornerGrid, is_black_first, predict, steps, turned
from .detector import FlatBoard, as_grey, complete, detection_of, followed, possible_orders
from .lattice import HALF, Variant, find_saddles

# Thresholds: judgement.
POINTING_ERROR_PX = 6.0
CANDIDATES = 3  # saddles looked at near each click
HIT_FIELDS, MIN_HIT_PX = 0.25, 1.0  # how near a saddle must lie to where a corner is expected
VARIANTS = (Variant(), Variant(1, 2), Variant(1, 3), Variant(1, 1, 2.5))
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
    model: CameraModel | None = None,
) -> TargetDetection:
    """Find the board whose outermost inner corners lie near ``outer_px`` (4, 2) pixels, up to 6 pixels or half a field
    off: in any order where the board's colours or markers tell which way round it lies; else in the print's reading
    order: first, end of the first row, last, start of the last row.

    ``model``: the camera, where its lens is known already: where the lens bends lines much, corners are expected in
    the right places then. The detection holds the corners that the image shows, to a part of a pixel. InputError when
    there is no such board.
    """
    where = f"camera '{camera}', frame {frame_index}" if camera else ""
    grey, outer = as_grey(image), np.asarray(outer_px, float)
    if outer.shape != (4, 2) or not np.isfinite(outer).all():
        raise InputError(
            f"four corners (x, y) in pixels are needed, not {np.shape(outer_px)}", where=where, remedy=ORDER
        )
    orders = [outer]
    if board.half_turn_is_visible:  # clockwise as seen; which of them is the first is settled below
        away = outer - outer.mean(axis=0)
        around = outer[np.argsort(np.arctan2(away[:, 1], away[:, 0]))]
        orders = [around, np.roll(around, 1, axis=0)]
    _require_clockwise(orders[0], where)
    view = FlatBoard(board, None if model is None else replace(model, T_camera_world=np.eye(4)))
    outer_ids = np.ravel_multi_index(OUTER, view.shape, mode="wrap")
    grids = [followed(grey, view, outer_ids, _snapped(grey, view, outer_ids, order)) for order in orders]
    best = int(np.argmax([grid.count for grid in grids]))
    grid, outer = grids[best], orders[best]
    if grid.count < HALF * grid.found.size:
        raise InputError(
            f"only {grid.count} of {grid.found.size} corners are seen where the four given ones put the board",
            where=where,
            remedy=f"{ORDER} Check that the board has {view.shape[1]} x {view.shape[0]} of them, and is in focus.",
        )
    ordered = _ordered(_whole(grey, grid, board), board, outer, where)
    return detection_of(ordered, grey.shape, camera=camera, frame_index=frame_index, target=target)


def _require_clockwise(outer: Array, where: str) -> None:
    sides = np.roll(outer, -1, axis=0) - outer
    turns = sides[:, 0] * np.roll(sides[:, 1], -1) - sides[:, 1] * np.roll(sides[:, 0], -1)
    if not np.all(turns > 0):
        wrong = "run round the board the wrong way" if np.all(turns < 0) else "are no convex quadrilateral"
        raise InputError(f"the four corners {wrong}", where=where, remedy=ORDER)


def _snapped(grey: npt.NDArray[np.uint8], view: FlatBoard, ids: npt.NDArray[np.int64], outer: Array) -> Array:
    """Return the four saddles near the given corners with which most of the board's corners fall onto saddles."""
    found = [variant.to_raw(find_saddles(variant.make(grey), variant.smoothing_px).pixels) for variant in VARIANTS]
    saddles = np.concatenate([*found, outer])
    tree = cKDTree(saddles)
    expected = view.corners(ids, outer)
    choices = []
    for corner, field in zip(outer, _fields_px(expected)[OUTER], strict=True):
        reach = max(POINTING_ERROR_PX, HALF * float(np.nan_to_num(field)))
        distance, index = tree.query(corner, k=min(3 * CANDIDATES, len(saddles)), distance_upper_bound=reach)
        choices.append([corner, *_distinct(saddles[index[np.isfinite(distance)]], corner)])
    tries = [np.array(four) for four in product(*choices)]
    return max(tries, key=lambda four: _hits(view.corners(ids, four), tree))


def _distinct(saddles: Array, corner: Array) -> list[Array]:
    """Return the nearest few, those that several looks show only once."""
    kept: list[Array] = []
    for saddle in saddles:
        if all(np.hypot(*(saddle - other)) > 0.7 for other in [corner, *kept]):
            kept.append(saddle)
    return kept[:CANDIDATES]


def _hits(expected: Array, tree: cKDTree) -> tuple[int, float]:
    """Return how many corners fall onto saddles; and, less being better, how far from them they lie."""
    near = np.maximum(HIT_FIELDS * _fields_px(expected), MIN_HIT_PX).ravel()
    distance, _ = tree.query(np.nan_to_num(expected.reshape(-1, 2), nan=-1e6))
    hit = distance < near
    return int(hit.sum()), -float(distance[hit].mean()) if hit.any() else 0.0


def _fields_px(corners: Array) -> Array:
    """Return the shorter side of the field at each corner, px (rows, columns)."""
    along, down = steps(corners)
    return np.fmin(np.linalg.norm(along, axis=2), np.linalg.norm(down, axis=2))


def _whole(grey: npt.NDArray[np.uint8], grid: CornerGrid, board: Board) -> CornerGrid:
    """A checkerboard that grew to its full size from what was found: corners given a field off do no harm then."""
    if isinstance(board, CharucoBoard) or grid.found.all():
        return grid
    full = complete(grey, grid.pixels, max(board.columns, board.rows))
    return full if full is not None and possible_orders(full, board) else grid


def _ordered(grid: CornerGrid, board: Board, outer: Array, where: str) -> CornerGrid:
    """Order the grid with the first corner first, where colours tell; else leave it as given."""
    if isinstance(board, CharucoBoard):
        choices = [each for each in (grid, turned(grid, 2)) if is_black_first(each) == board.starts_black]
    else:
        choices = possible_orders(grid, board)
    lines = [grid.found[0], grid.found[-1], grid.found[:, 0], grid.found[:, -1]]
    if not choices or not all(line.any() for line in lines):
        raise InputError(
            "the corners given seem to be a field off: colours are wrong there, or an outer line of "
            "corners is not seen",
            where=where,
            remedy=ORDER,
        )
    return min(choices, key=lambda choice: _off(choice, outer))


def _off(grid: CornerGrid, outer: Array) -> float:
    """Sum of the distances from the corners given to the found ones next in line, px."""
    filled = grid.pixels
    for _ in range(3):
        filled = predict(filled)
    return float(np.nansum(np.linalg.norm(filled[OUTER] - outer, axis=1)))
