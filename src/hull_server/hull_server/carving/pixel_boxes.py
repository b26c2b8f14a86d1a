"""Projects blocks of voxels to each camera's image: pixel boxes, computed once per calibration, and sums over them."""

from __future__ import annotations

from typing import NamedTuple

import cv2
import numpy as np
import numpy.typing as npt

from capture_rig.camera import ROUNDING_PX
from capture_rig.kernel import kernel
from capture_rig.lens import NEGLIGIBLE

from ..grid import VoxelGrid
from ..views import RigViews

UNSEEN, SEEN, PARTLY_SEEN = 0, 1, 2  # none, all, perhaps some of a block's voxel centres are seen by a camera

ALL_SURE = 8  # count of a square of 2 x 2 foreground pixels in a summed area


class BlockBoxes(NamedTuple):
    """For every camera and every block of a regular subdivision, the pixels on which its voxel centres lie.

    pixels : (N, blocks, 4) int16, u and v from (inclusive), u and v to (exclusive), clipped to the canvas.
    visibility : (N, blocks) uint8, UNSEEN, SEEN or PARTLY_SEEN. A box is conservative: no voxel lies outside it.
    """

    pixels: npt.NDArray[np.int16]
    visibility: npt.NDArray[np.uint8]


def pixel_projections(views: RigViews, grid: VoxelGrid) -> npt.NDArray[np.float64]:
    """Return projections (N, 3, 4) of voxel indices (i, j, k, 1) such that the pixel is floor(u / w), floor(v / w)."""
    P = grid.projection_from_voxels(views.P)
    P[:, :2] += 0.5 * P[:, 2:]  # floor(x + 0.5)
    return np.ascontiguousarray(P)


def summed_area(images: npt.NDArray[np.uint8]) -> npt.NDArray[np.int32]:
    """Return summed-area tables (N, H + 1, W + 1) of the nonzero pixels of (N, H, W) images."""
    return np.stack([cv2.integral(np.minimum(image, 1)) for image in images])


