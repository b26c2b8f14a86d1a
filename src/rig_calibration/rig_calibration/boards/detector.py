"""Finds a calibration board in one image, or names what the image shows instead.

A checkerboard is a lattice of corners: refined, completed and put into the board's order. Of a ChArUco board the
markers identify the corners, and fits of the corners give their places.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass

import cv2
import numpy as np
import numpy.typing as npt

from capture_rig.errors import InputError
from capture_rig.lens import Array

from .board import Board, CharucoBoard, Checkerboard, TargetDetection, board_text, opencv_board
from .corner_grid import (
    MIN_FOUND,
    CornerGrid,
    cut_to,
    empty_grid,
    fitted,
    grown,
    is_black_first,
    predict,
    steps,
    trimmed,
    turned,
)
from .lattice import HALF, MIN_CORNERS, Variant, find_lattices, variants_for

# --- Checkerboards.

# Thresholds: measured by python bench/calibration.py --boards.
GROWTH_ROUNDS = 30


def find_checkerboard(
    image: npt.NDArray[np.uint8], board: Checkerboard, variants: tuple[Variant, ...], marker_margin: float = 1.0
) -> CornerGrid | None:
    """Find the board's corners in its own order, or None. ``image`` (H, W) grey; ``marker_margin``: see
    fit_x_corners."""
    limit = max(board.columns, board.rows)
    for grid in checkerboard_patterns(image, variants, limit, marker_margin):
        ordered = in_board_order(grid, board)
        if ordered is not None and ordered.count >= MIN_FOUND * ordered.found.size:
            return ordered
    return None


def checkerboard_patterns(
    image: npt.NDArray[np.uint8], variants: tuple[Variant, ...], limit: int = 60, marker_margin: float = 1.0
) -> Iterator[CornerGrid]:
    """Find every checkerboard pattern of any size, the one that covers most of the image first; a pattern may come
    again from another variant of the image. None grows far beyond ``limit`` corners in both directions."""
    for variant in variants:
        for lattice in find_lattices(variant.make(image), variant.smoothing_px):
            grid = complete(image, variant.to_raw(lattice), limit, marker_margin)
            if grid is not None:
                yield grid


def complete(
    image: npt.NDArray[np.uint8], pixels: Array, limit: int = 60, marker_margin: float = 1.0
) -> CornerGrid | None:
    """Refine a lattice (rows, columns, 2) in the raw image, fill its holes and let it grow as far as the pattern goes.

    None when little of it is a checkerboard.
    """
    found = fitted(image, pixels, empty_grid(*pixels.shape[:2]), marker_margin)
    grid = CornerGrid(trimmed(found.values))
    for _ in range(GROWTH_ROUNDS):
        before = grid.count
        if before < 4 or min(grid.pixels.shape[:2]) > limit:
            break
        grid = grown(image, grid, marker_margin)
        if grid.count <= before:
            break
    return grid if grid.count >= MIN_CORNERS else None


def in_board_order(grid: CornerGrid, board: Checkerboard) -> CornerGrid | None:
    """Read the grid as (board.rows, board.columns) with the first corner first; None when its size differs.

    A board whose half turn is visible is laid so that the field up-left of the first corner is black; the others so
    that their rows run to the right in the image (one view does not show which half turn is right).
    """
    cut = (cut_to(turned(grid, turn), board.rows, board.columns) for turn in range(4))
    choices = [choice for choice in cut if choice is not None]
    if board.half_turn_is_visible or board.rows == board.columns:
        choices = [choice for choice in choices if is_black_first(choice)]
    return max(choices, key=_runs_right, default=None)


def _runs_right(grid: CornerGrid) -> tuple[float, float]:
    along, down = (np.nanmean(step, axis=(0, 1)) for step in steps(grid.pixels))
    return float(np.round(along[0] / np.hypot(*along), 6)), float(down[1])


# --- ChArUco boards.

ROUNDS = 12


def find_charuco(image: npt.NDArray[np.uint8], board: CharucoBoard, variants: tuple[Variant, ...]) -> CornerGrid | None:
    """Find the board's corners as a grid (rows - 1, columns - 1), NaN where none was seen; None when there is no
    board."""
    detector = cv2.aruco.CharucoDetector(opencv_board(board))
    for variant in variants:
        corners, ids, *_ = detector.detectBoard(variant.make(image))
        if ids is not None and len(ids) >= MIN_CORNERS:
            seen = variant.to_raw(np.reshape(corners, (-1, 2)).astype(float))
            grid = fit_grid(image, FlatBoard(board), np.ravel(ids), seen)
            if _is_plausible(grid, board):
                return grid
    return _by_colours(image, board, variants)


def _by_colours(image: npt.NDArray[np.uint8], board: CharucoBoard, variants: tuple[Variant, ...]) -> CornerGrid | None:
    """Find the whole board by its fields, where markers are too small or blurred; only of boards whose half turn is
    visible."""
    plain = Checkerboard(board.columns - 1, board.rows - 1, (board.square_m, board.square_m))
    if not plain.half_turn_is_visible:
        return None
    grid = find_checkerboard(image, plain, variants, FlatBoard(board).marker_margin)
    return turned(grid, 2) if grid is not None and not board.starts_black else grid


@dataclass(frozen=True, eq=False)
class FlatBoard:
    """How a flat board appears to a pinhole."""

    board: Board

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns of corners."""
        inner = int(isinstance(self.board, CharucoBoard))
        return self.board.rows - inner, self.board.columns - inner

    @property
    def marker_margin(self) -> float:
        """Width of the rim of a white field that no marker covers, over the field's side."""
        return 0.5 * (1 - self.board.marker_m / self.board.square_m) if isinstance(self.board, CharucoBoard) else 1.0

    def corners(self, ids: npt.NDArray[np.int64], pixels: Array) -> Array:
        """Return all corners (rows, columns, 2) of the board most of whose corners ``ids`` lie at ``pixels``."""
        places = self.board.corners_board[:, :2]
        homography = cv2.findHomography(places[ids], pixels, cv2.LMEDS)[0]
        if homography is None:
            return np.full((*self.shape, 2), np.nan)
        return np.asarray(cv2.perspectiveTransform(places[:, None], homography), float).reshape(*self.shape, 2)


