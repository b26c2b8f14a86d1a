"""Runs of equal bytes to zlib streams and back, in compiled kernels that hold no interpreter lock (numba).

A run is one literal and matches of distance 1, in Huffman codes that are the same for every mask of a depth, so that
none is computed for a frame (RFC 1951, 3.2.7). The checksum of a run has a closed form (RFC 1950). Any inflater reads
these streams; :func:`inflate` reads no others.
"""

from __future__ import annotations

import heapq
from collections.abc import Sequence
from functools import cache
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from capture_rig.kernel import njit

OPTIONS: dict[str, Any] = {"cache": True, "nogil": True}
ZLIB_HEADER = 0x0178  # deflate with a window of 32 KB, fastest; as all of the stream, lowest bits first
ADLER_BASE = 65521
END_OF_BLOCK = 256
SHORTEST, LONGEST = 3, 258  # matches
MOST_CODE_BITS = 12  # so that a table of 4096 entries decodes
CHECKSUM_BYTES = 4
LENGTH_SHIFT = 5  # codes and their lengths are kept in one number
_ORDER_OF_LENGTHS = (16, 17, 18, 0, 8, 7, 9, 6, 10, 5, 11, 4, 12, 3, 13, 2, 14, 1, 15)  # RFC 1951

# Weights of the code, per mille. A byte of a mask has one level, or an outline in it, rarely two. Measured on masks of
# rendered rooms; streams of other masks only get larger.
BACKGROUND_OR_FOREGROUND = 120
ONE_LEVEL, OUTLINE, RARER = {1: 0, 2: 60, 4: 30}, {1: 18, 2: 18, 4: 3}, 12
MATCH, SHORT_MATCH, LONGEST_MATCH = 6, 18, 70

Bits = list[tuple[int, int]]


class RunCode(NamedTuple):
    """Tables of a code for :func:`deflate` and :func:`inflate`; entries are code << LENGTH_SHIFT | bits.

    literal (256,), match (259,) uint64 : of each byte, and of each match of distance 1, all bits of it included. end :
    of the end. symbols (4096,) int64 : symbol << LENGTH_SHIFT | bits that the next bits of a stream mean, -1 nothing.
    start (n,) uint8, start_bits : what every stream begins with.
    """

    literal: npt.NDArray[np.uint64]
    match: npt.NDArray[np.uint64]
    end: np.uint64
    symbols: npt.NDArray[np.int64]
    start: npt.NDArray[np.uint8]
    start_bits: int


