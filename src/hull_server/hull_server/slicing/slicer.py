"""Skeletonisation, first half (thesis 3.2): the blobs of all slices along x, y and z at once.

A blob is a connected component (8 neighbours) of one slice. Slices are never drawn: each row of voxels becomes a few
runs of consecutive voxels, runs that touch in neighbouring rows join, and the area, centroid and second moments of a
blob are sums of closed forms over its runs. Rows along x serve the slices across z and y, rows along y those across x.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from numba import njit

from ..bricks import BrickVolume
from ..grid import Array
from .bits import brick_box, erode, pack_rows
from .blob_sums import join_tables, sum_blobs
from .runs import find_runs, join_in_slices, join_in_space, run_at

GROWTH_STEP_M = 0.02
VOXEL_VARIANCE = 1.0 / 12.0  # of a unit interval: what a blob of a single voxel has along each side


@dataclass(frozen=True, eq=False)
class BlobTable:
    """The n blobs of all slices, ordered by axis, slice, and position of their first voxel. Lengths in voxels.

    axis : (n,) uint8, the axis that the slice is perpendicular to: 0 = x, 1 = y, 2 = z.
    area : (n,) voxels in the blob.
    centroid : (n, 3) voxel indices (i, j, k), fractional; the index of the slice along ``axis``.
    covariance : (n, 3) central second moments uu, vv, uv of the voxel centres; u, v are the slice's two axes in
        ascending order.
    growth : (n,) area of the blob found straight above or below the centroid, a step along ``axis``, over the blob's
        own; the larger of the two, inf where there is none.
    part : (n,) int32, the part of the hull that the blob belongs to; see :class:`hull_server.slicing.bodies.Parts`.
    """

    axis: npt.NDArray[np.uint8]
    area: Array
    centroid: Array
    covariance: Array
    growth: Array
    part: npt.NDArray[np.int32]

    def __len__(self) -> int:
        return len(self.axis)

    def elongation(self) -> Array:
        """(n,) ratio of the principal axes, at least 1 (thesis fig. 3.4)."""
        return blob_shapes(self.area, self.covariance)[0]

    def fill(self) -> Array:
        """(n,) area over that of the ellipse with the same second moments: 1 for an ellipse, 0.95 for a rectangle.

        Low for a blob that is not convex, or that merges two: its centroid may lie outside of it (thesis 3.2).
        """
        return blob_shapes(self.area, self.covariance)[1]


@dataclass(frozen=True, eq=False)
class HullRuns:
    """The occupied voxels as m runs along x, in rows ordered by z, then y, counted from the box's low voxel.

    words : (layers, rows, words) uint64, bit b of word w is the voxel 64 w + b along x.
    low : (3,) voxel (i, j, k) at the box's corner.
    starts, ends : (m,) int32 along x, ends exclusive. first : (layers * rows + 1,) int32, the first run of each row.
    part : (m,) int32, the part of the hull that a run belongs to; parts are numbered by their first voxel.
    """

    words: npt.NDArray[np.uint64]
    low: npt.NDArray[np.int64]
    starts: npt.NDArray[np.int32]
    ends: npt.NDArray[np.int32]
    first: npt.NDArray[np.int32]
    part: npt.NDArray[np.int32]


@dataclass(frozen=True, eq=False)
class Slices:
    """A hull seen as blobs of its slices and as runs of voxels."""

    blobs: BlobTable
    runs: HullRuns


def slice_blobs(volume: BrickVolume, erosion_voxels: int = 0, step_m: float = GROWTH_STEP_M) -> BlobTable:
    """The blobs alone; see :func:`slice_hull`."""
    return slice_hull(volume, erosion_voxels, step_m).blobs


def slice_hull(volume: BrickVolume, erosion_voxels: int = 0, step_m: float = GROWTH_STEP_M) -> Slices:
    """All blobs of all slices across x, y and z, and the parts of the hull that they belong to.

    erosion_voxels : times each slice is eroded (4 neighbours) before its blobs are found; parts are not eroded.
    step_m : least distance of the slices that ``growth`` compares; at least a voxel.
    """
    step_voxels = max(1, math.ceil(step_m / volume.grid.voxel_size - 1e-6))
    bricks_x, bricks_y, _ = volume.grid.brick_shape
    index, leaves = np.ascontiguousarray(volume.index), np.ascontiguousarray(volume.leaves)
    columns, runs = _slice(index, leaves, bricks_x, bricks_y, erosion_voxels, step_voxels)
    return Slices(BlobTable(*columns), HullRuns(*runs))


@njit(cache=True, nogil=True)
def _slice(index, leaves, bricks_x, bricks_y, erosions, step):  # type: ignore[no-untyped-def]
    """Columns of the blob table, and of the runs."""
    box = brick_box(index, bricks_x, bricks_y)
    low = 8 * np.array([box[0], box[1], box[2]])
    along_x, along_y = pack_rows(index, leaves, bricks_x, bricks_y, box)
    layers, rows, columns = along_x.shape[0], along_x.shape[1], along_y.shape[1]
    runs = find_runs(along_x)
    starts, ends, first, _ = runs
    joined_z, joined_y = join_in_slices(runs, rows, False), join_in_slices(runs, rows, True)
    part = join_in_space(joined_z, joined_y)
    eroded, joined = _eroded(along_x, runs, joined_z, erosions, False)
    across_z = sum_blobs(eroded, joined, layers, rows, False, step)
    eroded, joined = _eroded(along_x, runs, joined_y, erosions, True)
    across_y = sum_blobs(eroded, joined, layers, rows, True, step)
    runs_y = find_runs(along_y)
    eroded, joined = _eroded(along_y, runs_y, join_in_slices(runs_y, columns, True), erosions, True)
    across_x = sum_blobs(eroded, joined, layers, columns, True, step)

    axis, area, centroid, covariance, growth, voxel = join_tables(across_x, across_y, across_z)
    part_of_blob = np.empty(axis.size, np.int32)
    for blob in range(axis.size):
        line = voxel[blob, 2] * rows + voxel[blob, 1]
        part_of_blob[blob] = part[run_at(starts, ends, first, line, voxel[blob, 0])]
        for k in range(3):
            centroid[blob, k] += low[k]
    return (axis, area, centroid, covariance, growth, part_of_blob), (along_x, low, starts, ends, first, part)


@njit(cache=True, nogil=True)
def _eroded(words, runs, joined, erosions, across_layers):  # type: ignore[no-untyped-def]
    """Runs and joined labels of the eroded rows; those given where there is nothing to erode."""
    if erosions == 0:
        return runs, joined
    for _ in range(erosions):
        words = erode(words, across_layers)
    runs = find_runs(words)
    return runs, join_in_slices(runs, words.shape[1], across_layers)


@njit(cache=True, nogil=True)
def blob_shapes(area, covariance):  # type: ignore[no-untyped-def]
    """Elongation (n,) and fill (n,) of blobs."""
    elongation, fill = np.empty(area.size), np.empty(area.size)
    for n in range(area.size):
        elongation[n], fill[n] = shape_of(area[n], covariance[n, 0], covariance[n, 1], covariance[n, 2])
    return elongation, fill


@njit(cache=True, nogil=True)
def shape_of(area, uu, vv, uv):  # type: ignore[no-untyped-def]
    """Elongation and fill of one blob, from the principal variances of its voxels as squares, not points."""
    middle = (uu + vv) / 2 + VOXEL_VARIANCE
    radius = np.sqrt(((uu - vv) / 2) ** 2 + uv**2)
    larger, smaller = middle + radius, max(middle - radius, VOXEL_VARIANCE / 2)
    return np.sqrt(larger / smaller), area / (4 * np.pi * np.sqrt(larger * smaller))
