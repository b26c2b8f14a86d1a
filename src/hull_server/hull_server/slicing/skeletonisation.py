"""Skeletonisation (thesis 3.2): the blobs of all slices along x, y and z, and of these the centerline points.

A blob is a connected component (8 neighbours) of one slice. Slices are never drawn: each row of voxels becomes a few
runs of consecutive voxels, runs that touch in neighbouring rows join, and the area, centroid and second moments of a
blob are sums of closed forms over its runs. Rows along x serve the slices across z and y, rows along y those across x.
The centroids of the blobs that look like a limb cut across are the centerline.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from capture_rig.kernel import njit
from mocap_packets.hull import Centerline

from ..grid import Array, BrickVolume, VoxelGrid
from ..settings import BlobSettings
from .voxel_runs import HullRuns, brick_box, find_bit_runs, join_in_slices, join_in_space, pack_rows, run_at

GROWTH_STEP_M = 0.02  # least distance of the slices that a blob's growth compares; at least a voxel

# Thresholds: noise model of a centerline point, fitted by maximum likelihood to the points' distances from the sticks
# in hulls of the studio's body, as the former bench of the centerline did; no bench repeats the fit.
SIGMA_BASE_M = 0.001
SIGMA_PER_RADIUS = 0.050
SIGMA_PER_MISSING_FILL_M = 0.050
SIGMA_PER_GROWTH_M = 0.005
FULL = 0.97


class BlobTable(NamedTuple):
    """The n blobs of all slices, by axis, in the order of their first voxels. Lengths in voxels.

    axis : (n,) uint8, the axis that the slice is perpendicular to: 0 = x, 1 = y, 2 = z.
    area : (n,) voxels in the blob.
    centroid : (n, 3) voxel indices (i, j, k), fractional; the index of the slice along ``axis``.
    covariance : (n, 3) central second moments uu, vv, uv of the voxel centres; u, v are the slice's two axes in
        ascending order.
    growth : (n,) area of the blob found straight above or below the centroid, a step along ``axis``, over the blob's
        own; the larger of the two, inf where there is none.
    part : (n,) int32, the part of the hull that the blob belongs to; see :class:`hull_server.slicing.bodies.HullParts`.
    """

    axis: npt.NDArray[np.uint8]
    area: Array
    centroid: Array
    covariance: Array
    growth: Array
    part: npt.NDArray[np.int32]


def slice_hull(volume: BrickVolume) -> tuple[BlobTable, HullRuns]:
    """Find all blobs of all slices across x, y and z, and the runs of voxels that make up the hull."""
    step_voxels = max(1, math.ceil(GROWTH_STEP_M / volume.grid.voxel_size - 1e-6))
    bricks_x, bricks_y, _ = volume.grid.brick_shape
    index, leaves = np.ascontiguousarray(volume.index), np.ascontiguousarray(volume.leaves)
    blobs, runs = _slice(index, leaves, bricks_x, bricks_y, step_voxels)
    return blobs, runs


def find_centerline(blobs: BlobTable, grid: VoxelGrid, filters: BlobSettings) -> Centerline:
    """Select the blobs that are large, round and convex enough to be a limb or trunk cut across; return their
    centroids.

    Points are in the order of the blob table, and carry as body the number of their part.

    Beyond the thesis: where a limb is cut across, the next slices show nearly the same blob. The tip of a limb, the top
    of a head, the edge of a shoulder are as round, but end on one side and grow on the other (``max_growth``).
    """
    limits = (
        filters.min_area_m2 / grid.voxel_size**2 * (1 - 1e-9),  # a whole number of voxels may equal the limit
        filters.max_elongation,
        filters.min_fill,
        filters.max_growth or float("inf"),
    )
    return Centerline(*_select(blobs, limits, grid.origin, grid.voxel_size))


@njit(cache=True, nogil=True)
def _slice(index, leaves, bricks_x, bricks_y, step):  # type: ignore[no-untyped-def]
    """Compute the blob table, and the runs."""
    box = brick_box(index, bricks_x, bricks_y)
    low = 8 * np.array([box[0], box[1], box[2]])
    along_x, along_y = pack_rows(index, leaves, bricks_x, bricks_y, box)
    layers, rows, columns = along_x.shape[0], along_x.shape[1], along_y.shape[1]
    runs, runs_y = find_bit_runs(along_x), find_bit_runs(along_y)
    starts, ends, first, _ = runs
    joined_z, joined_y = join_in_slices(runs, rows, False), join_in_slices(runs, rows, True)
    part = join_in_space(joined_z, joined_y)
    across_z = sum_blobs(runs, joined_z, layers, rows, False, step)
    across_y = sum_blobs(runs, joined_y, layers, rows, True, step)
    across_x = sum_blobs(runs_y, join_in_slices(runs_y, columns, True), layers, columns, True, step)

    blobs, voxel = join_tables(across_x, across_y, across_z)
    for blob in range(blobs.axis.size):
        line = voxel[blob, 2] * rows + voxel[blob, 1]
        blobs.part[blob] = part[run_at(starts, ends, first, line, voxel[blob, 0])]
        for k in range(3):
            blobs.centroid[blob, k] += low[k]
    return blobs, HullRuns(along_x, low, starts, ends, first, part)


@njit(cache=True, nogil=True)
def sum_blobs(runs, joined, layers, rows, across_layers, step):  # type: ignore[no-untyped-def]
    """Sum up the blobs of the slices across one axis, in the order of their first voxels.

    Returns sums of 1, u, v, 6 uu, vv, uv (n, 6), growth (n,) and first voxel as (u, row, layer) (n, 3); u counts along
    the runs, v across them inside the slice. runs, joined : of ``find_runs`` and ``join_in_slices``. The sums are whole
    numbers far below 2**53, so float64 holds them exactly.
    """
    starts, ends, first, filled = runs
    labels, forest = joined
    sums, voxel = _sum_labels(starts, ends, first, filled, rows, across_layers, labels, forest.size)
    blob_of_label, count = np.empty(forest.size, np.int32), 0
    for label in range(forest.size):  # a root is the smallest label of its tree, so rows are read before written
        if forest[label] == label:
            blob, count = count, count + 1
            for k in range(6):
                sums[blob, k] = sums[label, k]
            for k in range(3):
                voxel[blob, k] = voxel[label, k]
        else:
            blob = blob_of_label[forest[label]]
            for k in range(6):
                sums[blob, k] += sums[label, k]
        blob_of_label[label] = blob
    blobs = sums[:count], voxel[:count]
    return sums[:count], _growth(runs, layers, rows, across_layers, step, blobs, labels, blob_of_label), voxel[:count]


@njit(cache=True, nogil=True)
def _sum_labels(starts, ends, first, filled, rows, across_layers, labels, count):  # type: ignore[no-untyped-def]
    """Sum over the runs of each label (count, 6); also find its first voxel (count, 3)."""
    sums, voxel = np.zeros((count, 6)), np.empty((count, 3), np.int32)
    s, row_zero = 0, 0
    for line in filled:
        while line >= row_zero + rows:
            s, row_zero = s + 1, row_zero + rows
        r = line - row_zero
        v = float(s if across_layers else r)
        for run in range(first[line], first[line + 1]):
            label = labels[run]
            a, b = float(starts[run]), float(ends[run]) - 1.0
            n = b - a + 1.0
            u = (a + b) * n * 0.5
            if sums[label, 0] == 0:
                voxel[label, 0], voxel[label, 1], voxel[label, 2] = starts[run], r, s
            sums[label, 0] += n
            sums[label, 1] += u
            sums[label, 2] += v * n
            sums[label, 3] += b * (b + 1.0) * (2.0 * b + 1.0) - (a - 1.0) * a * (2.0 * a - 1.0)
            sums[label, 4] += v * v * n
            sums[label, 5] += v * u
    return sums, voxel


@njit(cache=True, nogil=True)
def _growth(runs, layers, rows, across_layers, step, blobs, labels, blob_of_label):  # type: ignore[no-untyped-def]
    """Divide the larger of the areas ``step`` slices to either side of the centroid by the blob's own (n,)."""
    (starts, ends, first, _), (sums, voxel) = runs, blobs
    growth = np.empty(sums.shape[0])
    depth = rows if across_layers else layers
    for blob in range(growth.size):
        place = voxel[blob, 1 if across_layers else 2]
        u, v = int(sums[blob, 1] / sums[blob, 0] + 0.5), int(sums[blob, 2] / sums[blob, 0] + 0.5)
        largest = 0.0
        for beyond in (place - step, place + step):
            run = -1
            if 0 <= beyond < depth:
                line = v * rows + beyond if across_layers else beyond * rows + v
                run = run_at(starts, ends, first, line, u)
            largest = max(largest, np.inf if run < 0 else sums[blob_of_label[labels[run]], 0])
        growth[blob] = largest / sums[blob, 0]
    return growth


