"""A grid of fitted corners: refined in the raw image, checked against their neighbours, completed by prediction.

A grid is (rows, columns, 2) pixels, NaN where a corner is not known.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from capture_rig.lens import Array

from .lattice import HALF
from .x_corner import fit_x_corners

# --- Arithmetic on grids.


def steps(pixels: Array) -> tuple[Array, Array]:
    """Find the steps from each corner to the next in its row, and to the same one of the next row, both (rows, columns,
    2); mean of the steps on both sides where both are known, NaN where none is."""
    return _step(pixels, axis=1), _step(pixels, axis=0)


def predict(pixels: Array) -> Array:
    """Predict the unknown corners from the known ones in the same row and column, (rows, columns, 2): the mean between
    two neighbours where both are known, else extrapolated from up to three on one side; NaN where that fails."""
    guesses = []
    for axis in (0, 1):
        before = [_shifted(pixels, k, axis) for k in (1, 2, 3)]
        after = [_shifted(pixels, -k, axis) for k in (1, 2, 3)]
        between = 0.5 * (before[0] + after[0])
        one_sided = [_extrapolated(*side) for side in (before, after)]
        guesses.append(np.where(np.isfinite(between), between, mean_of_known(one_sided)))
    return np.where(np.isfinite(pixels), pixels, mean_of_known(guesses))


def mean_of_known(arrays: list[Array]) -> Array:
    """Average element by element, ignoring NaN; NaN where all are."""
    values = np.stack(arrays)
    known = ~np.isnan(values)
    with np.errstate(invalid="ignore"):  # a thread's own, as numpy.nanmean's warning of a mean of nothing is not
        return np.asarray(np.where(known, values, 0.0).sum(axis=0) / known.sum(axis=0))


def trimmed(values: Array) -> Array:
    """Cut off outer lines on which no more than one corner is known."""
    while values.size:
        known = np.isfinite(values[:, :, 0])
        counts = [known[0].sum(), known[-1].sum(), known[:, 0].sum(), known[:, -1].sum()]
        poorest = int(np.argmin(counts))
        if counts[poorest] > 1:
            break
        values = values[(np.s_[1:], np.s_[:-1], np.s_[:, 1:], np.s_[:, :-1])[poorest]]
    return values


def parity(shape: tuple[int, ...]) -> Array:
    """Return (rows, columns): 1 and -1 by turns, as the colours change from corner to corner."""
    return 1.0 - 2.0 * (np.indices(shape[:2]).sum(axis=0) % 2)


def _step(pixels: Array, axis: int) -> Array:
    return mean_of_known([_shifted(pixels, -1, axis) - pixels, pixels - _shifted(pixels, 1, axis)])


def _shifted(pixels: Array, by: int, axis: int) -> Array:
    """result[k] = pixels[k - by] along ``axis``; NaN where that lies outside."""
    result = np.full_like(pixels, np.nan)
    if abs(by) < pixels.shape[axis]:
        size = pixels.shape[axis]
        to, of = slice(max(by, 0), size + min(by, 0)), slice(max(-by, 0), size + min(-by, 0))
        index = (slice(None),) * axis
        result[(*index, to)] = pixels[(*index, of)]
    return result


def _extrapolated(first: Array, second: Array, third: Array) -> Array:
    """Extrapolate from the nearest three (a parabola), or the nearest two (a line)."""
    parabola = 3 * first - 3 * second + third
    return np.where(np.isfinite(parabola), parabola, 2 * first - second)


# Thresholds: measured by python bench/calibration.py --boards (found at which tilt and size).
MIN_FOUND = 0.7  # of a board's corners; a line of which more is found is a board's own


@dataclass(frozen=True, eq=False)
class CornerGrid:
    """A pattern of any size: ``values`` (rows, columns, 6), NaN where there is no corner: its place in pixels (2),
    contrast, standard deviation and blur (2), as :func:`fit_x_corners` gives them."""

    values: Array

    @property
    def pixels(self) -> Array:
        """(rows, columns, 2)."""
        return self.values[:, :, :2]

    @property
    def contrast(self) -> Array:
        return self.values[:, :, 2]

    @property
    def found(self) -> npt.NDArray[np.bool_]:
        return np.isfinite(self.contrast)

    @property
    def count(self) -> int:
        return int(self.found.sum())

    @property
    def sigma_px(self) -> float:
        """Standard deviation of a coordinate, by the fits' residuals."""
        return float(np.sqrt(np.nanmean(self.values[:, :, 3] ** 2)))

    @property
    def blur_px(self) -> float:
        """Standard deviation of the blur across the board's edges: median over the corners, the worse of the two
        directions (motion blurs the edges that it crosses). About 0.3 for a sharp image."""
        return float(np.nanmedian(self.values[:, :, 4:], axis=(0, 1)).max())


