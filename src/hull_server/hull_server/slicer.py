"""Skeletonisation, first half (thesis 3.2): the blobs of all slices along x, y and z at once.

A blob is a connected component (8 neighbours) of one slice. Slices are never drawn: each row of voxels becomes a few
runs of consecutive voxels, runs that touch in neighbouring rows join, and the area, centroid and second moments of a
blob are sums of closed forms over its runs.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from numba import njit

from .bits import ROW_AXES, erode, lowest_bit, pack_rows, popcount
from .bricks import BrickVolume
from .grid import Array

VOXEL_VARIANCE = 1.0 / 12.0  # of a unit interval: what a blob of a single voxel has along each side


@dataclass(frozen=True, eq=False)
class BlobTable:
    """The n blobs of all slices, ordered by axis, slice, and position of their first voxel. Lengths in voxels.

    axis : (n,) uint8, the axis that the slice is perpendicular to: 0 = x, 1 = y, 2 = z.
    area : (n,) voxels in the blob.
    centroid : (n, 3) voxel indices (i, j, k), fractional; the index of the slice along ``axis``.
    covariance : (n, 3) central second moments uu, vv, uv of the voxel centres; u, v are the slice's two axes in
        ascending order.
    """

    axis: npt.NDArray[np.uint8]
    area: Array
    centroid: Array
    covariance: Array

    def __len__(self) -> int:
        return len(self.axis)

    def principal_variances(self) -> tuple[Array, Array]:
        """(n,) larger and (n,) smaller variance along a blob's principal axes, voxels as squares, not points."""
        uu, vv, uv = self.covariance.T + VOXEL_VARIANCE * np.array([[1.0], [1.0], [0.0]])
        middle, radius = (uu + vv) / 2, np.hypot((uu - vv) / 2, uv)
        return middle + radius, np.maximum(middle - radius, VOXEL_VARIANCE / 2)

    def elongation(self) -> Array:
        """(n,) ratio of the principal axes, at least 1 (thesis fig. 3.4)."""
        larger, smaller = self.principal_variances()
        return np.sqrt(larger / smaller)

    def fill(self) -> Array:
        """(n,) area over that of the ellipse with the same second moments: 1 for an ellipse, 0.95 for a rectangle.

        Low for a blob that is not convex, or that merges two: its centroid may lie outside of it (thesis 3.2).
        """
        larger, smaller = self.principal_variances()
        return self.area / (4 * np.pi * np.sqrt(larger * smaller))


def slice_blobs(volume: BrickVolume, erosion_voxels: int = 0) -> BlobTable:
    """All blobs of all slices across x, y and z, after ``erosion_voxels`` erosions (4 neighbours) of each slice."""
    if not len(volume.index):
        return BlobTable(np.zeros(0, np.uint8), np.zeros(0), np.zeros((0, 3)), np.zeros((0, 3)))
    tables = [_blobs_across(volume, axis, erosion_voxels) for axis in range(3)]
    axis, area, centroid, covariance = (np.concatenate(column) for column in zip(*tables, strict=True))
    return BlobTable(axis, area, centroid, covariance)


def _blobs_across(volume: BrickVolume, axis: int, erosion_voxels: int) -> tuple[np.ndarray, ...]:
    words, low = pack_rows(volume, axis)
    for _ in range(erosion_voxels):
        words = erode(words)
    starts, ends, first = find_runs(words)
    parent = _connect(starts, ends, first, *words.shape[:2])
    slices, sums = _sum_blobs(starts, ends, parent, first, *words.shape[:2])
    area, u, v, uu, vv, uv = sums.T
    u, v = u / area, v / area
    along, across = ROW_AXES[axis]
    centroid = np.empty((len(area), 3))
    centroid[:, along], centroid[:, across], centroid[:, axis] = u, v, slices
    covariance = np.stack([uu / area - u * u, vv / area - v * v, uv / area - u * v], axis=1)
    return np.full(len(area), axis, np.uint8), area, centroid + low, covariance


