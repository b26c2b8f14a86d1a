"""Arithmetic on grids of corners: (rows, columns, 2) pixels, NaN where a corner is not known."""

from __future__ import annotations

import warnings

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]

MAX_BEND = 0.4  # of a field
CHI_SQUARE_MEDIAN = 0.4549  # of one degree of freedom


def steps(pixels: Array) -> tuple[Array, Array]:
    """From each corner to the next in its row, and to the same one of the next row, both (rows, columns, 2); mean of
    the steps on both sides where both are known, NaN where none is."""
    return _step(pixels, axis=1), _step(pixels, axis=0)


def predict(pixels: Array) -> Array:
    """The unknown corners from the known ones in the same row and column, (rows, columns, 2): the mean between two
    neighbours where both are known, else extrapolated from up to three on one side; NaN where nothing tells."""
    guesses = []
    for axis in (0, 1):
        before = [_shifted(pixels, k, axis) for k in (1, 2, 3)]
        after = [_shifted(pixels, -k, axis) for k in (1, 2, 3)]
        between = 0.5 * (before[0] + after[0])
        one_sided = [_extrapolated(*side) for side in (before, after)]
        guesses.append(np.where(np.isfinite(between), between, mean_of_known(one_sided)))
    return np.where(np.isfinite(pixels), pixels, mean_of_known(guesses))


def mean_of_known(arrays: list[Array]) -> Array:
    """Element by element, the mean of what is not NaN; NaN where all are."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)  # mean of nothing
        return np.nanmean(np.stack(arrays), axis=0)


def padded(pixels: Array) -> Array:
    """The grid with a rim of unknown corners all around."""
    return np.pad(pixels, [(1, 1), (1, 1), (0, 0)][: pixels.ndim], constant_values=np.nan)


def trimmed(pixels: Array, fewest: float) -> Array:
    """The grid without outer lines on which less than the share ``fewest`` of the corners, or only one, is known."""
    known = np.isfinite(pixels[:, :, 0])
    while known.size and known.any():
        lines = [known[0], known[-1], known[:, 0], known[:, -1]]
        if all(line.sum() >= max(2, fewest * line.size) for line in lines):
            break
        worst = int(np.argmin([line.sum() / line.size if line.sum() > 1 else line.sum() * 1e-3 for line in lines]))
        cut = [
            (slice(1, None), slice(None)),
            (slice(None, -1), slice(None)),
            (slice(None), slice(1, None)),
            (slice(None), slice(None, -1)),
        ][worst]
        pixels, known = pixels[cut], known[cut]
    return pixels


def parity(shape: tuple[int, ...]) -> Array:
    """(rows, columns): 1 and -1 by turns, as the colours change from corner to corner."""
    return 1.0 - 2.0 * (np.indices(shape[:2]).sum(axis=0) % 2)


def jogs(pixels: Array) -> npt.NDArray[np.bool_]:
    """(rows, columns): corners at which a row or column bends by more than ``MAX_BEND`` of a field, or changes its
    step by as much: neither lens nor perspective do that, but a line that slipped to the next one does."""
    along, down = steps(pixels)
    area = along[:, :, 0] * down[:, :, 1] - along[:, :, 1] * down[:, :, 0]
    bent = np.zeros(pixels.shape[:2], bool)
    for axis in (0, 1):
        bend = _shifted(pixels, 1, axis) - 2 * pixels + _shifted(pixels, -1, axis)
        u = (bend[:, :, 0] * down[:, :, 1] - bend[:, :, 1] * down[:, :, 0]) / area
        v = (bend[:, :, 1] * along[:, :, 0] - bend[:, :, 0] * along[:, :, 1]) / area
        bent |= np.maximum(np.abs(u), np.abs(v)) > MAX_BEND
    return bent


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
    """From the nearest three (a parabola), or the nearest two (a line)."""
    parabola = 3 * first - 3 * second + third
    return np.where(np.isfinite(parabola), parabola, 2 * first - second)


def scatter_px(pixels: Array) -> float:
    """Standard deviation of a coordinate about smooth lines: the fourth differences along rows and columns, which
    perspective and lens hardly reach (their variance is 70 times a coordinate's); 0 for lines too short to tell."""
    differences = []
    for axis in (0, 1):
        if pixels.shape[axis] > 4:
            fourth = np.diff(pixels, 4, axis=axis)
            differences.append(fourth[np.isfinite(fourth)])
    squares = np.concatenate([*differences, np.zeros(0)]) ** 2
    return float(np.sqrt(np.median(squares) / (70 * CHI_SQUARE_MEDIAN))) if len(squares) else 0.0
