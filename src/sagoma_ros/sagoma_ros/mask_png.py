"""Masks of two, three or sixteen levels as PNG of one, two or four bits a pixel, a tenth of a general encoder's work.

The files are plain PNG (ISO/IEC 15948): grey, no row filters, deflated run by run (:mod:`.run_deflate`). What else is
there, as in recordings of former versions, is left to OpenCV: see :func:`levels_of_greys`.
"""

from __future__ import annotations

import struct
import zlib
from functools import cache
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from capture_rig.kernel import njit
from capture_rig.mask_levels import BACKGROUND, CANDIDATE_LEVELS, FOREGROUND, LEVELS, SHADOW_CANDIDATE, UNCERTAIN

from .run_deflate import OPTIONS, deflate, inflate, match_lengths, most_bytes, run_code

SIGNATURE = b"\x89PNG\r\n\x1a\n"
MOST_PIXELS = 1 << 26  # no camera has more; an image that claims more is damaged or malicious
DEPTHS = (1, 2, 4)  # bits a pixel
_HEADER = struct.Struct(">IIBBBBB")  # width, height, bit depth, colour type, compression, filter, interlace
_GREY_AS_WE_WRITE_IT = (0, 0, 0, 0)
_WORD_PX = 8  # pixels of one uint64, which become as many bytes as they have bits each
_FULL = np.uint64(0xFFFFFFFFFFFFFFFF)