@njit(cache=True, nogil=True)
def find_runs(words):  # type: ignore[no-untyped-def]
    """Runs of set bits: starts (m,), ends (m,) (exclusive), and the first run of each row (slices * rows + 1,)."""
    slices, rows, width = words.shape
    capacity = _count_runs(words)
    starts, ends = np.empty(capacity, np.int32), np.empty(capacity, np.int32)
    first = np.empty(slices * rows + 1, np.int32)
    line, run = 0, 0
    for s in range(slices):
        for r in range(rows):
            first[line] = run
            line += 1
            inside = np.uint64(0)
            for w in range(width):
                word = words[s, r, w]
                changes = word ^ (word << np.uint64(1) | inside)
                while changes != 0:
                    position = 64 * w + lowest_bit(changes)
                    changes &= changes - np.uint64(1)
                    if inside:
                        ends[run] = position
                        run += 1
                    else:
                        starts[run] = position
                    inside ^= np.uint64(1)
            if inside:
                ends[run] = 64 * width
                run += 1
    first[line] = run
    return starts[:run], ends[:run], first


@njit(cache=True, nogil=True)
def _count_runs(words):  # type: ignore[no-untyped-def]
    """Runs, those across a word's border counted twice."""
    count = 0
    for s in range(words.shape[0]):
        for r in range(words.shape[1]):
            for w in range(words.shape[2]):
                if words[s, r, w] != 0:
                    count += popcount(words[s, r, w] & ~(words[s, r, w] << np.uint64(1)))
    return count


@njit(cache=True, nogil=True)
def _connect(starts, ends, first, slices, rows):  # type: ignore[no-untyped-def]
    """Union-find forest (m,) of the runs: those that touch, also diagonally, in neighbouring rows of a slice join.

    A root is the first run of its blob.
    """
    parent = np.arange(starts.size).astype(np.int32)
    for s in range(slices):
        for line in range(s * rows, (s + 1) * rows - 1):
            above, below = first[line], first[line + 1]
            while above < first[line + 1] and below < first[line + 2]:
                if starts[below] <= ends[above] and starts[above] <= ends[below]:
                    a, b = _root(parent, above), _root(parent, below)
                    parent[max(a, b)] = min(a, b)
                if ends[above] < ends[below]:
                    above += 1
                else:
                    below += 1
    return parent


@njit(cache=True, nogil=True)
def _root(parent, run):  # type: ignore[no-untyped-def]
    while parent[run] != run:
        parent[run] = parent[parent[run]]
        run = parent[run]
    return run


@njit(cache=True, nogil=True)
def _sum_blobs(starts, ends, parent, first, slices, rows):  # type: ignore[no-untyped-def]
    """The slice of each blob (n,) and its sums of 1, u, v, uu, vv, uv over its voxels (n, 6).

    The sums are whole numbers far below 2**53, so float64 holds them exactly.
    """
    blob_of_root = np.full(parent.size, -1, np.int32)
    slice_of_blob, sums = np.empty(parent.size, np.int32), np.zeros((parent.size, 6))
    blobs = 0
    for s in range(slices):
        for r in range(rows):
            v = float(r)
            for run in range(first[s * rows + r], first[s * rows + r + 1]):
                root = _root(parent, run)
                if blob_of_root[root] < 0:
                    blob_of_root[root] = blobs
                    slice_of_blob[blobs] = s
                    blobs += 1
                blob = blob_of_root[root]
                a, b = float(starts[run]), float(ends[run]) - 1.0
                n = b - a + 1.0
                u = (a + b) * n * 0.5
                sums[blob, 0] += n
                sums[blob, 1] += u
                sums[blob, 2] += v * n
                sums[blob, 3] += (b * (b + 1.0) * (2.0 * b + 1.0) - (a - 1.0) * a * (2.0 * a - 1.0)) / 6.0
                sums[blob, 4] += v * v * n
                sums[blob, 5] += v * u
    return slice_of_blob[:blobs], sums[:blobs]