@njit(cache=True, nogil=True)
def join_tables(across_x, across_y, across_z):  # type: ignore[no-untyped-def]
    """Join the blobs of three axes, of parts yet unknown; also return their first voxels (n, 3) (i, j, k)."""
    count = across_x[1].size + across_y[1].size + across_z[1].size
    axis, area, growth, part = np.empty(count, np.uint8), np.empty(count), np.empty(count), np.empty(count, np.int32)
    centroid, covariance, voxel = np.empty((count, 3)), np.empty((count, 3)), np.empty((count, 3), np.int32)
    row = 0
    for number, along, across, table in ((0, 1, 2, across_x), (1, 0, 2, across_y), (2, 0, 1, across_z)):
        sums, grown, corner = table
        for blob in range(grown.size):
            axis[row], area[row], growth[row] = number, sums[blob, 0], grown[blob]
            u, v = sums[blob, 1] / area[row], sums[blob, 2] / area[row]
            centroid[row, number], centroid[row, along] = corner[blob, 2 if number == 2 else 1], u
            centroid[row, across] = v
            covariance[row, 0] = sums[blob, 3] / 6.0 / area[row] - u * u
            covariance[row, 1] = sums[blob, 4] / area[row] - v * v
            covariance[row, 2] = sums[blob, 5] / area[row] - u * v
            voxel[row, 0], voxel[row, 1], voxel[row, 2] = corner[blob, 0], corner[blob, 1], corner[blob, 2]
            if number == 0:  # runs along y lie in rows of one x
                voxel[row, 0], voxel[row, 1] = corner[blob, 1], corner[blob, 0]
            row += 1
    return BlobTable(axis, area, centroid, covariance, growth, part), voxel


