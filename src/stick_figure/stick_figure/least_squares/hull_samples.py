"""Samples of the hull in cells, so that a point of the figure is compared with those near it alone.

A stick point is asked at every iteration whether some sample is near; nearly always one is, and it is found in the
point's own cell or a neighbouring one. Only points outside the hull are compared with all samples. Where too few
cameras see for a hull (``capture_rig/visibility.py``) a body may be though no sample is: such a place counts as hull.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from capture_rig.kernel import kernel, njit
from capture_rig.visibility import EVERYWHERE, UnseenCells, is_unseen

CELL_M = 0.05  # a cell and its neighbours count as hull: within 0.05 to 0.1 m of a sample
NONE = -1


class HullSamples(NamedTuple):
    """Samples (m, 3) m of the whole hull, world frame, and a map of the cells that they lie in.

    low (3,) m : corner of the first cell. newest (x, y, z) int32 : a sample in each cell, NONE where there is none;
    next (m,) int32 : another one in the same cell. near (x, y, z) bool : a sample here or in a neighbouring cell.
    unseen : the places that no hull can show.
    """

    points: np.ndarray
    low: np.ndarray
    newest: np.ndarray
    next: np.ndarray
    near: np.ndarray
    unseen: UnseenCells

    @staticmethod
    def of(points: np.ndarray, unseen: UnseenCells = EVERYWHERE) -> HullSamples:
        """Map samples (m, 3); without any, the map has no cells."""
        return HullSamples(*(*_map_samples(np.ascontiguousarray(points, dtype=np.float64)), unseen))


@njit(cache=True, nogil=True)
def _map_samples(points):
    low, high, size = np.zeros(3), np.zeros(3), np.zeros(3, np.int64)
    count = points.shape[0]
    if count > 0:
        low[:], high[:] = points[0], points[0]
        for n in range(count):
            for k in range(3):
                low[k], high[k] = min(low[k], points[n, k]), max(high[k], points[n, k])
        for k in range(3):  # two cells more on every side: the neighbours of a sample's cell exist
            low[k] -= 2.0 * CELL_M
            size[k] = int(np.ceil((high[k] - low[k]) / CELL_M)) + 2
    newest = np.full((size[0], size[1], size[2]), NONE, np.int32)
    near, following = np.zeros((size[0], size[1], size[2]), np.bool_), np.empty(count, np.int32)
    for n in range(count):
        i = int((points[n, 0] - low[0]) / CELL_M)
        j = int((points[n, 1] - low[1]) / CELL_M)
        k = int((points[n, 2] - low[2]) / CELL_M)
        if newest[i, j, k] == NONE:
            for a in range(i - 1, i + 2):
                for b in range(j - 1, j + 2):
                    for c in range(k - 1, k + 2):
                        near[a, b, c] = True
        following[n], newest[i, j, k] = newest[i, j, k], n
    return points, low, newest, following, near


@kernel
def is_in_hull(hull, x, y, z):
    """Return whether a point lies in a cell of hull or in one beside it."""
    cells = hull.near
    a, b, c = (x - hull.low[0]) / CELL_M, (y - hull.low[1]) / CELL_M, (z - hull.low[2]) / CELL_M
    if a < 0.0 or b < 0.0 or c < 0.0 or a >= cells.shape[0] or b >= cells.shape[1] or c >= cells.shape[2]:
        return False
    return cells[int(a), int(b), int(c)]


@kernel
def nearest_sample(hull, point, near_enough):
    """Return index and distance (m) of the sample nearest to a point; or of any that is ``near_enough``.

    ``near_enough`` is at most CELL_M. Where no hull can be seen, NONE and zero: the point may well be in the body.
    """
    best, at = near_enough * near_enough, NONE
    if is_in_hull(hull, point[0], point[1], point[2]):
        at, best = _sample_near(hull, point, best)
    if at == NONE and is_unseen(hull.unseen, point[0], point[1], point[2]):
        best = 0.0
    elif at == NONE:
        best = np.inf
        for n in range(hull.points.shape[0]):
            squared = _squared_distance(hull.points, n, point)
            if squared < best:
                best, at = squared, n
    return at, np.sqrt(best)


@kernel
def _sample_near(hull, point, squared_most):
    """Return some sample in the point's cell or those beside it that is near, and its squared distance; else NONE."""
    i = int((point[0] - hull.low[0]) / CELL_M)
    j = int((point[1] - hull.low[1]) / CELL_M)
    k = int((point[2] - hull.low[2]) / CELL_M)
    cells = hull.newest.shape
    for turn in range(28):  # its own cell first
        a, b, c = i, j, k
        if turn > 0:
            a, b, c = i + (turn - 1) % 3 - 1, j + (turn - 1) // 3 % 3 - 1, k + (turn - 1) // 9 - 1
        if a < 0 or b < 0 or c < 0 or a >= cells[0] or b >= cells[1] or c >= cells[2]:
            continue
        n = hull.newest[a, b, c]
        while n != NONE:
            squared = _squared_distance(hull.points, n, point)
            if squared <= squared_most:
                return n, squared
            n = hull.next[n]
    return NONE, np.inf


@kernel
def _squared_distance(points, n, point):
    x, y, z = points[n, 0] - point[0], points[n, 1] - point[1], points[n, 2] - point[2]
    return x * x + y * y + z * z
