"""Intersection of rays with a hull of voxels: the interval of a ray in which it can touch the body.

The hull is its voxels, dilated by a voxel, as bits of rows along x; a ray marches through them in fixed point.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from capture_rig.kernel import kernel, njit

from ..grid import VoxelGrid
from ..slicing.voxel_runs import HullRuns, run_at

PAD = 2  # empty voxels around the box, so that its neighbours have room
FRACTION = 32  # bits of a voxel's fraction while marching: whole numbers are faster, and err by 1e-7 voxels at the end
_U1 = np.uint64(1)


class Hull(NamedTuple):
    """The hull that rays may touch.

    wide, size : see :func:`widen`. corner (3,) of its box in metres, map frame; voxel_m. several : whether the hull has
    more than one part.
    """

    wide: npt.NDArray[np.uint64]
    size: tuple[int, int, int]
    corner: npt.NDArray[np.float64]
    voxel_m: float
    runs: HullRuns
    several: bool

    @classmethod
    def of(cls, runs: HullRuns, grid: VoxelGrid) -> Hull:
        """Return the hull of these runs."""
        wide, size = widen(runs.words, runs.ends)
        corner = grid.origin + (runs.low - PAD) * grid.voxel_size
        return cls(wide, size, corner, grid.voxel_size, runs, bool(runs.part.any()))


@njit(cache=True, nogil=True)
def widen(words, ends):  # type: ignore[no-untyped-def]
    """Dilate a hull by its 26 neighbours: bits of rows along x of a box wider by PAD, and that box's size."""
    layers, rows, width = words.shape
    wide = np.zeros((layers + 2 * PAD, rows + 2 * PAD, width + 1), np.uint64)
    size = (ends.max() + 2 * PAD, rows + 2 * PAD, layers + 2 * PAD)
    for s in range(layers):
        for r in range(rows):
            for w in range(width):
                word = words[s, r, w]
                if word == 0:
                    continue
                low, high = np.uint64(0), np.uint64(0)
                for shift in range(PAD - 1, PAD + 2):
                    low |= word << np.uint64(shift)
                    high |= word >> np.uint64(64 - shift)
                for layer in range(s + PAD - 1, s + PAD + 2):
                    for row in range(r + PAD - 1, r + PAD + 2):
                        wide[layer, row, w] |= low
                        wide[layer, row, w + 1] |= high
    return wide, size


@kernel
def ray_hull_interval(hull, start, direction):  # type: ignore[no-untyped-def]
    """Find the interval in which a ray can touch the body: lengths from and to, equal where there is none.

    It is that of the dilated hull. A ray often meets a hull of few cameras more than once, in a limb and in the phantom
    of another, and touches one of them, so the interval spans all stretches in the same part of the hull as the
    longest. start (3,) and unit direction (3,) in voxels from the corner of the hull's box; lengths in voxels from the
    start. A stretch of a single voxel may be missed.
    """
    wide, (near, far) = hull.wide, _within_box(hull.size, start, direction)
    first, step = _fixed(start, direction, near + 0.5), _fixed((0.0, 0.0, 0.0), direction, 1.0)
    steps, stretches, begin, end, best, longest, n = int(max(far - near, 0.0)), 0, 0, 0, 0, 0, 0
    while n <= steps + 1:
        one, other, n = _next_stretch(wide, first, step, steps, n)
        if other > one:
            begin, end, stretches = one if stretches == 0 else begin, other, stretches + 1
            if other - one > longest:
                best, longest = one, other - one
    if stretches < 2:
        return near + best, near + best + longest
    if not hull.several:
        return near + begin, near + end
    own, n = _part_along(hull, start, direction, near + best + 0.5 * longest), 0
    begin, end = best, best + longest
    while n <= steps + 1:
        one, other, n = _next_stretch(wide, first, step, steps, n)
        if other > one and _part_along(hull, start, direction, near + 0.5 * (one + other)) == own:
            begin, end = min(begin, one), max(end, other)
    return near + begin, near + end


@kernel
def _next_stretch(wide, first, step, steps, n):  # type: ignore[no-untyped-def]
    """Return the next occupied voxels along a ray from step ``n`` on, from and to, and where to go on."""
    begin = -1
    while n < steps + 2:
        occupied = n < steps and _occupied(wide, first, step, n)
        if occupied and begin < 0:
            begin = n - (n > 0 and _occupied(wide, first, step, n - 1))
        elif not occupied and begin >= 0:
            return begin, n - 1 + (n - 1 < steps and _occupied(wide, first, step, n - 1)), n + 2
        n += 2
    return 0, 0, n


@kernel
def _part_along(hull, start, direction, length):  # type: ignore[no-untyped-def]
    """Return the part of the hull near a place on a ray."""
    x, y, z = start[0] + length * direction[0], start[1] + length * direction[1], start[2] + length * direction[2]
    return part_near(hull.runs, (x, y, z))


@kernel
def _within_box(size, start, direction):  # type: ignore[no-untyped-def]
    """Return the lengths between which a ray is in the box, less its outermost voxels, which are always empty."""
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
    """Return a point on a ray in fixed point: whole numbers of 1 / 2^FRACTION voxels."""
    one = 1 << FRACTION
    x, y, z = start[0] + length * direction[0], start[1] + length * direction[1], start[2] + length * direction[2]
    return int(x * one), int(y * one), int(z * one)


@kernel
def _occupied(wide, first, step, n):  # type: ignore[no-untyped-def]
    """Check the voxel ``n`` steps along."""
    x = np.uint64(first[0] + n * step[0] >> FRACTION)
    y = np.uint64(first[1] + n * step[1] >> FRACTION)
    z = np.uint64(first[2] + n * step[2] >> FRACTION)
    return wide[z, y, x >> np.uint64(6)] >> (x & np.uint64(63)) & _U1 != 0


@kernel
def part_near(runs, place):  # type: ignore[no-untyped-def]
    """Return the part of the hull that a voxel near a place belongs to: the first found in growing cubes around it.

    place (3,) in voxels from the corner of the widened box.
    """
    words, _, starts, ends, first, part = runs
    layers, rows, _ = words.shape
    x, y, z = int(place[0]) - PAD, int(place[1]) - PAD, int(place[2]) - PAD
    for reach in range(PAD + 2):
        for s in range(max(z - reach, 0), min(z + reach + 1, layers)):
            for r in range(max(y - reach, 0), min(y + reach + 1, rows)):
                for column in range(x - reach, x + reach + 1):
                    run = run_at(starts, ends, first, s * rows + r, column)
                    if run >= 0:
                        return part[run]
    return part[0]
