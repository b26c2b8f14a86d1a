"""The decimated voxel cloud: surface and interior samples of the hull, the same ones every time."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from numba import njit

from .bits import lowest_bit, pack_rows, popcount, sides
from .bricks import BrickVolume
from .grid import Array

SURFACE_SHARE = 2.0 / 3.0  # of the samples, as long as there are enough voxels of both kinds
GOLDEN = 0.6180339887498949


@dataclass(frozen=True, eq=False)
class VoxelSamples:
    """Voxel centres (n, 3), metres, map frame; surface (n,) is True where one of six neighbours is empty."""

    points_world: Array
    surface: npt.NDArray[np.bool_]

    def __len__(self) -> int:
        return len(self.surface)


def sample_voxels(volume: BrickVolume, max_voxels: int) -> VoxelSamples:
    """At most ``max_voxels`` voxels, spread evenly over the surface and the interior; deterministic."""
    if not len(volume.index) or max_voxels == 0:
        return VoxelSamples(np.zeros((0, 3)), np.zeros(0, bool))
    words, low = pack_rows(volume, axis=2)
    interior = interior_voxels(words)
    shell = words & ~interior
    on_surface, inside = count_bits(shell), count_bits(interior)
    from_surface, from_inside = _quotas(on_surface, inside, max_voxels)
    voxels = np.concatenate(
        [
            pick_bits(shell, _spread(on_surface, from_surface)),
            pick_bits(interior, _spread(inside, from_inside)),
        ]
    )
    surface = np.arange(len(voxels)) < from_surface
    return VoxelSamples(volume.grid.centres_world(voxels + low), surface)


def _quotas(on_surface: int, inside: int, wanted: int) -> tuple[int, int]:
    """How many samples to take of each kind; what one kind cannot give, the other does."""
    from_surface = min(on_surface, round(wanted * SURFACE_SHARE))
    from_inside = min(inside, wanted - from_surface)
    return min(on_surface, wanted - from_inside), from_inside


def _spread(total: int, wanted: int) -> npt.NDArray[np.int64]:
    """``wanted`` different ranks below ``total``, ascending: one in each equal stretch, by the golden ratio.

    Taking every n-th voxel instead would draw stripes wherever n and the length of a row agree.
    """
    n = np.arange(wanted)
    starts = np.arange(wanted + 1) * total // max(wanted, 1)
    return starts[:-1] + (n * GOLDEN % 1.0 * np.diff(starts)).astype(np.int64)


@njit(cache=True, nogil=True)
def interior_voxels(words):  # type: ignore[no-untyped-def]
    """The voxels all of whose six neighbours are occupied, of (slices, rows, words) bits."""
    interior = np.zeros_like(words)
    slices, rows, width = words.shape
    for s in range(1, slices - 1):
        for r in range(1, rows - 1):
            for w in range(width):
                if words[s, r, w] != 0:
                    around = words[s, r - 1, w] & words[s, r + 1, w] & words[s - 1, r, w] & words[s + 1, r, w]
                    interior[s, r, w] = sides(words, s, r, w) & around
    return interior


@njit(cache=True, nogil=True)
def count_bits(words):  # type: ignore[no-untyped-def]
    count = 0
    for s in range(words.shape[0]):
        for r in range(words.shape[1]):
            for w in range(words.shape[2]):
                if words[s, r, w] != 0:
                    count += popcount(words[s, r, w])
    return count


@njit(cache=True, nogil=True)
def pick_bits(words, ranks):  # type: ignore[no-untyped-def]
    """Positions (n, 3) as (bit along the row, row, slice) of the set bits with the given ascending ranks."""
    picked = np.empty((ranks.size, 3), np.int64)
    n, rank = 0, 0
    for s in range(words.shape[0]):
        for r in range(words.shape[1]):
            for w in range(words.shape[2]):
                word = words[s, r, w]
                if word == 0:
                    continue
                here = popcount(word)
                while n < ranks.size and ranks[n] < rank + here:
                    rest = word
                    for _ in range(ranks[n] - rank):
                        rest &= rest - np.uint64(1)
                    picked[n, 0], picked[n, 1], picked[n, 2] = 64 * w + lowest_bit(rest), r, s
                    n += 1
                rank += here
    return picked
