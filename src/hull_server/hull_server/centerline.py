"""Skeletonisation, second half (thesis 3.2): the blobs that look like a limb cut across, as centerline points."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from .grid import Array, VoxelGrid
from .settings import BlobSettings
from .slicer import BlobTable

# distance of a blob's centroid from the limb's true axis, by the blob's shape; measured on rendered bodies
SIGMA_BASE_M = 0.003
SIGMA_PER_ELONGATION_M = 0.009
SIGMA_PER_MISSING_FILL_M = 0.150
FULL = 0.97


@dataclass(frozen=True, eq=False)
class Centerline:
    """Centerline points of one hull, in the order of the blob table.

    points_world : (n, 3) metres, map frame. sigma : (n,) metres, a weak estimate of each point's distance from the
    limb's axis, useful as a weight. axis : (n,) 0 = x, 1 = y, 2 = z, the axis the slice was perpendicular to.
    area_m2, elongation, fill : (n,) of the blob; see :class:`hull_server.slicer.BlobTable`.
    """

    points_world: Array
    sigma: Array
    axis: npt.NDArray[np.uint8]
    area_m2: Array
    elongation: Array
    fill: Array

    def __len__(self) -> int:
        return len(self.axis)


def find_centerline(blobs: BlobTable, grid: VoxelGrid, filters: BlobSettings) -> Centerline:
    """The centroids of the blobs that are large, round and convex enough to be a limb or trunk cut across."""
    area_m2 = blobs.area * grid.voxel_size**2
    elongation, fill = blobs.elongation(), blobs.fill()
    kept = area_m2 >= filters.min_area_m2 * (1 - 1e-9)  # a whole number of voxels may equal the limit
    kept &= (elongation <= filters.max_elongation) & (fill >= filters.min_fill)
    elongation, fill = elongation[kept], fill[kept]
    return Centerline(
        points_world=grid.centres_world(blobs.centroid[kept]),
        sigma=point_sigma(elongation, fill),
        axis=blobs.axis[kept],
        area_m2=area_m2[kept],
        elongation=elongation,
        fill=fill,
    )


def point_sigma(elongation: Array, fill: Array) -> Array:
    """(n,) metres: how far a blob's centroid typically lies from the limb's axis, by the blob's shape."""
    return (
        SIGMA_BASE_M
        + SIGMA_PER_ELONGATION_M * (elongation - 1.0)
        + SIGMA_PER_MISSING_FILL_M * np.maximum(0.0, FULL - fill)
    )
