"""Finds a checkerboard in an image: a lattice of corners, refined, completed, and put into the board's order."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import numpy.typing as npt

from .board import Checkerboard
from .corner_grid import CornerGrid, cut_to, empty_grid, fitted, grown, is_black_first, turned, without_ragged_rim
from .grid import jogs, steps
from .image_variants import Variant
from .lattice import find_lattices

MIN_FOUND = 0.7  # of a board's corners
MIN_CORNERS = 6
GROWTH_ROUNDS = 30


def find_checkerboard(
    image: npt.NDArray[np.uint8], board: Checkerboard, variants: tuple[Variant, ...], marker_margin: float = 1.0
) -> CornerGrid | None:
    """The board's corners in its own order, or None. ``image`` (H, W) grey; ``marker_margin``: see fit_x_corners."""
    limit = max(board.columns, board.rows)
    for grid in checkerboard_patterns(image, variants, limit, marker_margin):
        ordered = in_board_order(grid, board)
        if ordered is not None and ordered.count >= MIN_FOUND * ordered.found.size:
            return ordered
    return None


def checkerboard_patterns(
    image: npt.NDArray[np.uint8], variants: tuple[Variant, ...], limit: int = 60, marker_margin: float = 1.0
) -> Iterator[CornerGrid]:
    """Every checkerboard pattern of any size, the one that covers most of the image first; a pattern may come again
    from another variant of the image. None grows far beyond ``limit`` corners in both directions."""
    for variant in variants:
        for lattice in find_lattices(variant.make(image), variant.smoothing_px):
            grid = complete(image, variant.to_raw(lattice.pixels), limit, marker_margin)
            if grid is not None:
                yield grid


def complete(
    image: npt.NDArray[np.uint8], pixels: npt.NDArray[np.float64], limit: int = 60, marker_margin: float = 1.0
) -> CornerGrid | None:
    """Refine a lattice (rows, columns, 2) in the raw image, fill its holes and let it grow as far as the pattern goes.

    None when little of it is a checkerboard.
    """
    pixels = np.where(jogs(pixels)[:, :, None], np.nan, pixels)
    grid = without_ragged_rim(fitted(image, pixels, empty_grid(*pixels.shape[:2]), marker_margin))
    for _ in range(GROWTH_ROUNDS):
        before = grid.count
        if before < 4 or min(grid.pixels.shape[:2]) > limit:
            break
        grid = grown(image, grid, marker_margin)
        if grid.count <= before:
            break
    return grid if grid.count >= MIN_CORNERS and not jogs(grid.pixels).any() else None


def in_board_order(grid: CornerGrid, board: Checkerboard) -> CornerGrid | None:
    """The grid as (board.rows, board.columns) with the first corner first; None when its size is another.

    A board whose half turn is visible is laid so that the field up-left of the first corner is black; the others so
    that their rows run to the right in the image (which half turn is meant, one view does not tell).
    """
    return max(possible_orders(grid, board), key=_runs_right, default=None)


def possible_orders(grid: CornerGrid, board: Checkerboard) -> list[CornerGrid]:
    """The grid read from those of its four sides that give the board's size and, where they tell, its colours."""
    cut = (cut_to(turned(grid, turn), board.rows, board.columns) for turn in range(4))
    choices = [choice for choice in cut if choice is not None]
    if board.half_turn_is_visible or board.rows == board.columns:
        choices = [choice for choice in choices if is_black_first(choice)]
    return choices


def _runs_right(grid: CornerGrid) -> tuple[float, float]:
    along, down = (np.nanmean(step, axis=(0, 1)) for step in steps(grid.pixels))
    return float(np.round(along[0] / np.hypot(*along), 6)), float(down[1])
