"""The blobs of the slices across one axis: areas, centroids, second moments, and how they go on in the next slices."""

from __future__ import annotations

import numpy as np
from numba import njit

from .runs import run_at


@njit(cache=True, nogil=True)
def sum_blobs(runs, joined, layers, rows, across_layers, step):  # type: ignore[no-untyped-def]
    """Slice (n,), sums of 1, u, v, 6 uu, vv, uv (n, 6), growth (n,) and first voxel as (u, row, layer) (n, 3) of the
    blobs, ordered by slice and first voxel; u counts along the runs, v across them inside the slice.

    runs : as :func:`hull_server.slicing.runs.find_runs` gives them. joined : as ``join_in_slices`` does.
    The sums are whole numbers far below 2**53, so float64 holds them exactly.
    """
    starts, ends, first, filled = runs
    labels, forest = joined
    sums, voxel = _sum_labels(starts, ends, first, filled, rows, across_layers, labels, forest.size)
    for label in range(forest.size - 1, -1, -1):
        if forest[label] != label:
            for k in range(6):
                sums[forest[label], k] += sums[label, k]
    blob_of_label, count = _order(forest, voxel, 1 if across_layers else 2, rows if across_layers else layers)
    slices, ordered, corner = np.empty(count, np.int32), np.empty((count, 6)), np.empty((count, 3), np.int32)
    for label in range(forest.size):
        blob = blob_of_label[label]
        if forest[label] == label:
            slices[blob] = voxel[label, 1 if across_layers else 2]
            for k in range(6):
                ordered[blob, k] = sums[label, k]
            for k in range(3):
                corner[blob, k] = voxel[label, k]
        else:
            blob_of_label[label] = blob_of_label[forest[label]]
    growth = _growth(runs, layers, rows, across_layers, step, slices, ordered, labels, blob_of_label)
    return slices, ordered, growth, corner


@njit(cache=True, nogil=True)
def _sum_labels(starts, ends, first, filled, rows, across_layers, labels, count):  # type: ignore[no-untyped-def]
    """Sums (count, 6) over the runs of each label, and its first voxel (count, 3)."""
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
def _order(forest, voxel, slice_column, slices):  # type: ignore[no-untyped-def]
    """Place (n,) of each root when roots are sorted by slice, first voxels in order; and the number of roots."""
    place = np.zeros(slices + 1, np.int32)
    for label in range(forest.size):
        if forest[label] == label:
            place[voxel[label, slice_column] + 1] += 1
    for number in range(slices):
        place[number + 1] += place[number]
    order = np.full(forest.size, -1, np.int32)
    for label in range(forest.size):
        if forest[label] == label:
            order[label] = place[voxel[label, slice_column]]
            place[voxel[label, slice_column]] += 1
    return order, place[slices]


@njit(cache=True, nogil=True)
def _growth(runs, layers, rows, across_layers, step, slices, sums, labels, blob_of_label):  # type: ignore[no-untyped-def]
    """(n,) the larger of the areas beyond the centroid, ``step`` slices to either side, over the blob's own."""
    starts, ends, first, _ = runs
    growth = np.empty(slices.size)
    depth = rows if across_layers else layers
    for blob in range(slices.size):
        u, v = int(sums[blob, 1] / sums[blob, 0] + 0.5), int(sums[blob, 2] / sums[blob, 0] + 0.5)
        largest = 0.0
        for beyond in (slices[blob] - step, slices[blob] + step):
            run = -1
            if 0 <= beyond < depth:
                line = v * rows + beyond if across_layers else beyond * rows + v
                run = run_at(starts, ends, first, line, u)
            largest = max(largest, np.inf if run < 0 else sums[blob_of_label[labels[run]], 0])
        growth[blob] = largest / sums[blob, 0]
    return growth


@njit(cache=True, nogil=True)
def join_tables(across_x, across_y, across_z):  # type: ignore[no-untyped-def]
    """Axis, area, centroid, covariance, growth, and first voxel (i, j, k) of all blobs; see BlobTable."""
    count = across_x[0].size + across_y[0].size + across_z[0].size
    axis, area, growth = np.empty(count, np.uint8), np.empty(count), np.empty(count)
    centroid, covariance, voxel = np.empty((count, 3)), np.empty((count, 3)), np.empty((count, 3), np.int32)
    row = 0
    for number, along, across, table in ((0, 1, 2, across_x), (1, 0, 2, across_y), (2, 0, 1, across_z)):
        slices, sums, grown, corner = table
        for blob in range(slices.size):
            axis[row], area[row], growth[row] = number, sums[blob, 0], grown[blob]
            u, v = sums[blob, 1] / area[row], sums[blob, 2] / area[row]
            centroid[row, number], centroid[row, along], centroid[row, across] = slices[blob], u, v
            covariance[row, 0] = sums[blob, 3] / 6.0 / area[row] - u * u
            covariance[row, 1] = sums[blob, 4] / area[row] - v * v
            covariance[row, 2] = sums[blob, 5] / area[row] - u * v
            voxel[row, 0], voxel[row, 1], voxel[row, 2] = corner[blob, 0], corner[blob, 1], corner[blob, 2]
            if number == 0:  # runs along y lie in rows of one x
                voxel[row, 0], voxel[row, 1] = corner[blob, 1], corner[blob, 0]
            row += 1
    return axis, area, centroid, covariance, growth, voxel
