"""Rows of voxels as bits: packing bricks into rows of 64-bit words, and the word tricks that read them."""

from __future__ import annotations

from typing import Any

import numpy as np
from llvmlite import ir
from numba import njit, types
from numba.extending import intrinsic

_U1 = np.uint64(1)


@intrinsic
def _count_ones(_typing_context: Any, word: types.Integer) -> Any:
    def generate(_context: Any, builder: Any, _signature: Any, args: Any) -> Any:
        return builder.ctpop(args[0])

    return types.int64(types.uint64), generate


@intrinsic
def _count_trailing_zeros(_typing_context: Any, word: types.Integer) -> Any:
    def generate(_context: Any, builder: Any, _signature: Any, args: Any) -> Any:
        return builder.cttz(args[0], ir.Constant(ir.IntType(1), 0))

    return types.int64(types.uint64), generate


@njit(cache=True, nogil=True)
def popcount(word):  # type: ignore[no-untyped-def]
    """Number of set bits."""
    return _count_ones(word)  # type: ignore[call-arg]


@njit(cache=True, nogil=True)
def lowest_bit(word):  # type: ignore[no-untyped-def]
    """Position of the lowest set bit of a word; 64 for zero."""
    return _count_trailing_zeros(word)  # type: ignore[call-arg]


@njit(cache=True, nogil=True)
def select_bit(word, rank):  # type: ignore[no-untyped-def]
    """Position of the set bit that ``rank`` others lie below."""
    position = 0
    for half in (32, 16, 8):
        below = popcount(word & ((_U1 << np.uint64(half)) - _U1))
        if rank >= below:
            rank, position, word = rank - below, position + half, word >> np.uint64(half)
    for _ in range(rank):
        word &= word - _U1
    return position + lowest_bit(word)


@njit(cache=True, nogil=True)
def transpose8(word):  # type: ignore[no-untyped-def]
    """The 8 x 8 bit matrix of a word, transposed (Warren, Hacker's Delight, 7-3)."""
    swap = (word ^ word >> np.uint64(7)) & np.uint64(0x00AA00AA00AA00AA)
    word ^= swap ^ swap << np.uint64(7)
    swap = (word ^ word >> np.uint64(14)) & np.uint64(0x0000CCCC0000CCCC)
    word ^= swap ^ swap << np.uint64(14)
    swap = (word ^ word >> np.uint64(28)) & np.uint64(0x00000000F0F0F0F0)
    return word ^ swap ^ swap << np.uint64(28)


@njit(cache=True, nogil=True)
def brick_box(index, bricks_x, bricks_y):  # type: ignore[no-untyped-def]
    """The box of bricks that holds all of them: low x, y, z and high x, y, z (exclusive); zeros for none."""
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
    """The voxels in a box of bricks as bits: rows along x (z, y, words) and rows along y (z, x, words).

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


@njit(cache=True, nogil=True)
def erode(words, across_layers):  # type: ignore[no-untyped-def]
    """Rows (layers, rows, words) without the voxels that have an empty neighbour, of four, in their slice.

    The slice holds the neighbouring row of the same layer, or with ``across_layers`` the same row of the next layer.
    Beyond the box is empty.
    """
    eroded = np.zeros_like(words)
    layers, rows, width = words.shape
    layer_step, row_step = (1, 0) if across_layers else (0, 1)
    for s in range(layer_step, layers - layer_step):
        for r in range(row_step, rows - row_step):
            for w in range(width):
                if words[s, r, w] != 0:
                    before, after = words[s - layer_step, r - row_step, w], words[s + layer_step, r + row_step, w]
                    eroded[s, r, w] = sides(words, s, r, w) & before & after
    return eroded


@njit(cache=True, nogil=True, inline="always")
def sides(words, s, r, w):  # type: ignore[no-untyped-def]
    """The voxels of a word whose neighbours along the row are both occupied."""
    word = words[s, r, w]
    before = words[s, r, w - 1] >> np.uint64(63) if w > 0 else np.uint64(0)
    after = words[s, r, w + 1] << np.uint64(63) if w + 1 < words.shape[2] else np.uint64(0)
    return word & (word << _U1 | before) & (word >> _U1 | after)
