"""Projection in single precision, and how far it can be trusted.

Consumer GPUs compute in double precision 32 to 64 times slower than in single. Single precision will do wherever a
voxel lands farther from the nearest border between two pixels than its rounding can carry it. Origins in the middle
of the grid and of the canvas keep the numbers, and so the rounding, small.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from ..carving.boxes import pixel_projections
from ..grid import VoxelGrid
from ..views import RigViews

UNIT = 2.0**-24  # relative rounding of one operation
IN_SUMS = 8  # roundings on the way to a row's value: the entry's own, a product, three sums, three steps in a block
IN_QUOTIENT = 8  # and from there: a reciprocal that may be five units off, a product, canvas's centre and margin added


class SinglePrecision(NamedTuple):
    """rows : (N, 3, 4) float32, voxel (i, j, k, 1) less ``centre`` to pixel less half the canvas, times depth w.

    centre : (3,) the voxel in the middle of the grid. border : a pixel coordinate computed with these rows is less
    than ``border / w`` away from the true one; pixels times the unit of w, which is metres.
    """

    rows: npt.NDArray[np.float32]
    centre: npt.NDArray[np.int64]
    border: float


def single_precision(views: RigViews, grid: VoxelGrid) -> SinglePrecision:
    """The rows for a rig and a grid, with a bound for the sum of all their roundings (Higham 2002, 3.1)."""
    _, height, width = views.seen.shape
    centre = np.array(grid.shape, np.int64) // 2
    P = pixel_projections(views, grid)
    P[..., 3] += P[..., :3] @ centre
    P[:, :2] -= 0.5 * np.array([width, height])[:, None] * P[:, 2:]
    largest = np.abs(P) @ np.append(centre + 1.0, 1.0)  # (N, 3) sums of absolute terms, anywhere in the grid
    sums = IN_SUMS * largest[:, :2].max(axis=1)
    depth = (IN_SUMS + IN_QUOTIENT) * 0.5 * max(width, height) * largest[:, 2]
    return SinglePrecision(P.astype(np.float32), centre, float(UNIT * (sums + depth).max()))