def empty_grid(rows: int, columns: int) -> CornerGrid:
    """Make a grid of which no corner is known yet."""
    return CornerGrid(np.full((rows, columns, 6), np.nan))


def fitted(image: npt.NDArray[np.uint8], expected: Array, known: CornerGrid, marker_margin: float = 1.0) -> CornerGrid:
    """Fit and add to ``known`` those of the ``expected`` corners (rows, columns, 2) that it lacks and that the image
    shows."""
    along, down = steps(expected)
    wanted = ~known.found & np.all(np.isfinite(np.dstack([expected, along, down])), axis=2)
    places, along, down = expected[wanted], along[wanted], down[wanted]
    corners, explained = fit_x_corners(image, places, along, down, marker_margin=marker_margin)
    side = np.minimum(np.linalg.norm(along, axis=1), np.linalg.norm(down, axis=1))
    near = np.linalg.norm(corners[:, :2] - places, axis=1) < np.maximum(HALF * side, 1.0)
    values, kept = known.values.copy(), known.found
    values[wanted], kept[wanted] = corners, explained & near
    # colours change from corner to corner; the majority decides which way round
    signs = np.where(kept, np.sign(values[:, :, 2]) * parity(kept.shape), 0)
    values[signs * (1.0 if signs.sum() >= 0 else -1.0) <= 0] = np.nan
    return CornerGrid(values)


def grown(image: npt.NDArray[np.uint8], grid: CornerGrid, marker_margin: float = 1.0) -> CornerGrid:
    """Grow the grid by one more line on each side where the image shows one, and fill its holes."""
    wider = CornerGrid(np.pad(grid.values, [(1, 1), (1, 1), (0, 0)], constant_values=np.nan))
    return CornerGrid(trimmed(fitted(image, predict(wider.pixels), wider, marker_margin).values))


def cut_to(grid: CornerGrid, rows: int, columns: int) -> CornerGrid | None:
    """Cut off surplus outer lines of a grid: a thumb at the board's edge resembles further fields.

    None when it is smaller than ``rows`` x ``columns``, or when the surplus lines are nearly complete.
    """
    values = grid.values
    for axis, wanted in enumerate((rows, columns)):
        while values.shape[axis] > wanted:
            found = np.isfinite(values[:, :, 0]).mean(axis=1 - axis)
            if min(found[0], found[-1]) > MIN_FOUND:
                return None
            values = np.delete(values, 0 if found[0] < found[-1] else -1, axis=axis)
    return CornerGrid(values) if values.shape[:2] == (rows, columns) else None


def turned(grid: CornerGrid, quarter_turns: int) -> CornerGrid:
    """Read the same corners from another of the four sides; a quarter turn swaps the colours' places, and rows and
    columns."""
    values = np.rot90(grid.values, quarter_turns).copy()
    if quarter_turns % 2:
        values[:, :, 2] *= -1
        values[:, :, 4:] = values[:, :, [5, 4]]
    return CornerGrid(values)


def is_black_first(grid: CornerGrid) -> bool:
    """Return whether the field up-left of the first corner is black."""
    return float(np.nansum(grid.contrast * parity(grid.contrast.shape))) < 0
