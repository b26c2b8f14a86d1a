"""Says what is seen instead, when a board is not found in an image."""

from __future__ import annotations

import re

import cv2
import numpy as np
import numpy.typing as npt

from .board import Board, CharucoBoard, Checkerboard
from .charuco import charuco_detector, find_charuco
from .checkerboard import checkerboard_patterns, find_checkerboard, possible_orders
from .corner_grid import CornerGrid
from .detection import as_grey
from .grid import steps
from .image_variants import variants_for

MIN_CORNERS = 9  # of a pattern worth mentioning
MIN_MARKERS = 3
LITTLE_CONTRAST, DARK, BRIGHT = 25, 25, 230  # grey levels


def diagnose_board(image: npt.NDArray[np.uint8], board: Board) -> str | None:
    """One clause about what an image (H, W[, 3]) shows instead of the board: one of another size or kind, a part of it,
    markers of another dictionary, too little light; None when the board is found, or there is nothing to say."""
    grey = as_grey(image)
    variants = variants_for(grey.shape, thorough=False)
    if isinstance(board, CharucoBoard):
        found = find_charuco(grey, board, variants)
        return None if found is not None else _about_markers(grey, board) or _about_light(grey)
    if find_checkerboard(grey, board, variants) is not None:
        return None
    if dictionary := _dictionary_seen(grey):
        return f"a board with markers of {dictionary} was seen instead of a plain checkerboard"
    patterns = [grid for grid in checkerboard_patterns(grey, variants) if grid.count >= MIN_CORNERS]
    if patterns:
        return _about_pattern(max(patterns, key=lambda grid: grid.count), board, grey.shape)
    return _about_light(grey)


def _about_pattern(grid: CornerGrid, board: Checkerboard, shape: tuple[int, ...]) -> str:
    columns, rows = sorted(grid.pixels.shape[:2], reverse=True)
    wanted_columns, wanted_rows = sorted((board.columns, board.rows), reverse=True)
    wanted = f"{board.columns} x {board.rows}"
    if possible_orders(grid, board):
        return f"only {grid.count} of the board's {columns * rows} corners were seen: something hides the others"
    if (columns + 1, rows + 1) == (wanted_columns, wanted_rows):
        seen = f"a checkerboard of {columns} x {rows} inner corners was seen"
        return f"{seen}: {wanted} is its number of fields, but the inner corners count"
    if columns <= wanted_columns and rows <= wanted_rows and _ends_at_border(grid, shape):
        return f"only {columns} x {rows} of the board's {wanted} corners were seen: the others lie outside the image"
    return f"a checkerboard of {columns} x {rows} inner corners was seen instead of {wanted}"


def _ends_at_border(grid: CornerGrid, shape: tuple[int, ...]) -> bool:
    """Would the line after the next one, on some side, lie outside the image?"""
    along, down = steps(grid.pixels)
    before, after = grid.pixels - 2 * along, grid.pixels + 2 * along
    above, below = grid.pixels - 2 * down, grid.pixels + 2 * down
    beyond = [before[:, 0], after[:, -1], above[0], below[-1]]
    outside = [(line < 0) | (line > [shape[1] - 1, shape[0] - 1]) for line in beyond]
    return any(side.any(axis=1).mean() > 0.5 for side in outside)


def _about_markers(grey: npt.NDArray[np.uint8], board: CharucoBoard) -> str | None:
    detector = charuco_detector(board)
    *_, ids = detector.detectBoard(grey)
    own = 0 if ids is None else len(ids)
    if own >= MIN_MARKERS:
        size = f"{board.columns} x {board.rows} fields"
        return f"{own} markers of {board.dictionary} were seen, not as on a board of {size} (another size, or legacy?)"
    if (dictionary := _dictionary_seen(grey)) and dictionary != board.dictionary:
        return f"markers of {dictionary} were seen instead of {board.dictionary}"
    variants = variants_for(grey.shape, thorough=False)
    if any(grid.count >= MIN_CORNERS for grid in checkerboard_patterns(grey, variants)):
        return "a checkerboard was seen, but no markers on it that can be read: too small, too blurred, or none"
    return f"only {own} markers were seen" if own else None


def _dictionary_seen(grey: npt.NDArray[np.uint8]) -> str:
    """OpenCV's dictionary of which most markers are seen, the smallest of those; "" when there are too few."""
    names = sorted(name for name in dir(cv2.aruco) if re.fullmatch(r"DICT_(\dX\d_1000|ARUCO_ORIGINAL)", name))
    best, most = "", MIN_MARKERS - 1
    for name in names:
        dictionary = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, name))
        _, ids, _ = cv2.aruco.ArucoDetector(dictionary).detectMarkers(grey)
        if ids is not None and len(ids) > most:
            best, most = _smallest(name, int(np.max(ids))), len(ids)
    return best


def _smallest(name: str, highest_id: int) -> str:
    if not name.endswith("_1000"):
        return name
    return name.removesuffix("1000") + next(size for size in ("50", "100", "250", "1000") if highest_id < int(size))


def _about_light(grey: npt.NDArray[np.uint8]) -> str | None:
    low, high = np.percentile(grey, [2, 98])
    if high < DARK:
        return "the image is nearly black: more light, or a longer exposure"
    if low > BRIGHT:
        return "the image is overexposed: less light, or a shorter exposure"
    return "the image has hardly any contrast" if high - low < LITTLE_CONTRAST else None