def block_boxes(views: RigViews, grid: VoxelGrid, edge: int, seen_table: npt.NDArray[np.int32]) -> BlockBoxes:
    """Compute the boxes of all blocks of ``edge`` voxels a side, x fastest; ``seen_table`` is
    summed_area(views.seen)."""
    blocks = [-(-count // edge) for count in grid.shape]
    pixels = np.empty((len(views.names), int(np.prod(blocks)), 4), np.int16)
    visibility = np.empty(pixels.shape[:2], np.uint8)
    projections, shape = pixel_projections(views, grid), np.array(grid.shape, np.int64)
    _fill_boxes(projections, views.sizes, seen_table, shape, edge, pixels, visibility)
    return BlockBoxes(pixels, visibility)


@kernel
def _fill_boxes(projections, sizes, seen_tables, shape, edge, pixels, visibility):  # type: ignore[no-untyped-def]
    nx, ny, nz = (shape[0] + edge - 1) // edge, (shape[1] + edge - 1) // edge, (shape[2] + edge - 1) // edge
    for camera in range(projections.shape[0]):
        for block in range(nx * ny * nz):
            i, j, k = block % nx * edge, block // nx % ny * edge, block // (nx * ny) * edge
            high = (min(i + edge, shape[0]) - 1, min(j + edge, shape[1]) - 1, min(k + edge, shape[2]) - 1)
            u0, v0, u1, v1, inside = project_block(projections[camera], (i, j, k), high, sizes[camera])
            pixels[camera, block, 0], pixels[camera, block, 1] = u0, v0
            pixels[camera, block, 2], pixels[camera, block, 3] = u1, v1
            visibility[camera, block] = _classify_visibility(seen_tables, camera, u0, v0, u1, v1, inside)


@kernel
def project_block(P, low, high, size):  # type: ignore[no-untyped-def]
    """Return the clipped pixel box of the voxels ``low`` to ``high`` (inclusive), and whether nothing was clipped.

    A projection maps the convex hull of the eight corner centres to the convex hull of their images as long as all
    are in front of the camera; a block across the camera's plane gets the whole canvas.
    """
    width, height = float(size[0]), float(size[1])
    x0, y0, z0 = float(low[0]), float(low[1]), float(low[2])
    dx, dy, dz = float(high[0]) - x0, float(high[1]) - y0, float(high[2]) - z0
    low_u, low_v, high_u, high_v, nearest, farthest = 1e30, 1e30, -1e30, -1e30, 1e30, -1e30
    for corner in range(8):
        x, y, z = x0 + (corner & 1) * dx, y0 + (corner >> 1 & 1) * dy, z0 + (corner >> 2) * dz
        w = P[2, 0] * x + P[2, 1] * y + P[2, 2] * z + P[2, 3]
        nearest, farthest = min(nearest, w), max(farthest, w)
        inverse = 1.0 / w
        u = (P[0, 0] * x + P[0, 1] * y + P[0, 2] * z + P[0, 3]) * inverse
        v = (P[1, 0] * x + P[1, 1] * y + P[1, 2] * z + P[1, 3]) * inverse
        low_u, high_u, low_v, high_v = min(low_u, u), max(high_u, u), min(low_v, v), max(high_v, v)
    if farthest <= 0:
        return 0, 0, 0, 0, False
    if nearest <= NEGLIGIBLE:  # at the camera's plane: the whole canvas
        return 0, 0, int(width), int(height), False
    low_u, low_v, high_u, high_v = low_u - ROUNDING_PX, low_v - ROUNDING_PX, high_u + ROUNDING_PX, high_v + ROUNDING_PX
    inside = low_u >= 0 and low_v >= 0 and high_u < width and high_v < height
    u0, v0 = int(min(max(low_u, 0.0), width)), int(min(max(low_v, 0.0), height))
    u1, v1 = int(min(max(high_u + 1, 0.0), width)), int(min(max(high_v + 1, 0.0), height))
    return u0, v0, u1, v1, inside


@kernel
def _classify_visibility(seen_tables, camera, u0, v0, u1, v1, inside):  # type: ignore[no-untyped-def]
    """Classify whether a camera sees none, all, or perhaps some of the voxels of a pixel box."""
    seen = count_in_box(seen_tables, camera, u0, v0, u1, v1)
    if seen == 0:
        return UNSEEN
    return SEEN if inside and seen == (u1 - u0) * (v1 - v0) else PARTLY_SEEN


@kernel
def project(P, camera, x, y, z):  # type: ignore[no-untyped-def]
    """Return the pixel coordinates of a voxel's centre by projections (N, 3, 4), and its depth; -1, -1 behind the
    camera."""
    w = P[camera, 2, 0] * x + P[camera, 2, 1] * y + P[camera, 2, 2] * z + P[camera, 2, 3]
    if w <= 0:
        return -1.0, -1.0, w
    u = (P[camera, 0, 0] * x + P[camera, 0, 1] * y + P[camera, 0, 2] * z + P[camera, 0, 3]) / w
    v = (P[camera, 1, 0] * x + P[camera, 1, 1] * y + P[camera, 1, 2] * z + P[camera, 1, 3]) / w
    return u, v, w


@kernel
def count_in_box(tables, camera, u0, v0, u1, v1):  # type: ignore[no-untyped-def]
    """Count the pixels of a summed-area table in a pixel box."""
    if u1 <= u0 or v1 <= v0:
        return 0
    return tables[camera, v1, u1] - tables[camera, v0, u1] - tables[camera, v1, u0] + tables[camera, v0, u0]


@kernel
def foreground_in(boxes, tables, camera, u0, v0, u1, v1):  # type: ignore[no-untyped-def]
    """Return whether there is any foreground in the squares of 2 x 2 pixels that a pixel box touches, and whether they
    are all foreground; ``tables`` cover the squares of the foreground ``boxes``, from their corners.
    """
    left, top = boxes[camera, 0], boxes[camera, 1]
    width, height = (boxes[camera, 2] - left) >> 1, (boxes[camera, 3] - top + 1) >> 1
    a0, a1, b0, b1 = (u0 - left) >> 1, (u1 - left + 1) >> 1, (v0 - top) >> 1, (v1 - top + 1) >> 1
    squares = (a1 - a0) * (b1 - b0)
    a0, a1 = min(max(a0, 0), width), min(max(a1, 0), width)
    b0, b1 = (width + 1) * min(max(b0, 0), height), (width + 1) * min(max(b1, 0), height)
    filled = tables[camera, b1 + a1] - tables[camera, b0 + a1] - tables[camera, b1 + a0] + tables[camera, b0 + a0]
    return filled > 0, filled == ALL_SURE * squares
