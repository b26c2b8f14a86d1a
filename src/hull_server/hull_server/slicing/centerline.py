"""Skeletonisation, second half (thesis 3.2): the blobs that look like a limb cut across, as centerline points."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from numba import njit

from ..grid import Array, VoxelGrid
from ..settings import BlobSettings
from .slicer import BlobTable, shape_of

# fitted to the built-in body's hulls by maximum likelihood (bench/centerline.py measures how honest it is)
SIGMA_BASE_M = 0.001
SIGMA_PER_RADIUS = 0.050
SIGMA_PER_MISSING_FILL_M = 0.050
SIGMA_PER_GROWTH_M = 0.005
FULL = 0.97


@dataclass(frozen=True, eq=False)
class Centerline:
    """Centerline points of one hull, in the order of the blob table.

    points_world : (n, 3) metres, map frame. sigma : (n,) metres, standard deviation of the point from the limb's axis
    in each direction across it, see :func:`point_sigma`. axis : (n,) 0 = x, 1 = y, 2 = z, the axis the slice was
    perpendicular to.
    area_m2, elongation, fill : (n,) of the blob; see :class:`hull_server.slicing.slicer.BlobTable`.
    part : (n,) int32, the part of the hull the point belongs to; see :class:`hull_server.slicing.bodies.Bodies`.
    """

    points_world: Array
    sigma: Array
    axis: npt.NDArray[np.uint8]
    area_m2: Array
    elongation: Array
    fill: Array
    part: npt.NDArray[np.int32]

    def __len__(self) -> int:
        return len(self.axis)


def find_centerline(blobs: BlobTable, grid: VoxelGrid, filters: BlobSettings) -> Centerline:
    """The centroids of the blobs that are large, round and convex enough to be a limb or trunk cut across.

    Beyond the thesis: where a limb is cut across, the next slices show nearly the same blob. The tip of a limb, a slice
    off a head, a shoulder cut at its rim are as round, but end on one side and grow on the other (``max_growth``).
    """
    limits = (
        filters.min_area_m2 / grid.voxel_size**2 * (1 - 1e-9),  # a whole number of voxels may equal the limit
        filters.max_elongation,
        filters.min_fill,
        filters.max_growth or float("inf"),
    )
    columns = (blobs.axis, blobs.area, blobs.centroid, blobs.covariance, blobs.growth, blobs.part)
    return Centerline(*_select(*columns, limits, grid.origin, grid.voxel_size))


@njit(cache=True, nogil=True)
def _select(axis, area, centroid, covariance, growth, part, limits, origin, voxel_m):  # type: ignore[no-untyped-def]
    """The columns of the centerline."""
    min_area, max_elongation, min_fill, max_growth = limits
    kept, shape, count = np.empty(area.size, np.int64), np.empty((area.size, 2)), 0
    for n in range(area.size):
        if area[n] >= min_area and growth[n] <= max_growth:
            elongation, fill = shape_of(area[n], covariance[n, 0], covariance[n, 1], covariance[n, 2])
            if elongation <= max_elongation and fill >= min_fill:
                kept[count], shape[count, 0], shape[count, 1] = n, elongation, fill
                count += 1
    kept, points, sigma = kept[:count], np.empty((count, 3)), np.empty(count)
    area_m2 = area[kept] * voxel_m**2
    for row, n in enumerate(kept):
        sigma[row] = point_sigma(area_m2[row], shape[row, 1], growth[n])
        for k in range(3):
            points[row, k] = origin[k] + (centroid[n, k] + 0.5) * voxel_m
    return points, sigma, axis[kept], area_m2, shape[:count, 0].copy(), shape[:count, 1].copy(), part[kept]


@njit(cache=True, nogil=True)
def point_sigma(area_m2, fill, growth):  # type: ignore[no-untyped-def]
    """Metres: standard deviation of a blob's centroid from the limb's axis, in each direction across it.

    Hulls err in proportion to the limb's radius; dents and a change of girth add to it; elongation says nothing more.
    Where a bone lies inside the flesh is not part of it.
    """
    radius = np.sqrt(area_m2 / np.pi)
    missing, change = max(0.0, FULL - fill), min(max(0.0, growth - 1.0), 2.0)
    sigma = SIGMA_BASE_M + SIGMA_PER_RADIUS * radius
    return sigma + SIGMA_PER_MISSING_FILL_M * missing + SIGMA_PER_GROWTH_M * change
