"""Where blocks of voxels land in each camera's image: pixel boxes that are computed once per calibration."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import numpy.typing as npt
from numba import njit

from .grid import VoxelGrid
from .views import RigViews

UNSEEN, SEEN, PARTLY_SEEN = 0, 1, 2  # none, all, perhaps some of a block's voxel centres are seen by a camera

NEAR_M = 1e-9  # blocks nearer to the camera's plane than this get the whole canvas as their box
MARGIN_PX = 1e-6  # rounding of a projected coordinate is a thousand times smaller


class BlockBoxes(NamedTuple):
    """For every block of a regular subdivision and every camera, the pixels on which its voxel centres lie.

    pixels : (blocks, N, 4) int16, u and v from (inclusive), u and v to (exclusive), clipped to the canvas.
    sight : (blocks, N) uint8, UNSEEN, SEEN or PARTLY_SEEN. A box is conservative: no voxel lies outside it.
    """

    pixels: npt.NDArray[np.int16]
    sight: npt.NDArray[np.uint8]


def pixel_projections(views: RigViews, grid: VoxelGrid) -> npt.NDArray[np.float64]:
    """(N, 3, 4) projections of voxel indices (i, j, k, 1) such that the pixel is floor(u / w), floor(v / w)."""
    P = grid.projection_from_voxels(views.P)
    P[:, :2] += 0.5 * P[:, 2:]  # floor(x + 0.5)
    return np.ascontiguousarray(P)


def summed_area(images: npt.NDArray[np.uint8]) -> npt.NDArray[np.int32]:
    """(N, H + 1, W + 1) summed-area tables of the nonzero pixels of (N, H, W) images."""
    tables = np.zeros((images.shape[0], images.shape[1] + 1, images.shape[2] + 1), np.int32)
    np.cumsum(np.cumsum(images != 0, axis=1, dtype=np.int32), axis=2, out=tables[:, 1:, 1:])
    return tables


def block_boxes(views: RigViews, grid: VoxelGrid, edge: int, seen_table: npt.NDArray[np.int32]) -> BlockBoxes:
    """The boxes of all blocks of ``edge`` voxels a side, x fastest; ``seen_table`` is summed_area(views.seen)."""
    blocks = [-(-count // edge) for count in grid.shape]
    cameras = len(views.names)
    pixels = np.empty((int(np.prod(blocks)), cameras, 4), np.int16)
    sight = np.empty(pixels.shape[:2], np.uint8)
    projections, shape = pixel_projections(views, grid), np.array(grid.shape, np.int64)
    _fill_boxes(projections, views.sizes, seen_table, shape, edge, pixels, sight)
    return BlockBoxes(pixels, sight)


@njit(cache=True, nogil=True)
def _fill_boxes(projections, sizes, seen_table, shape, edge, pixels, sight):  # type: ignore[no-untyped-def]
    nx, ny, nz = (shape[0] + edge - 1) // edge, (shape[1] + edge - 1) // edge, (shape[2] + edge - 1) // edge
    for block in range(nx * ny * nz):
        i, j, k = block % nx * edge, block // nx % ny * edge, block // (nx * ny) * edge
        low = (i, j, k)
        high = (min(i + edge, shape[0]) - 1, min(j + edge, shape[1]) - 1, min(k + edge, shape[2]) - 1)
        for camera in range(projections.shape[0]):
            u0, v0, u1, v1, inside = project_block(projections, camera, low, high, sizes)
            pixels[block, camera, 0], pixels[block, camera, 1] = u0, v0
            pixels[block, camera, 2], pixels[block, camera, 3] = u1, v1
            sight[block, camera] = judge_sight(seen_table, camera, u0, v0, u1, v1, inside)


@njit(cache=True, nogil=True, error_model="numpy")
def project_block(projections, camera, low, high, sizes):  # type: ignore[no-untyped-def]
    """The clipped pixel box of the voxels from ``low`` to ``high`` (inclusive), and whether nothing was clipped.

    A projection maps the convex hull of the eight corner centres to the convex hull of their images as long as all
    are in front of the camera; a block across the camera's plane gets the whole canvas.
    """
    P, width, height = projections, float(sizes[camera, 0]), float(sizes[camera, 1])
    x0, y0, z0 = float(low[0]), float(low[1]), float(low[2])
    dx, dy, dz = float(high[0]) - x0, float(high[1]) - y0, float(high[2]) - z0
    low_u, low_v, high_u, high_v, nearest, farthest = 1e30, 1e30, -1e30, -1e30, 1e30, -1e30
    for corner in range(8):
        x, y, z = x0 + (corner & 1) * dx, y0 + (corner >> 1 & 1) * dy, z0 + (corner >> 2) * dz
        w = P[camera, 2, 0] * x + P[camera, 2, 1] * y + P[camera, 2, 2] * z + P[camera, 2, 3]
        nearest, farthest = min(nearest, w), max(farthest, w)
        inverse = 1.0 / w
        u = (P[camera, 0, 0] * x + P[camera, 0, 1] * y + P[camera, 0, 2] * z + P[camera, 0, 3]) * inverse
        v = (P[camera, 1, 0] * x + P[camera, 1, 1] * y + P[camera, 1, 2] * z + P[camera, 1, 3]) * inverse
        low_u, high_u, low_v, high_v = min(low_u, u), max(high_u, u), min(low_v, v), max(high_v, v)
    if farthest <= 0:
        return 0, 0, 0, 0, False
    if nearest <= NEAR_M:
        return 0, 0, int(width), int(height), False
    low_u, low_v, high_u, high_v = low_u - MARGIN_PX, low_v - MARGIN_PX, high_u + MARGIN_PX, high_v + MARGIN_PX
    inside = low_u >= 0 and low_v >= 0 and high_u < width and high_v < height
    u0, v0 = int(min(max(low_u, 0.0), width)), int(min(max(low_v, 0.0), height))
    u1, v1 = int(min(max(high_u + 1, 0.0), width)), int(min(max(high_v + 1, 0.0), height))
    return u0, v0, u1, v1, inside


@njit(cache=True, nogil=True)
def judge_sight(seen_tables, camera, u0, v0, u1, v1, inside):  # type: ignore[no-untyped-def]
    """Whether a camera sees none, all, or perhaps some of the voxels whose pixel box this is."""
    if u1 <= u0 or v1 <= v0:
        return UNSEEN
    seen = seen_tables[camera, v1, u1] - seen_tables[camera, v0, u1]
    seen += seen_tables[camera, v0, u0] - seen_tables[camera, v1, u0]
    if seen == 0:
        return UNSEEN
    return SEEN if inside and seen == (u1 - u0) * (v1 - v0) else PARTLY_SEEN