@njit(cache=True, nogil=True)
def shape_of(area, uu, vv, uv):  # type: ignore[no-untyped-def]
    """Return elongation and fill of one blob, from the principal variances of its voxels as squares, not points.

    Elongation is the ratio of the principal axes, at least 1 (thesis fig. 3.4). Fill is the area over that of the
    ellipse with the same second moments: 1 for an ellipse, 0.95 for a rectangle, less for a blob that is not convex or
    that merges two, whose centroid may lie outside of it (thesis 3.2).
    """
    of_voxel = 1.0 / 12.0  # variance of a unit interval, that of a single voxel along each side
    middle = (uu + vv) / 2 + of_voxel
    radius = np.sqrt(((uu - vv) / 2) ** 2 + uv**2)
    larger, smaller = middle + radius, max(middle - radius, of_voxel / 2)
    return np.sqrt(larger / smaller), area / (4 * np.pi * np.sqrt(larger * smaller))


@njit(cache=True, nogil=True)
def _select(blobs, limits, origin, voxel_m):  # type: ignore[no-untyped-def]
    """Compute the columns of the centerline."""
    axis, area, centroid, covariance, growth, part = blobs
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
    """Return the standard deviation (m) of a blob's centroid from the limb's axis, in each direction across it.

    Hulls err in proportion to the limb's radius; dents and a change of girth add to it; elongation adds nothing. The
    place of the bone inside the limb is not part of it.
    """
    radius = np.sqrt(area_m2 / np.pi)
    missing, change = max(0.0, FULL - fill), min(max(0.0, growth - 1.0), 2.0)
    sigma = SIGMA_BASE_M + SIGMA_PER_RADIUS * radius
    return sigma + SIGMA_PER_MISSING_FILL_M * missing + SIGMA_PER_GROWTH_M * change
