"""Operations on 64-bit words, compiled."""

from __future__ import annotations

from typing import Any

import numpy as np
from llvmlite import ir
from numba import types
from numba.extending import intrinsic

from capture_rig.kernel import kernel, njit

_U1 = np.uint64(1)
HIGH_BITS = np.uint64(0x8080808080808080)  # of every byte: set in levels that are foreground, above 127
FIRST_BITS = np.uint64(0x0101010101010101)  # of every byte
LOW_BITS = np.uint64(0x7F7F7F7F7F7F7F7F)  # all others


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
    """Return the number of set bits."""
    return _count_ones(word)  # type: ignore[call-arg]


@njit(cache=True, nogil=True)
def lowest_bit(word):  # type: ignore[no-untyped-def]
    """Return the position of the lowest set bit of a word; 64 for zero."""
    return _count_trailing_zeros(word)  # type: ignore[call-arg]


@njit(cache=True, nogil=True)
def select_bit(word, rank):  # type: ignore[no-untyped-def]
    """Return the position of the set bit with ``rank`` set bits below it."""
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
    """Transpose the 8 x 8 bit matrix of a word (Warren, Hacker's Delight, 7-3)."""
    swap = (word ^ word >> np.uint64(7)) & np.uint64(0x00AA00AA00AA00AA)
    word ^= swap ^ swap << np.uint64(7)
    swap = (word ^ word >> np.uint64(14)) & np.uint64(0x0000CCCC0000CCCC)
    word ^= swap ^ swap << np.uint64(14)
    swap = (word ^ word >> np.uint64(28)) & np.uint64(0x00000000F0F0F0F0)
    return word ^ swap ^ swap << np.uint64(28)


@kernel
def nonzero_bytes(word):  # type: ignore[no-untyped-def]
    """Return a word with 1 in every byte of ``word`` that is not zero."""
    return ((word & LOW_BITS) + LOW_BITS | word) >> np.uint64(7) & FIRST_BITS


@kernel
def high_bytes(word):  # type: ignore[no-untyped-def]
    """Return a word with 1 in every byte of ``word`` that is above 127: foreground, as ``capture_rig.mask_levels``."""
    return word >> np.uint64(7) & FIRST_BITS


@kernel
def nonzero_span(row):  # type: ignore[no-untyped-def]
    """Return the first word of (n,) that is not zero, and the one after the last such; 0, 0 where all are zero."""
    filled = np.uint64(0)
    for word in row:
        filled |= word
    if filled == 0:
        return 0, 0
    first, last = 0, row.size
    while row[first] == 0:
        first += 1
    while row[last - 1] == 0:
        last -= 1
    return first, last


@kernel
def fill_bits(row, start, end):  # type: ignore[no-untyped-def]
    """Set the bits of a row of words (n,) from ``start`` up to but not including ``end``, which is larger."""
    for word in range(start >> 6, ((end - 1) >> 6) + 1):
        low, high = max(start - 64 * word, 0), min(end - 64 * word, 64)
        ones = ~np.uint64(0) >> np.uint64(64 - (high - low))
        row[word] |= ones << np.uint64(low)