def encode(mask: npt.NDArray[np.uint8]) -> bytes:
    """Mask (h, w) uint8 of the levels of ``capture_rig.mask_levels``; of any other its two highest bits count.

    One bit a pixel when there are background and foreground only, two with shadow candidates of level 127, four with
    degrees of darkness.
    """
    height, width = mask.shape
    pixels = _whole_words(mask)
    words, used = pixels.view(np.uint64), np.empty((height, 2), np.int64)
    depth, most_runs = find_used(words, pixels, _depth_of_level(), used)
    value, count = np.empty(most_runs, np.uint8), np.empty(most_runs, np.int64)
    row_bytes, code = -(-width * depth // 8), run_code(depth)
    runs = find_byte_runs(pixels.view(np.uint16), used, _packed_pairs(depth), depth, row_bytes, value, count)
    stream = np.empty(most_bytes(code, height * (1 + row_bytes), runs), np.uint8)
    body = stream[: deflate(value[:runs], count[:runs], code, stream)].tobytes()
    header = _HEADER.pack(width, height, depth, *_GREY_AS_WE_WRITE_IT)
    return SIGNATURE + _chunk(b"IHDR", header) + _chunk(b"IDAT", body) + _chunk(b"IEND", b"")


def decode(data: bytes, candidates: int = BACKGROUND) -> npt.NDArray[np.uint8] | None:
    """Mask (h, w) uint8 of 0, 255 and, for shadow candidates, ``candidates``; None for other kinds of PNG, or damage.

    With ``candidates`` SHADOW_CANDIDATE all levels come back as they were sent; otherwise dark pixels are foreground.
    """
    try:
        chunks = _chunks(data)
        width, height, depth, *kind = _HEADER.unpack(chunks[b"IHDR"])
        stream = chunks[b"IDAT"]
    except (KeyError, ValueError, struct.error):
        return None
    if tuple(kind) != _GREY_AS_WE_WRITE_IT or depth not in DEPTHS or not 0 < width * height <= MOST_PIXELS:
        return None
    packed, row_bytes = np.frombuffer(stream, np.uint8), -(-width * depth // 8)
    value, count = np.empty(len(packed), np.uint8), np.empty(len(packed), np.int64)
    runs = inflate(packed, run_code(depth), *match_lengths(), value, count)
    cells = np.empty((height, row_bytes), _cells(depth, candidates).dtype)
    if runs < 0 or not paint_runs(value[:runs], count[:runs], _cells(depth, candidates), cells):
        return None
    return np.ascontiguousarray(cells.view(np.uint8)[:, :width])


@cache
def levels_of_greys(depth: int, candidates: int) -> npt.NDArray[np.uint8]:
    """Return the levels (256,) of the greys that other programs show for a PNG of 1, 2, 4 or 8 bits a pixel."""
    if depth in DEPTHS:
        return _levels(depth, candidates)[np.arange(256) // (255 // ((1 << depth) - 1))]
    levels = np.full(256, FOREGROUND, np.uint8)
    levels[BACKGROUND], levels[SHADOW_CANDIDATE] = BACKGROUND, candidates
    return levels


class Header(NamedTuple):
    """The header of a PNG."""

    width: int
    height: int
    depth: int
    colour_type: int


def read_header(data: bytes) -> Header | None:
    """Return the header; None when it is damaged."""
    start = len(SIGNATURE)
    body = data[start + 8 : start + 8 + _HEADER.size]
    if data[: start + 8] != SIGNATURE + struct.pack(">I4s", _HEADER.size, b"IHDR") or len(body) < _HEADER.size:
        return None
    if data[start + 8 + _HEADER.size : start + 12 + _HEADER.size] != struct.pack(">I", zlib.crc32(b"IHDR" + body)):
        return None
    return Header(*_HEADER.unpack(body)[:4])


def warm_up() -> None:
    """Encode and decode a small mask of each depth, so that the first real one does not wait for the compiler."""
    for level in (FOREGROUND, SHADOW_CANDIDATE, LEVELS[1]):
        mask = np.full((1, 1), level, np.uint8)
        decode(encode(mask), SHADOW_CANDIDATE)


# --- runs of packed bytes, and pixels


@njit(**OPTIONS)
def find_used(words, pixels, depth_of_level, used):  # type: ignore[no-untyped-def]
    """Find which words of each row are not blank; return the depth that all levels need, and a bound of the runs.

    words (h, n) uint64, pixels (h, 8 n) uint8 : the same memory. depth_of_level (256,) : bits a pixel. used (h, 2) :
    written: first word, and the last one's successor; both 0 in a blank row.
    """
    depth, changes = 1, 1
    for y in range(len(words)):
        row, first, end, last = words[y], 0, 0, np.uint64(0)
        for x in range(len(row)):
            word = row[x]
            if word == 0:
                changes += last != word
                last = word
                continue
            if end == 0:
                first = x
            end = x + 1
            if word != _FULL:
                changes += 1 + 4  # bytes of a word, at most
                for k in range(8 * x, 8 * x + 8):
                    depth = max(depth, depth_of_level[pixels[y, k]])
            else:
                changes += last != word
            last = word
        changes += 2
        used[y, 0], used[y, 1] = first, end
    return depth, changes


@njit(**OPTIONS)
def find_byte_runs(pairs, used, packed_pairs, depth, row_bytes, value, count):  # type: ignore[no-untyped-def]
    """Find the runs of equal bytes in the rows of a PNG without row filters; return their number.

    pairs (h, 4 n) uint16 : two pixels each. used (h, 2) : of :func:`find_used`. packed_pairs (65536,) uint8 : the 2
    ``depth`` bits that each pair is sent as. row_bytes : of a packed row. value, count : written.
    """
    packed = np.empty(pairs.shape[1], np.uint8)
    last, v, c = 0, np.uint8(0), 0  # the run that goes on
    for y in range(len(pairs)):
        first, end = used[y, 0] * depth, min(used[y, 1] * depth, row_bytes)
        if end == 0:
            first = end = row_bytes
        _pack(pairs[y], first, end, packed_pairs, depth, packed)
        if v != 0:
            value[last], count[last] = v, c
            last, v, c = last + 1, np.uint8(0), 0
        c += 1 + first  # each row begins with its filter: none
        for x in range(first, end):
            byte = packed[x]
            if byte == v:
                c += 1
            else:
                value[last], count[last] = v, c
                last, v, c = last + 1, byte, 1
        if end == row_bytes:
            continue
        if v != 0:
            value[last], count[last] = v, c
            last, v, c = last + 1, np.uint8(0), 0
        c += row_bytes - end
    value[last], count[last] = v, c
    return last + 1


@njit(**OPTIONS)
def _pack(pairs, first, end, packed_pairs, depth, packed):  # type: ignore[no-untyped-def]
    """Write the bytes ``first`` to ``end`` of one row."""
    if depth == 4:
        for x in range(first, end):
            packed[x] = packed_pairs[pairs[x]]
    elif depth == 2:
        for x in range(first, end):
            packed[x] = packed_pairs[pairs[2 * x]] << 4 | packed_pairs[pairs[2 * x + 1]]
    else:
        for x in range(first, end):
            high = packed_pairs[pairs[4 * x]] << 6 | packed_pairs[pairs[4 * x + 1]] << 4
            packed[x] = high | packed_pairs[pairs[4 * x + 2]] << 2 | packed_pairs[pairs[4 * x + 3]]


@njit(**OPTIONS)
def paint_runs(value, count, cells_of_byte, cells):  # type: ignore[no-untyped-def]
    """Write the pixels of runs of packed bytes; return False unless they are exactly the rows, without filters.

    cells_of_byte (256,) : the pixels of each byte, as one number. cells (h, row_bytes) of the same type : written.
    """
    height, row_bytes = cells.shape
    y, x = 0, -1  # -1: the row's filter
    for k in range(len(value)):
        left, cell = count[k], cells_of_byte[value[k]]
        while left > 0:
            if y == height:
                return False
            if x < 0:
                if value[k] != 0:
                    return False
                x, left = 0, left - 1
                continue
            end = min(x + left, row_bytes)
            cells[y, x:end] = cell
            left -= end - x
            x = end
            if x == row_bytes:
                y, x = y + 1, -1
    return y == height and x < 0


# --- tables of levels


@cache
def _depth_of_level() -> npt.NDArray[np.int64]:
    """Return the bits a pixel (256,) that each level needs."""
    depth = np.ones(256, np.int64)
    depth[64:128] = 2
    depth[sorted(set(LEVELS) - {BACKGROUND, SHADOW_CANDIDATE, FOREGROUND})] = 4
    return depth


@cache
def _packed_pairs(depth: int) -> npt.NDArray[np.uint8]:
    """Return the bits (65536,) that each two levels are sent as; see :func:`encode` for foreign levels."""
    of_two_bits = {1: [0, 0, 1, 1], 2: [0, 1, 3, 3], 4: [0, LEVELS.index(SHADOW_CANDIDATE), 15, 15]}
    places = np.repeat(np.array(of_two_bits[depth], np.uint8), 64)
    if depth == 4:
        places[list(LEVELS)] = range(len(LEVELS))
    pair = np.arange(1 << 16, dtype=np.uint16).view(np.uint8).reshape(-1, 2)
    return np.asarray(places[pair[:, 0]] << depth | places[pair[:, 1]], np.uint8)


def _levels(depth: int, candidates: int) -> npt.NDArray[np.uint8]:
    """Return the level of each value of a pixel."""
    if depth < 4:
        return np.array({1: [0, FOREGROUND], 2: [0, candidates, FOREGROUND, FOREGROUND]}[depth], np.uint8)
    levels = np.array(LEVELS, np.uint8)
    if candidates != SHADOW_CANDIDATE:
        levels[np.isin(levels, CANDIDATE_LEVELS)] = candidates
        levels[levels == UNCERTAIN] = BACKGROUND
        levels[levels > SHADOW_CANDIDATE] = FOREGROUND
    return levels


@cache
def _cells(depth: int, candidates: int) -> npt.NDArray[np.unsignedinteger]:
    """Return the pixels (256,) of each byte of a depth, 8, 4 or 2 levels as one number."""
    places = np.arange(256)[:, None] >> np.arange(8 - depth, -1, -depth) & (1 << depth) - 1
    pixels = np.ascontiguousarray(_levels(depth, candidates)[places])
    return pixels.view({1: np.uint64, 2: np.uint32, 4: np.uint16}[depth]).reshape(256)


# --- files


def _whole_words(mask: npt.NDArray[np.uint8]) -> npt.NDArray[np.uint8]:
    """Return a mask as wide as whole words, blank beyond its own width; the kernels are compiled for one layout."""
    missing = -mask.shape[1] % _WORD_PX
    if missing:
        padded = np.zeros((mask.shape[0], mask.shape[1] + missing), np.uint8)
        padded[:, : mask.shape[1]] = mask
        return padded
    mask = np.require(mask, np.uint8, ["C", "W"])
    return mask if mask.ctypes.data % _WORD_PX == 0 else mask.copy()


def _chunk(kind: bytes, data: bytes) -> bytes:
    return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))


def _chunks(data: bytes) -> dict[bytes, bytes]:
    """Return the chunks by kind, those of one kind joined. Raises ValueError for a damaged or truncated image."""
    if not data.startswith(SIGNATURE):
        raise ValueError("no PNG")
    chunks: dict[bytes, bytes] = {}
    place, kind = len(SIGNATURE), b""
    while kind != b"IEND":
        length, kind = struct.unpack_from(">I4s", data, place)
        body = data[place + 8 : place + 8 + length]
        if struct.unpack_from(">I", data, place + 8 + length)[0] != zlib.crc32(kind + body):
            raise ValueError("a chunk is damaged")
        chunks[kind] = chunks.get(kind, b"") + body
        place += 12 + length
    return chunks
