"""Rows of voxels as bits: packing bricks into rows of 64-bit words, and the word tricks that read them."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
from numba import njit

from .bricks import BrickVolume

Words = npt.NDArray[np.uint64]

ROW_AXES = {0: (1, 2), 1: (0, 2), 2: (0, 1)}  # slice axis: (axis along a row's bits, axis across the rows)

# de Bruijn sequence: the product with an isolated bit has a different upper 6 bits for each position
_DE_BRUIJN = np.uint64(0x03F79D71B4CB0A89)
_POSITION = np.zeros(64, np.int64)
_POSITION[[int(_DE_BRUIJN) * (1 << n) % (1 << 64) >> 58 for n in range(64)]] = np.arange(64)
_U1 = np.uint64(1)


def pack_rows(volume: BrickVolume, axis: int) -> tuple[Words, tuple[int, int, int]]:
    """The hull's bounding box as (slices, rows, words) of bits, for slices across ``axis``, and its low voxel.

    Bit b of word w is voxel 64 w + b along the row. The box consists of whole bricks.
    """
    corners = volume.brick_corners() // 8
    low, high = corners.min(axis=0), corners.max(axis=0) + 1
    along, across = ROW_AXES[axis]
    size = 8 * (high - low)
    words = np.zeros((size[axis], size[across], -(-size[along] // 64)), np.uint64)
    _scatter(corners - low, volume.leaves, axis, words)
    return words, (int(8 * low[0]), int(8 * low[1]), int(8 * low[2]))


@njit(cache=True, nogil=True)
def _scatter(corners, leaves, axis, words):  # type: ignore[no-untyped-def]
    for brick in range(leaves.shape[0]):
        bx, by, bz = corners[brick, 0], corners[brick, 1], corners[brick, 2]
        along = by if axis == 0 else bx
        shift = np.uint64(along % 8 * 8)
        for z in range(8):
            layer = leaves[brick, z]
            if axis == 0:
                layer = transpose8(layer)
            for row in range(8):
                byte = (layer >> np.uint64(8 * row) & np.uint64(255)) << shift
                if axis == 0:
                    words[8 * bx + row, 8 * bz + z, along // 8] |= byte
                elif axis == 1:
                    words[8 * by + row, 8 * bz + z, along // 8] |= byte
                else:
                    words[8 * bz + z, 8 * by + row, along // 8] |= byte


@njit(cache=True, nogil=True)
def erode(words):  # type: ignore[no-untyped-def]
    """Each slice without the voxels that have an empty neighbour (of four) in it; beyond the box is empty."""
    eroded = np.empty_like(words)
    slices, rows, width = words.shape
    for s in range(slices):
        for r in range(rows):
            for w in range(width):
                word = sides(words, s, r, w)
                above = words[s, r - 1, w] if r > 0 else np.uint64(0)
                below = words[s, r + 1, w] if r + 1 < rows else np.uint64(0)
                eroded[s, r, w] = word & above & below
    return eroded


@njit(cache=True, nogil=True)
def sides(words, s, r, w):  # type: ignore[no-untyped-def]
    """The voxels of a word whose neighbours along the row are both occupied."""
    word = words[s, r, w]
    before = words[s, r, w - 1] >> np.uint64(63) if w > 0 else np.uint64(0)
    after = words[s, r, w + 1] << np.uint64(63) if w + 1 < words.shape[2] else np.uint64(0)
    return word & (word << _U1 | before) & (word >> _U1 | after)


@njit(cache=True, nogil=True)
def popcount(word):  # type: ignore[no-untyped-def]
    """Number of set bits (Warren, Hacker's Delight, 5-1)."""
    word -= word >> _U1 & np.uint64(0x5555555555555555)
    word = (word & np.uint64(0x3333333333333333)) + (word >> np.uint64(2) & np.uint64(0x3333333333333333))
    word = word + (word >> np.uint64(4)) & np.uint64(0x0F0F0F0F0F0F0F0F)
    return np.int64(word * np.uint64(0x0101010101010101) >> np.uint64(56))


@njit(cache=True, nogil=True)
def lowest_bit(word):  # type: ignore[no-untyped-def]
    """Position of the lowest set bit of a nonzero word."""
    isolated = word & (~word + _U1)
    return _POSITION[isolated * _DE_BRUIJN >> np.uint64(58)]


@njit(cache=True, nogil=True)
def transpose8(word):  # type: ignore[no-untyped-def]
    """The 8 x 8 bit matrix of a word, transposed (Warren, Hacker's Delight, 7-3)."""
    swap = (word ^ word >> np.uint64(7)) & np.uint64(0x00AA00AA00AA00AA)
    word ^= swap ^ swap << np.uint64(7)
    swap = (word ^ word >> np.uint64(14)) & np.uint64(0x0000CCCC0000CCCC)
    word ^= swap ^ swap << np.uint64(14)
    swap = (word ^ word >> np.uint64(28)) & np.uint64(0x00000000F0F0F0F0)
    return word ^ swap ^ swap << np.uint64(28)