@cache
def run_code(depth: int) -> RunCode:
    """Return the code of masks of ``depth`` bits a pixel: 1, 2 or 4."""
    length = _code_lengths(_weights(depth), MOST_CODE_BITS)
    codes = _canonical_codes(length)
    entry = [code << LENGTH_SHIFT | bits for code, bits in codes]
    least, extra = match_lengths()
    match = np.zeros(LONGEST + 1, np.uint64)
    for n in range(SHORTEST, LONGEST + 1):
        kind = int(np.searchsorted(least, n, side="right")) - 1
        code, bits = codes[END_OF_BLOCK + 1 + kind]
        # the one distance that occurs has the code 0, of one bit
        match[n] = (code | (n - int(least[kind])) << bits) << LENGTH_SHIFT | (bits + int(extra[kind]) + 1)
    symbols = np.full(1 << MOST_CODE_BITS, -1)
    for symbol, (code, bits) in enumerate(codes):
        symbols[code :: 1 << bits] = symbol << LENGTH_SHIFT | bits
    start = [(ZLIB_HEADER, 16), *_block_header(length)]
    number, total = 0, 0
    for code, bits in start:
        number |= code << total
        total += bits
    raw = np.frombuffer(number.to_bytes(-(-total // 8), "little"), np.uint8)
    literal = np.array(entry[:END_OF_BLOCK], np.uint64)
    return RunCode(literal, match, np.uint64(entry[END_OF_BLOCK]), symbols, raw, total)


def most_bytes(code: RunCode, raw_bytes: int, runs: int) -> int:
    """Return the largest length of a stream, given its numbers of bytes and runs.

    A run is a literal, its longest matches, a shorter one with up to five extra bits, and up to two literals.
    """
    matches = (MOST_CODE_BITS + 1) * (raw_bytes // LONGEST) + (MOST_CODE_BITS + 5 + 1) * runs
    return (code.start_bits + matches + MOST_CODE_BITS * (3 * runs + 1)) // 8 + 2 + CHECKSUM_BYTES


@njit(**OPTIONS)
def deflate(value, count, code, out):  # type: ignore[no-untyped-def]
    """Write ``count`` (n,) int64 bytes of ``value`` (n,) uint8 each as a zlib stream; return its length.

    code : RunCode. out (most_bytes,) uint8.
    """
    eight, length_mask = np.uint64(8), np.uint64((1 << LENGTH_SHIFT) - 1)
    at, bits = code.start_bits >> 3, np.uint64(code.start_bits & 7)
    out[: len(code.start)] = code.start
    pending = np.uint64(code.start[at]) if bits else np.uint64(0)
    a, b = 1, 0
    for k in range(len(value)):
        v, left = value[k], count[k]
        a, b = _checksum(a, b, np.int64(v), left)
        entry, begun = code.literal[v], False
        while left > 0:
            if begun and left >= SHORTEST:
                length = min(left, LONGEST)
                piece = code.match[length]
                left -= length
            else:
                piece, begun = entry, True
                left -= 1
            pending |= piece >> np.uint64(LENGTH_SHIFT) << bits
            bits += piece & length_mask
            while bits >= eight:
                out[at] = pending & np.uint64(255)
                at += 1
                pending >>= eight
                bits -= eight
    pending |= code.end >> np.uint64(LENGTH_SHIFT) << bits
    left = np.int64(bits + (code.end & length_mask))
    while left > 0:
        out[at] = pending & np.uint64(255)
        at += 1
        pending >>= eight
        left -= 8
    for part in (b >> 8, b & 255, a >> 8, a & 255):
        out[at] = part
        at += 1
    return at


@njit(**OPTIONS)
def inflate(stream, code, least, extra, value, count):  # type: ignore[no-untyped-def]
    """Read a stream of :func:`deflate` (n,) uint8; return its number of runs, -1 if it is damaged or another encoder's.

    code : RunCode that it was written with. least, extra : see :func:`match_lengths`. value (m,) uint8, count (m,)
    int64 : written; -1 as well when there are more runs than m.
    """
    end, whole = len(stream) - CHECKSUM_BYTES, code.start_bits >> 3
    if end <= whole:
        return -1
    for i in range(whole):
        if stream[i] != code.start[i]:
            return -1
    begun = code.start_bits & 7
    if begun and (stream[whole] ^ code.start[whole]) & ((1 << begun) - 1):
        return -1
    runs, bit = 0, code.start_bits
    a, b = 1, 0
    v, c = np.int64(0), np.int64(0)  # the run that goes on
    while True:
        at = bit >> 3
        if at >= end:  # else there are four bytes to read: of a code, extra bits, a distance, and seven before
            return -1
        window = np.int64(stream[at]) | np.int64(stream[at + 1]) << 8
        window |= np.int64(stream[at + 2]) << 16 | np.int64(stream[at + 3]) << 24
        window >>= bit & 7
        found = code.symbols[window & ((1 << MOST_CODE_BITS) - 1)]
        symbol, taken = found >> LENGTH_SHIFT, found & ((1 << LENGTH_SHIFT) - 1)
        if found < 0:
            return -1
        if symbol > END_OF_BLOCK:
            kind = symbol - END_OF_BLOCK - 1
            more = (window >> taken) & ((1 << extra[kind]) - 1)
            taken += extra[kind]
            if c == 0 or (window >> taken) & 1:
                return -1
            c += least[kind] + more
            bit += taken + 1
            continue
        bit += taken
        if symbol == v:
            c += 1
            continue
        if c:
            if runs == len(value):
                return -1
            value[runs], count[runs] = v, c
            runs += 1
            a, b = _checksum(a, b, v, c)
        v, c = symbol, np.int64(1)
        if symbol == END_OF_BLOCK:
            break
    kept = (stream[end] == b >> 8, stream[end + 1] == b & 255, stream[end + 2] == a >> 8, stream[end + 3] == a & 255)
    return runs if (bit + 7) >> 3 == end and kept == (True, True, True, True) else -1


@njit(**OPTIONS)
def _checksum(a, b, value, count):  # type: ignore[no-untyped-def]
    """Return Adler's two sums after ``count`` more bytes of ``value``."""
    if count == 1:  # without divisions
        a += value
        a -= ADLER_BASE if a >= ADLER_BASE else 0
        b += a
        return a, b - (ADLER_BASE if b >= ADLER_BASE else 0)
    c = count % (2 * ADLER_BASE)  # count (count + 1) / 2 is the same for it, modulo the base
    b = (b + c * a + value * (c * (c + 1) // 2 % ADLER_BASE)) % ADLER_BASE
    return (a + c * value) % ADLER_BASE, b


# --- the code


@cache
def match_lengths() -> tuple[npt.NDArray[np.int64], npt.NDArray[np.int64]]:
    """Return the shortest match (29,) of the symbols 257 to 285, and the number of extra bits of its length."""
    extra = np.array([0] * 8 + [k for k in range(1, 6) for _ in range(4)] + [0])
    least = SHORTEST + np.concatenate([[0], np.cumsum(1 << extra[:-1])])
    least[-1] = LONGEST
    return least, extra


def _weights(depth: int) -> list[int]:
    """Return the assumed frequency of each symbol, in any unit."""
    pixels = np.arange(256)[:, None] >> np.arange(8 - depth, -1, -depth) & (1 << depth) - 1
    outlines = (np.diff(pixels, axis=1) != 0).sum(axis=1).tolist()
    weight = [ONE_LEVEL[depth] if n == 0 else max(OUTLINE[depth] // RARER ** (n - 1), 1) for n in outlines]
    weight[0] = weight[255] = BACKGROUND_OR_FOREGROUND
    matches = [SHORT_MATCH] * 4 + [MATCH] * 24 + [LONGEST_MATCH]
    return [*weight, 1, *matches]


def _code_lengths(weights: Sequence[int], most_bits: int) -> list[int]:
    """Return the lengths of Huffman's code, 0 where the weight is 0, none beyond ``most_bits``."""
    least = 1
    while True:
        length = [0] * len(weights)
        heap: list[tuple[int, int, tuple[int, ...]]] = [(max(w, least), i, (i,)) for i, w in enumerate(weights) if w]
        heapq.heapify(heap)
        while len(heap) > 1:
            (w0, i0, some), (w1, _, others) = heapq.heappop(heap), heapq.heappop(heap)
            for symbol in some + others:
                length[symbol] += 1
            heapq.heappush(heap, (w0 + w1, i0, some + others))
        if max(length) <= most_bits:
            return length
        least *= 2


def _canonical_codes(lengths: Sequence[int]) -> Bits:
    """Return each symbol's code as it lies in the stream, first bit lowest, and its length (RFC 1951, 3.2.2)."""
    codes, code, before = {}, 0, 0
    for bits, symbol in sorted((bits, symbol) for symbol, bits in enumerate(lengths) if bits):
        code <<= bits - before
        codes[symbol], before = (int(f"{code:0{bits}b}"[::-1], 2), bits), bits
        code += 1
    return [codes.get(symbol, (0, 0)) for symbol in range(len(lengths))]


def _block_header(lengths: list[int]) -> Bits:
    """Return the head of the last block, with the code's lengths; one distance, whose code has one bit."""
    sent = [*lengths, 1]
    own_lengths = _code_lengths([sent.count(n) for n in range(len(_ORDER_OF_LENGTHS))], 7)
    own = _canonical_codes(own_lengths)
    counts: Bits = [(0b101, 3), (len(lengths) - END_OF_BLOCK - 1, 5), (0, 5), (len(_ORDER_OF_LENGTHS) - 4, 4)]
    return counts + [(own_lengths[n], 3) for n in _ORDER_OF_LENGTHS] + [own[n] for n in sent]
