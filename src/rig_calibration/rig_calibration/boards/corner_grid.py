"""A grid of fitted corners: refined in the raw image, checked against their neighbours, completed by prediction."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from .grid import padded, parity, predict, scatter_px, steps, trimmed
from .x_corner import XCorners, fit_x_corners

Array = npt.NDArray[np.float64]

MIN_FIT = 0.7  # share of a window's variance that the model of a corner must explain
MIN_LIKENESS = 0.4  # of opposite quadrants
MIN_CONTRAST = 0.25  # of the board's median
MAX_MOVE = 0.35  # of the shorter side of a field, from where a corner was expected
MAX_SD = 0.12  # of the shorter side of a field
MIN_OF_OUTER_LINE = 0.3
MAX_OF_EXTRA_LINE = 0.67  # a line of which more is found is the board's own: then it is a larger board


@dataclass(frozen=True, eq=False)
class CornerGrid:
    """Corners (rows, columns, 2) of a pattern of any size in pixels, NaN where there is none; their contrast, standard
    deviation (rows, columns), and blur (rows, columns, 2), as :class:`XCorners` has them."""

    pixels: Array
    contrast: Array
    sd_px: Array
    blur_px: Array

    @property
    def found(self) -> npt.NDArray[np.bool_]:
        return np.isfinite(self.pixels[:, :, 0])

    @property
    def count(self) -> int:
        return int(self.found.sum())

    @property
    def sigma_px(self) -> float:
        """Standard deviation of a coordinate: what the fits' residuals say, or the scatter of the corners about smooth
        lines where that is larger (compression, interlacing, an uneven print)."""
        from_fits = float(np.sqrt(np.nanmean(self.sd_px**2)))
        return max(from_fits, scatter_px(self.pixels))


def empty_grid(rows: int, columns: int) -> CornerGrid:
    """No corner known yet."""
    return _split(np.full((rows, columns, 6), np.nan))


def fitted(image: npt.NDArray[np.uint8], expected: Array, known: CornerGrid, marker_margin: float = 1.0) -> CornerGrid:
    """``known`` with those of the ``expected`` corners (rows, columns, 2) that it lacks and that the image shows."""
    along, down = steps(expected)
    wanted = ~known.found & np.all(np.isfinite(np.dstack([expected, along, down])), axis=2)
    corners = fit_x_corners(image, expected[wanted], along[wanted], down[wanted], marker_margin=marker_margin)
    good = _is_good(corners, expected[wanted], along[wanted], down[wanted], known.contrast[known.found])
    everything, kept = _joined(known), known.found
    everything[wanted] = np.column_stack([corners.pixels, corners.contrast, corners.sd_px, corners.blur_px])
    kept[wanted] = good
    kept &= _has_right_colour(everything[:, :, 2], kept)
    everything[~kept] = np.nan
    return _split(everything)


def grown(image: npt.NDArray[np.uint8], grid: CornerGrid, marker_margin: float = 1.0) -> CornerGrid:
    """The grid with one more line on each side where the image shows one, and holes filled."""
    wider = _split(padded(_joined(grid)))
    return without_ragged_rim(fitted(image, predict(wider.pixels), wider, marker_margin))


def without_ragged_rim(grid: CornerGrid) -> CornerGrid:
    """Outer lines of which little was found are chance finds; without them."""
    return _split(trimmed(_joined(grid), MIN_OF_OUTER_LINE))


def cut_to(grid: CornerGrid, rows: int, columns: int) -> CornerGrid | None:
    """The grid without the outer lines that it has too many: a thumb at the board's edge looks like some more fields.

    None when it is smaller than ``rows`` x ``columns``, or when the lines too many are nearly complete.
    """
    everything = _joined(grid)
    for axis, wanted in enumerate((rows, columns)):
        while everything.shape[axis] > wanted:
            found = np.isfinite(everything[:, :, 0]).mean(axis=1 - axis)
            if min(found[0], found[-1]) > MAX_OF_EXTRA_LINE:
                return None
            everything = np.delete(everything, 0 if found[0] < found[-1] else -1, axis=axis)
    return _split(everything) if everything.shape[:2] == (rows, columns) else None


def turned(grid: CornerGrid, quarter_turns: int) -> CornerGrid:
    """The same corners read from another of the four sides; a quarter turn swaps the colours' places, and rows and
    columns."""
    everything = np.rot90(_joined(grid), quarter_turns).copy()
    if quarter_turns % 2:
        everything[:, :, 2] *= -1
        everything[:, :, 4:] = everything[:, :, [5, 4]]
    return _split(everything)


def is_black_first(grid: CornerGrid) -> bool:
    """Is the field up-left of the first corner black?"""
    return float(np.nansum(grid.contrast * parity(grid.contrast.shape))) < 0


def _joined(grid: CornerGrid) -> Array:
    return np.dstack([grid.pixels, grid.contrast, grid.sd_px, grid.blur_px])


def _split(everything: Array) -> CornerGrid:
    return CornerGrid(everything[:, :, :2], everything[:, :, 2], everything[:, :, 3], everything[:, :, 4:])


def _is_good(corners: XCorners, expected: Array, along: Array, down: Array, usual: Array) -> npt.NDArray[np.bool_]:
    """Explained by the model, about as strong as the others, near where it was expected, well determined."""
    side = np.minimum(np.linalg.norm(along, axis=1), np.linalg.norm(down, axis=1))
    explained = (corners.fit > MIN_FIT) & (corners.likeness > MIN_LIKENESS)
    strength = np.abs(corners.contrast)
    others = np.concatenate([np.abs(usual), strength[explained]])
    typical = np.median(others) if len(others) else np.inf
    near = np.linalg.norm(corners.pixels - expected, axis=1) < np.maximum(MAX_MOVE * side, 1.0)
    return explained & (strength > MIN_CONTRAST * typical) & near & (corners.sd_px < MAX_SD * side)


def _has_right_colour(contrast: Array, kept: npt.NDArray[np.bool_]) -> npt.NDArray[np.bool_]:
    """Colours change from corner to corner; the majority says which way round."""
    signs = np.where(kept, np.sign(contrast) * parity(contrast.shape), 0)
    return signs * (1.0 if signs.sum() >= 0 else -1.0) > 0