def fit_grid(image: npt.NDArray[np.uint8], view: FlatBoard, ids: npt.NDArray[np.int64], corners: Array) -> CornerGrid:
    """Fit corners where a flat board with the corners ``ids`` has them, then those predicted from the found ones, until
    none is added."""
    grid, expected = empty_grid(*view.shape), view.corners(ids, corners)
    for _ in range(ROUNDS):
        before = grid.count
        grid = fitted(image, expected, grid, view.marker_margin)
        if grid.count < 4 or grid.count <= before:
            break
        near, flat = predict(grid.pixels), view.corners(np.flatnonzero(grid.found), grid.pixels[grid.found])
        expected = np.where(np.isfinite(near), near, flat)
    return grid


def _is_plausible(grid: CornerGrid, board: CharucoBoard) -> bool:
    """Enough corners, not all in one line, and the colours where this board has them."""
    rows, columns = np.nonzero(grid.found)
    spread = grid.count >= MIN_CORNERS and np.ptp(rows) >= 1 and np.ptp(columns) >= 1
    return bool(spread) and is_black_first(grid) == board.starts_black


def find_board(
    image: npt.NDArray[np.uint8],
    board: Board,
    *,
    camera: str = "",
    frame_index: int = 0,
    target: str = "",
    thorough: bool = False,
) -> TargetDetection | None:
    """Find the board's corners in an image (H, W) or (H, W, 3) BGR uint8; None when they are not found.

    Of a checkerboard the whole width and height must be seen (a hand may cover some corners); of a ChArUco board any
    part. ``thorough`` also searches for small, dim and blurred boards, and for boards on the floor at a grazing angle.
    The order of the ids follows the board's colours or markers; where a half turn is not visible (see
    ``Checkerboard.half_turn_is_visible``), rows are taken to run to the right in the image.
    """
    grey = as_grey(image)
    variants = variants_for(grey.shape, thorough)
    if isinstance(board, CharucoBoard):
        grid = find_charuco(grey, board, variants)
    else:
        grid = find_checkerboard(grey, board, variants)
    return (
        None if grid is None else detection_of(grid, grey.shape, camera=camera, frame_index=frame_index, target=target)
    )


def as_grey(image: npt.NDArray[np.uint8]) -> npt.NDArray[np.uint8]:
    """Make (H, W) uint8 of a grey or BGR image."""
    return np.asarray(cv2.cvtColor(image, cv2.COLOR_BGR2GRAY), np.uint8) if image.ndim == 3 else image


def detection_of(
    grid: CornerGrid, shape: tuple[int, ...], *, camera: str, frame_index: int, target: str
) -> TargetDetection:
    """Make a detection of the grid, which is in the board's order."""
    found = grid.found.ravel()
    return TargetDetection(
        camera=camera,
        frame_index=frame_index,
        target=target,
        ids=np.flatnonzero(found),
        pixels=grid.pixels.reshape(-1, 2)[found].copy(),
        image_size=(shape[1], shape[0]),
        sigma_px=grid.sigma_px,
        blur_px=grid.blur_px,
    )


# --- From four outer corners, roughly pointed at, where a board cannot be found by itself.

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
    off: in any order if the board's half turn is visible, else in the print's reading order: first, end of the first
    row, last, start of the last row.

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
    grid = max((fit_grid(grey, view, outer_ids, order) for order in orders), key=lambda grid: grid.count)
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


# --- What is seen instead of a board.

MIN_PATTERN_CORNERS = 9  # of a pattern worth mentioning
MIN_MARKERS = 3


def diagnose_board(image: npt.NDArray[np.uint8], board: Board) -> str | None:
    """Name in one clause what an image (H, W[, 3]) shows instead of the board: markers, or a checkerboard of another
    size; None when the board is found, or nothing like it."""
    if find_board(image, board) is not None:
        return None
    grey = as_grey(image)
    if dictionary := _dictionary_seen(grey):
        return f"markers of {dictionary} were seen, not as on {board_text(board)}"
    patterns = checkerboard_patterns(grey, variants_for(grey.shape, thorough=False))
    grid = max(patterns, key=lambda grid: grid.count, default=None)
    if grid is None or grid.count < MIN_PATTERN_CORNERS:
        return None
    columns, rows = sorted(grid.pixels.shape[:2], reverse=True)
    seen = f"{grid.count} corners of a checkerboard of {columns} x {rows} inner corners were seen"
    return f"{seen} instead of {board_text(board)}: another board, or partly hidden or outside the image"


def _dictionary_seen(grey: npt.NDArray[np.uint8]) -> str:
    """OpenCV's family of dictionaries of which most markers are seen, as DICT_5X5; "" when there are too few."""
    seen = {"": MIN_MARKERS - 1}
    for name in sorted(name for name in dir(cv2.aruco) if re.fullmatch(r"DICT_(\dX\d_1000|ARUCO_ORIGINAL)", name)):
        dictionary = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, name))
        _, ids, _ = cv2.aruco.ArucoDetector(dictionary).detectMarkers(grey)
        seen[name.removesuffix("_1000")] = 0 if ids is None else len(ids)
    return max(seen, key=lambda name: seen[name])
