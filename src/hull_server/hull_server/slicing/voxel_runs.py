"""Packs bricks of voxels into rows of 64-bit words, finds runs in them, joins those that touch, and samples voxels.

Runs that touch in a slice are blobs; runs that touch in space are parts of the hull. Both are found with a union-find
forest of labels, in which the smallest label of a tree is its root.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from capture_rig.kernel import njit
from mocap_packets.hull import NO_VOXELS, VoxelSamples

from ..bitset import lowest_bit, popcount, select_bit, transpose8
from ..grid import VoxelGrid

_U1 = np.uint64(1)
# Thresholds: judgement, no measurement.
SURFACE_SHARE = 2.0 / 3.0  # of the samples, as long as there are enough voxels of both kinds
GOLDEN = (math.sqrt(5.0) - 1.0) / 2.0


class HullRuns(NamedTuple):
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


@njit(cache=True, nogil=True)
def brick_box(index, bricks_x, bricks_y):  # type: ignore[no-untyped-def]
    """Bound all bricks: low x, y, z and high x, y, z (exclusive); zeros for none."""
    if index.size == 0:
        return 0, 0, 0, 0, 0, 0
    low_x, low_y, low_z, high_x, high_y, high_z = bricks_x, bricks_y, 1 << 30, 0, 0, 0
    for brick in range(index.size):
        flat = np.int64(index[brick])
        x, y, z = flat % bricks_x, flat // bricks_x % bricks_y, flat // (bricks_x * bricks_y)
        low_x, high_x = min(low_x, x), max(high_x, x + 1)
        low_y, high_y = min(low_y, y), max(high_y, y + 1)
        low_z, high_z = min(low_z, z), max(high_z, z + 1)
    return low_x, low_y, low_z, high_x, high_y, high_z


@njit(cache=True, nogil=True)
def pack_rows(index, leaves, bricks_x, bricks_y, box):  # type: ignore[no-untyped-def]
    """Pack the voxels in a box of bricks into rows of bits along x (z, y, words) and along y (z, x, words).

    Bit b of word w is voxel 64 w + b along the row, counted from the box's low corner. A brick's rows are bytes of
    these words, written as such: machines are little-endian.
    """
    low_x, low_y, low_z, high_x, high_y, high_z = box
    nx, ny, nz = 8 * (high_x - low_x), 8 * (high_y - low_y), 8 * (high_z - low_z)
    along_x = np.zeros((nz, ny, (nx + 63) // 64), np.uint64)
    along_y = np.zeros((nz, nx, (ny + 63) // 64), np.uint64)
    bytes_x, bytes_y = along_x.view(np.uint8), along_y.view(np.uint8)
    for brick in range(index.size):
        flat = np.int64(index[brick])
        x, y = flat % bricks_x - low_x, flat // bricks_x % bricks_y - low_y
        z = 8 * (flat // (bricks_x * bricks_y) - low_z)
        for k in range(8):
            layer = leaves[brick, k]
            if layer == 0:
                continue
            turned = transpose8(layer)
            for row in range(8):
                bytes_x[z + k, 8 * y + row, x] = layer & np.uint64(255)
                bytes_y[z + k, 8 * x + row, y] = turned & np.uint64(255)
                layer >>= np.uint64(8)
                turned >>= np.uint64(8)
    return along_x, along_y


@njit(cache=True, nogil=True, inline="always")
def sides(words, s, r, w):  # type: ignore[no-untyped-def]
    """Return the voxels of a word whose neighbours along the row are both occupied."""
    word = words[s, r, w]
    before = words[s, r, w - 1] >> np.uint64(63) if w > 0 else np.uint64(0)
    after = words[s, r, w + 1] << np.uint64(63) if w + 1 < words.shape[2] else np.uint64(0)
    return word & (word << _U1 | before) & (word >> _U1 | after)


@njit(cache=True, nogil=True)
def find_bit_runs(words):  # type: ignore[no-untyped-def]
    """Find the runs of set bits of rows (layers, rows, words).

    Returns starts (m,), ends (m,) (exclusive), the first run of each row (layers * rows + 1,), and the rows that have
    any (f,), as numbers layer * rows + row.
    """
    layers, rows, width = words.shape
    starts, ends = np.empty(words.size * 32 + 1, np.int32), np.empty(words.size * 32 + 1, np.int32)  # at worst
    first, filled = np.empty(layers * rows + 1, np.int32), np.empty(layers * rows, np.int32)
    line, run, used = 0, 0, 0
    for s in range(layers):
        for r in range(rows):
            begin, inside = run, np.uint64(0)
            first[line] = run
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
            if run > begin:
                filled[used] = line
                used += 1
            line += 1
    first[line] = run
    return starts[:run].copy(), ends[:run].copy(), first, filled[:used].copy()


@njit(cache=True, nogil=True)
def join_in_slices(runs, rows, across_layers):  # type: ignore[no-untyped-def]
    """Join runs of :func:`find_bit_runs` that touch in a slice: label (m,) of each run, and the forest (n,) of labels.

    Runs of one slice that touch in neighbouring rows, also diagonally, get labels of one tree. A slice is a layer, or
    with ``across_layers`` the rows of one number in all layers.
    """
    starts, _, first, filled = runs
    labels, forest = np.full(starts.size, -1, np.int32), np.empty(starts.size, np.int32)
    count = 0
    for line in filled:
        above = line - rows if across_layers else line - 1
        if above >= 0 and (across_layers or line % rows > 0):
            _join_rows(runs, line, above, labels, forest)
        for run in range(first[line], first[line + 1]):
            if labels[run] < 0:
                labels[run] = forest[count] = count
                count += 1
    forest = forest[:count]
    flatten(forest)
    return labels, forest


@njit(cache=True, nogil=True, inline="always")
def _join_rows(runs, line, above, labels, forest):  # type: ignore[no-untyped-def]
    """Give the runs of a row the labels of those above that they touch; join labels that touch one run."""
    starts, ends, first, _ = runs
    run, other = first[line], first[above]
    last, last_other = first[line + 1], first[above + 1]
    while run < last and other < last_other:
        if starts[run] <= ends[other] and starts[other] <= ends[run]:
            if labels[run] < 0:
                labels[run] = labels[other]
            elif labels[run] != labels[other]:
                join(forest, labels[run], labels[other])
        if ends[run] < ends[other]:
            run += 1
        else:
            other += 1


@njit(cache=True, nogil=True)
def join_in_space(joined_z, joined_y):  # type: ignore[no-untyped-def]
    """Join runs that touch in space: the part (m,) of the hull of each run, numbered by their first runs.

    Blobs of the slices across z and across y that share a run are of one part. So voxels join that touch in such a
    slice by a face, an edge or a corner; two that touch only along an edge parallel to x, or only in a corner, do not.
    """
    (z_labels, z_forest), (y_labels, y_forest) = joined_z, joined_y
    offset = z_forest.size
    forest = np.empty(offset + y_forest.size, np.int32)
    forest[:offset] = z_forest
    forest[offset:] = y_forest + np.int32(offset)
    for run in range(z_labels.size):
        join(forest, z_labels[run], offset + y_labels[run])
    flatten(forest)
    number, count = np.empty(offset, np.int32), 0
    for label in range(offset):  # a root is the smallest label of its tree, so always one of z
        if forest[label] == label:
            number[label] = count
            count += 1
    part = np.empty(z_labels.size, np.int32)
    for run in range(part.size):
        part[run] = number[forest[z_labels[run]]]
    return part


@njit(cache=True, nogil=True, inline="always")
def join(forest, a, b):  # type: ignore[no-untyped-def]
    """Make the trees of two labels one."""
    a, b = root_of(forest, a), root_of(forest, b)
    forest[max(a, b)] = min(a, b)


@njit(cache=True, nogil=True, inline="always")
def root_of(forest, label):  # type: ignore[no-untyped-def]
    while forest[label] != label:
        forest[label] = forest[forest[label]]
        label = forest[label]
    return label


@njit(cache=True, nogil=True, inline="always")
def flatten(forest):  # type: ignore[no-untyped-def]
    """Put every label directly under its root; parents come before their children."""
    for label in range(forest.size):
        forest[label] = forest[forest[label]]


@njit(cache=True, nogil=True, inline="always")
def run_at(starts, ends, first, line, position):  # type: ignore[no-untyped-def]
    """Return the run of a row that holds a position, or -1."""
    for run in range(first[line], first[line + 1]):
        if starts[run] <= position < ends[run]:
            return run
    return -1


# --- samples of the voxels, on the surface and inside, evenly and deterministically


def sample_runs(runs: HullRuns, grid: VoxelGrid, max_voxels: int) -> VoxelSamples:
    """Sample at most ``max_voxels`` voxels, spread evenly over the surface and the interior; deterministic. As body
    they carry the number of their part."""
    if not len(runs.starts) or max_voxels == 0:
        return NO_VOXELS
    interior, on_surface, inside = _find_interior(runs.words, runs.first)
    from_surface, from_inside = _quotas(on_surface, inside, max_voxels)
    points, part = np.empty((from_surface + from_inside, 3)), np.empty(from_surface + from_inside, np.int32)
    place = grid.centres_world(runs.low), grid.voxel_size
    ranks = _spread(on_surface, from_surface)
    _pick(runs, place, interior, False, ranks, points[:from_surface], part[:from_surface])
    ranks = _spread(inside, from_inside)
    _pick(runs, place, interior, True, ranks, points[from_surface:], part[from_surface:])
    return VoxelSamples(points, np.arange(len(points)) < from_surface, part)


def _quotas(on_surface: int, inside: int, wanted: int) -> tuple[int, int]:
    """Return how many samples to take of each kind; where one has too few voxels, the other gets more."""
    from_surface = min(on_surface, round(wanted * SURFACE_SHARE))
    from_inside = min(inside, wanted - from_surface)
    return min(on_surface, wanted - from_inside), from_inside


@njit(cache=True, nogil=True)
def _spread(total, wanted):  # type: ignore[no-untyped-def]
    """Return ``wanted`` different ranks below ``total``, ascending: one in each equal stretch, by the golden ratio.

    Every n-th voxel instead would draw stripes where n and the length of a row agree.
    """
    ranks = np.empty(wanted, np.int64)
    start = 0
    for n in range(wanted):
        end, turn = (n + 1) * total // wanted, n * GOLDEN
        ranks[n] = start + int((turn - np.floor(turn)) * (end - start))
        start = end
    return ranks


@njit(cache=True, nogil=True)
def _find_interior(words, first):  # type: ignore[no-untyped-def]
    """Find the voxels all of whose six neighbours are occupied, as bits; count the other voxels, and these."""
    interior = np.zeros_like(words)
    layers, rows, width = words.shape
    inside, total = 0, 0
    for s in range(layers):
        for r in range(rows):
            if first[s * rows + r] == first[s * rows + r + 1]:
                continue
            within = 0 < s < layers - 1 and 0 < r < rows - 1
            for w in range(width):
                total += popcount(words[s, r, w])
                if within and words[s, r, w] != 0:
                    around = words[s, r - 1, w] & words[s, r + 1, w] & words[s - 1, r, w] & words[s + 1, r, w]
                    interior[s, r, w] = sides(words, s, r, w) & around
                    inside += popcount(interior[s, r, w])
    return interior, total - inside, inside


@njit(cache=True, nogil=True)
def _pick(runs, place, interior, inside, ranks, points, part_of_point):  # type: ignore[no-untyped-def]
    """Write the centres in the world, and the parts, of the voxels of ascending ranks, inside or on the surface."""
    (words, _, starts, ends, first, part), (origin, voxel_m) = runs, place
    layers, rows, width = words.shape
    n, rank = 0, 0
    for s in range(layers):
        for r in range(rows):
            line = s * rows + r
            if n == ranks.size or first[line] == first[line + 1]:
                continue
            for w in range(width):
                word = interior[s, r, w] if inside else words[s, r, w] & ~interior[s, r, w]
                here = popcount(word)
                while n < ranks.size and ranks[n] < rank + here:
                    x = 64 * w + select_bit(word, ranks[n] - rank)
                    points[n, 0] = origin[0] + x * voxel_m
                    points[n, 1] = origin[1] + r * voxel_m
                    points[n, 2] = origin[2] + s * voxel_m
                    part_of_point[n] = part[run_at(starts, ends, first, line, x)]
                    n += 1
                rank += here
