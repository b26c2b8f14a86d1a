"""Finds a ChArUco board, or the part of it that the image shows: markers say which corners, fits say where they are."""

from __future__ import annotations

import cv2
import numpy as np
import numpy.typing as npt

from .board import CharucoBoard, Checkerboard
from .checkerboard import find_checkerboard
from .corner_grid import CornerGrid, empty_grid, fitted, is_black_first, turned
from .grid import predict
from .image_variants import Variant
from .opencv_charuco import opencv_board

Array = npt.NDArray[np.float64]

MIN_CORNERS = 6
MAX_FROM_PLANE = 0.4  # of a field: further from where a flat board would have it, a corner is another board's
ROUNDS = 4
SMALLEST_MARKER = 0.01  # perimeter over the image's longer side


def find_charuco(image: npt.NDArray[np.uint8], board: CharucoBoard, variants: tuple[Variant, ...]) -> CornerGrid | None:
    """The board's corners as a grid (rows - 1, columns - 1), NaN where none was seen; None when there is no board."""
    detector = charuco_detector(board)
    for variant in variants:
        corners, ids, *_ = detector.detectBoard(variant.make(image))
        if ids is not None and len(ids) >= MIN_CORNERS:
            grid = _refined(image, board, variant.to_raw(np.reshape(corners, (-1, 2)).astype(float)), np.ravel(ids))
            if grid is not None:
                return grid
    return _by_colours(image, board, variants)


def _by_colours(image: npt.NDArray[np.uint8], board: CharucoBoard, variants: tuple[Variant, ...]) -> CornerGrid | None:
    """The whole board where its markers are too small or too blurred to be read, but its fields are seen; only of
    boards that look different when they are turned by half."""
    plain = Checkerboard(board.columns - 1, board.rows - 1, (board.square_m, board.square_m))
    if not plain.half_turn_is_visible:
        return None
    grid = find_checkerboard(image, plain, variants, marker_margin(board))
    return turned(grid, 2) if grid is not None and not _starts_black(board) else grid


def _starts_black(board: CharucoBoard) -> bool:
    return not (board.legacy and board.rows % 2 == 0)


def charuco_detector(board: CharucoBoard) -> cv2.aruco.CharucoDetector:
    """OpenCV's detector, for small markers too."""
    charuco, marker = cv2.aruco.CharucoParameters(), cv2.aruco.DetectorParameters()
    marker.minMarkerPerimeterRate = SMALLEST_MARKER
    return cv2.aruco.CharucoDetector(opencv_board(board), charuco, marker)


def marker_margin(board: CharucoBoard) -> float:
    """Width of the rim of a white field that its marker leaves free, over the field's side."""
    return 0.5 * (1 - board.marker_m / board.square_m)


def _refined(image: npt.NDArray[np.uint8], board: CharucoBoard, corners: Array, ids: npt.NDArray) -> CornerGrid | None:
    """Fit the corners that the markers gave, then their neighbours, as far as the image shows them."""
    shape = board.rows - 1, board.columns - 1
    margin = marker_margin(board)
    expected = _on_plane(board, corners, ids)
    if expected is None:
        return None
    expected.reshape(-1, 2)[ids] = corners
    grid = fitted(image, expected, empty_grid(*shape), margin)
    for _ in range(ROUNDS):
        before = grid.count
        grid = fitted(image, predict(grid.pixels), grid, margin)
        if grid.count <= before:
            break
    return grid if _is_plausible(grid, board) else None


def _on_plane(board: CharucoBoard, corners: Array, ids: npt.NDArray) -> Array | None:
    """Where a flat board's corners lie (rows - 1, columns - 1, 2) if those with ``ids`` lie at ``corners``; None when
    these do not fit one plane (markers of another board)."""
    places = board.corners_board[:, :2]
    homography, _ = cv2.findHomography(places[ids], corners, cv2.LMEDS)
    if homography is None:
        return None
    flat = cv2.perspectiveTransform(places[:, None], homography).astype(float)
    all_corners: Array = flat.reshape(board.rows - 1, board.columns - 1, 2)
    side = np.nanmedian(np.linalg.norm(np.diff(all_corners, axis=1), axis=2))
    off = np.linalg.norm(all_corners.reshape(-1, 2)[ids] - corners, axis=1)
    return all_corners if np.mean(off < MAX_FROM_PLANE * side) > 0.7 else None


def _is_plausible(grid: CornerGrid, board: CharucoBoard) -> bool:
    """Enough corners, not all in one line, and the colours where this board has them."""
    rows, columns = np.nonzero(grid.found)
    spread = grid.count >= MIN_CORNERS and np.ptp(rows) >= 1 and np.ptp(columns) >= 1
    return bool(spread) and is_black_first(grid) == _starts_black(board)
