"""The hull as a coarse map of cells, so that hundreds of poses can be asked whether they lie in it."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit

CELL_M = 0.05  # a cell and its neighbours count as hull: within 0.05 to 0.1 m of a sample


class HullMap(NamedTuple):
    """low (3,) m: corner of the first cell, world; cells (x, y, z) bool: hull here or in a neighbouring cell."""

    low: np.ndarray
    cells: np.ndarray

    @staticmethod
    def of(samples_world: np.ndarray) -> HullMap:
        """The map of samples (m, 3) of the hull, m > 0."""
        low = samples_world.min(axis=0) - 2.0 * CELL_M
        size = np.ceil((samples_world.max(axis=0) - low) / CELL_M).astype(int) + 2
        cells = np.zeros(size, np.bool_)
        _mark(samples_world, low, cells)
        return HullMap(low, cells)


@njit(cache=True)
def _mark(samples, low, cells):
    for n in range(samples.shape[0]):
        i = int((samples[n, 0] - low[0]) / CELL_M)
        j = int((samples[n, 1] - low[1]) / CELL_M)
        k = int((samples[n, 2] - low[2]) / CELL_M)
        cells[i - 1 : i + 2, j - 1 : j + 2, k - 1 : k + 2] = True


@njit(cache=True)
def in_hull(low, cells, x, y, z):
    """Whether a point lies in a cell of hull."""
    a, b, c = (x - low[0]) / CELL_M, (y - low[1]) / CELL_M, (z - low[2]) / CELL_M
    if a < 0.0 or b < 0.0 or c < 0.0 or a >= cells.shape[0] or b >= cells.shape[1] or c >= cells.shape[2]:
        return False
    return cells[int(a), int(b), int(c)]
