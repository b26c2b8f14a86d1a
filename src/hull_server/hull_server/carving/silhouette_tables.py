"""The tables that the CPU carve reads: of the calibration, and of one frame set's silhouettes, as levels and summed."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from capture_rig.kernel import kernel

from ..bitset import high_bytes, nonzero_bytes

# a foreground pixel counts 2 in the summed areas, an uncertain one 1; see also ALL_SURE
EVEN_BYTES = np.uint64(0x00FF00FF00FF00FF)
NOT_BLIND = np.uint64(0xFEFEFEFEFEFEFEFE)  # bits that BLIND does not have


class Scene(NamedTuple):
    """The calibration (fixed) and the silhouettes of one frame set.

    projections (N, 3, 4): voxel index to pixel. sizes (N, 2): canvases. seen_table (N, H + 1, W + 1).
    voxel_steps (N, 3, 64), octant_steps (N, 3, 64): see :mod:`.carve_blocks`.
    levels (N, H * W + 8): the level of every pixel, and BLIND for all that lies outside.
    stride: W. foreground_box (N, 4): u, v from and to of a box that holds all foreground pixels.
    foreground_table (N, (H / 2 + 2) * (W / 2 + 1)): summed areas inside that box, in squares of 2 x 2 pixels, of the
    foreground and of what is uncertain; from its corner, row after row without gaps (which takes a fraction of the
    memory pages that a canvas would).
    present (n,): cameras of this frame set, in the order in which they are tested; the result does not depend on it.
    min_seeing: cameras that must see a voxel. vetoes: how many may veto it nevertheless, 0 or 1. shape (3,): the grid.
    """

    projections: npt.NDArray[np.float64]
    voxel_steps: npt.NDArray[np.float64]
    octant_steps: npt.NDArray[np.float32]
    sizes: npt.NDArray[np.int64]
    seen_table: npt.NDArray[np.int32]
    levels: npt.NDArray[np.uint8]
    stride: int
    foreground_box: npt.NDArray[np.int64]
    foreground_table: npt.NDArray[np.int32]
    present: npt.NDArray[np.int64]
    min_seeing: int
    vetoes: int
    shape: npt.NDArray[np.int64]


class SummedSquares:
    """table : see Scene; of the last silhouette of each camera."""

    def __init__(self, seen: npt.NDArray[np.uint8]) -> None:
        cameras, height, width = seen.shape
        self.table = np.zeros((cameras, (height // 2 + 2) * (width // 2 + 1)), np.int32)
        counts, sums = np.empty(width // 8, np.uint64), np.empty(width // 2, np.int32)
        self._scratch = counts, counts.view(np.uint16), sums

    def fill(self, camera: int, level_words: npt.NDArray[np.uint64], box: npt.NDArray[np.int64]) -> int:
        """Sum up a camera's levels (H, W / 8) in a box (4,) that holds all they show; return the whole sum."""
        return int(_sum_squares(level_words, box, self.table[camera], self._scratch))


@kernel
def _sum_squares(level_words, box, table, scratch):  # type: ignore[no-untyped-def]
    """Write the summed areas of one silhouette. scratch : counts (W / 8,), of squares their quarters (W / 2,), and sums
    (W / 2,). Returns the last."""
    counts, square_counts, sums = scratch
    left, top, right, bottom = box[0] // 8, box[1], box[2] // 8, box[3]
    width = 4 * (right - left)
    for u in range(width):
        sums[u] = 0
    for u in range(width + 1):
        table[u] = 0
    for row in range((bottom - top + 1) // 2):
        counts[: right - left] = 0
        for v in range(top + 2 * row, min(top + 2 * row + 2, bottom)):
            _count_row(level_words[v, left:right], counts)
        for word in range(right - left):
            counts[word] = (counts[word] & EVEN_BYTES) + (counts[word] >> np.uint64(8) & EVEN_BYTES)
        _sum_row(square_counts, sums, table[(row + 1) * (width + 1) : (row + 2) * (width + 1)])
    return table[(bottom - top + 1) // 2 * (width + 1) + width]


@kernel
def _count_row(level_words, counts):  # type: ignore[no-untyped-def]
    """Add what each pixel of a part of a row counts."""
    for word in range(level_words.size):
        pixels = level_words[word]
        counts[word] += high_bytes(pixels) + nonzero_bytes(pixels & NOT_BLIND)


@kernel
def _sum_row(row, sums, areas):  # type: ignore[no-untyped-def]
    """Add a row of squares to the sums of their columns, and write the summed areas down to it."""
    for u in range(areas.size - 1):
        sums[u] += row[u]
    total = np.int32(0)
    areas[0] = 0
    for u in range(areas.size - 1):
        total += sums[u]
        areas[u + 1] = total
