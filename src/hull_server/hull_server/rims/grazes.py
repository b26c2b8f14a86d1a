"""Where a ray runs along the hull: marching through its voxels and their neighbours."""

from __future__ import annotations

import numpy as np
from numba import njit

from ..kernel import kernel
from ..slicing.runs import run_at

PAD = 2  # empty voxels around the box, so that its neighbours have room
FRACTION = 32  # bits of a voxel's fraction while marching: whole numbers are faster, and err by 1e-7 voxels at the end
_U1 = np.uint64(1)


@njit(cache=True, nogil=True)
def widen(words, starts, ends, first):  # type: ignore[no-untyped-def]
    """The voxels of a hull's runs and their 26 neighbours, as bits of rows along x of a box wider by PAD, and the
    voxels of that box along x, y and z."""
    layers, rows, width = words.shape
    wide = np.zeros((layers + 2 * PAD, rows + 2 * PAD, width + 1), np.uint64)
    size = (ends.max() + 2 * PAD, rows + 2 * PAD, layers + 2 * PAD)
    for s in range(layers):
        for r in range(rows):
            for run in range(first[s * rows + r], first[s * rows + r + 1]):
                for layer in range(s + PAD - 1, s + PAD + 2):
                    for row in range(r + PAD - 1, r + PAD + 2):
                        _fill(wide[layer, row], starts[run] + PAD - 1, ends[run] + PAD + 1)
    return wide, size


@kernel
def _fill(row, start, end):  # type: ignore[no-untyped-def]
    """Set the bits from ``start`` up to but not including ``end``."""
    for word in range(start >> 6, ((end - 1) >> 6) + 1):
        low, high = max(start - 64 * word, 0), min(end - 64 * word, 64)
        ones = ~np.uint64(0) >> np.uint64(64 - (high - low))
        row[word] |= ones << np.uint64(low)


@kernel
def graze(wide, size, start, direction):  # type: ignore[no-untyped-def]
    """From where to where the longest stretch of a ray along the hull runs; equal where there is none.

    wide and size as :func:`widen` gives them; start (3,) and unit direction (3,) in voxels from that box's corner;
    lengths in voxels from the start. A stretch of a single voxel may be passed over.
    """
    near, far = _within_box(size, start, direction)
    first, step = _fixed(start, direction, near + 0.5), _fixed((0.0, 0.0, 0.0), direction, 1.0)
    steps, begin, best, longest = int(max(far - near, 0.0)), -1, 0, 0
    for n in range(0, steps + 2, 2):
        occupied = n < steps and _occupied(wide, first, step, n)
        if occupied and begin < 0:
            begin = n - (n > 0 and _occupied(wide, first, step, n - 1))
        elif not occupied and begin >= 0:
            end = n - 1 + (n - 1 < steps and _occupied(wide, first, step, n - 1))
            if end - begin > longest:
                best, longest = begin, end - begin
            begin = -1
    return near + best, near + best + longest


@kernel
def _within_box(size, start, direction):  # type: ignore[no-untyped-def]
    """The lengths between which a ray is in the box, less a voxel all around that is always empty."""
    near, far = 0.0, 1e9
    for axis in range(3):
        low, high = 1.0, size[axis] - 1.0
        if abs(direction[axis]) < 1e-12:
            if not low <= start[axis] < high:
                return 1.0, 0.0
            continue
        a, b = (low - start[axis]) / direction[axis], (high - start[axis]) / direction[axis]
        near, far = max(near, min(a, b)), min(far, max(a, b))
    return near, far


@kernel
def _fixed(start, direction, length):  # type: ignore[no-untyped-def]
    """A place on a ray as whole numbers of 1 / 2^FRACTION voxels."""
    one = 1 << FRACTION
    x, y, z = start[0] + length * direction[0], start[1] + length * direction[1], start[2] + length * direction[2]
    return int(x * one), int(y * one), int(z * one)


@kernel
def _occupied(wide, first, step, n):  # type: ignore[no-untyped-def]
    """Is the voxel ``n`` steps along occupied?"""
    x = np.uint64(first[0] + n * step[0] >> FRACTION)
    y = np.uint64(first[1] + n * step[1] >> FRACTION)
    z = np.uint64(first[2] + n * step[2] >> FRACTION)
    return wide[z, y, x >> np.uint64(6)] >> (x & np.uint64(63)) & _U1 != 0


@kernel
def part_near(runs, place):  # type: ignore[no-untyped-def]
    """The part of the hull that a voxel near a place belongs to: the first one in ever larger cubes around it.

    runs : starts, ends, first, part and the shape of words of :class:`hull_server.slicing.slicer.HullRuns`; place (3,)
    in voxels from the corner of the widened box.
    """
    starts, ends, first, part, (layers, rows, _) = runs
    x, y, z = int(place[0]) - PAD, int(place[1]) - PAD, int(place[2]) - PAD
    for reach in range(PAD + 2):
        for s in range(max(z - reach, 0), min(z + reach + 1, layers)):
            for r in range(max(y - reach, 0), min(y + reach + 1, rows)):
                for column in range(x - reach, x + reach + 1):
                    run = run_at(starts, ends, first, s * rows + r, column)
                    if run >= 0:
                        return part[run]
    return part[0]
