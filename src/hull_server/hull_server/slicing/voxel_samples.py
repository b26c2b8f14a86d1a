"""Samples the hull's voxels, on the surface and inside, evenly and deterministically."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from capture_rig.kernel import njit
from mocap_packets.hull import NO_VOXELS, VoxelSamples

from ..bitset import popcount, select_bit
from ..grid import VoxelGrid
from .skeletonisation import HullRuns
from .voxel_runs import run_at, sides

# Thresholds: judgement, no measurement.
SURFACE_SHARE = 2.0 / 3.0  # of the samples, as long as there are enough voxels of both kinds
GOLDEN = 0.6180339887498949


def sample_runs(
    runs: HullRuns, grid: VoxelGrid, max_voxels: int, number_of_part: npt.NDArray[np.int32] | None = None
) -> VoxelSamples:
    """Sample at most ``max_voxels`` voxels, spread evenly over the surface and the interior; deterministic.

    They carry the number of their part's body (see :class:`hull_server.slicing.bodies.Bodies`); without
    ``number_of_part``, that of the part itself.
    """
    if not len(runs.starts) or max_voxels == 0:
        return NO_VOXELS
    interior, on_surface, inside = _find_interior(runs.words, runs.first)
    from_surface, from_inside = _quotas(on_surface, inside, max_voxels)
    points, part = np.empty((from_surface + from_inside, 3)), np.empty(from_surface + from_inside, np.int32)
    rows = (runs.starts, runs.ends, runs.first, runs.part, grid.centres_world(runs.low), grid.voxel_size)
    ranks = _spread(on_surface, from_surface)
    _pick(runs.words, interior, False, ranks, rows, points[:from_surface], part[:from_surface])
    ranks = _spread(inside, from_inside)
    _pick(runs.words, interior, True, ranks, rows, points[from_surface:], part[from_surface:])
    body = part if number_of_part is None else number_of_part[part]
    return VoxelSamples(points, np.arange(len(points)) < from_surface, body)


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
def _pick(words, interior, inside, ranks, run_rows, points, part_of_point):  # type: ignore[no-untyped-def]
    """Write the centres in the world, and the parts, of the voxels of ascending ranks, inside or on the surface."""
    starts, ends, first, part, origin, voxel_m = run_rows
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
