"""Masks of two, three or sixteen levels as PNG of one, two or four bits a pixel, faster than a general encoder.

The files are plain PNG (ISO/IEC 15948): grey, no row filters, run-length deflate. Whatever other program wrote a mask
is left to OpenCV: :func:`decode` knows only its own kind.
"""

from __future__ import annotations

import struct
import zlib
from functools import cache

import cv2
import numpy as np

from capture_rig.mask_levels import BACKGROUND, CANDIDATE_LEVELS, FOREGROUND, LEVELS, SHADOW_CANDIDATE

SIGNATURE = b"\x89PNG\r\n\x1a\n"
_HEADER = struct.Struct(">IIBBBBB")  # width, height, bit depth, colour type, compression, filter, interlace
_GREY_AS_WE_WRITE_IT = (0, 0, 0, 0)
_PIXELS = 4  # of two bits in a byte, the first one highest; unpacked, they are the bytes of one uint32
_TWO_HIGHEST_BITS = np.uint32(0xC0C0C0C0)  # of each of those bytes: 00 background, 01 candidate, 11 foreground
_GATHER = np.uint32(1 << 24 | 1 << 14 | 1 << 4)  # brings those of the first three bytes together in the highest one
_ONES = np.uint32(0x01010101)
_NEEDS_FOUR_BITS = np.isin(np.arange(256), sorted(set(LEVELS) - {BACKGROUND, SHADOW_CANDIDATE, FOREGROUND})).view(
    np.uint8
)


def encode(mask: np.ndarray) -> bytes:
    """Mask (h, w) uint8 of the levels of ``capture_rig.mask_levels``; of any other its two highest bits count.

    One bit a pixel when there are background and foreground only, two with shadow candidates of level 127, four with
    degrees of darkness.
    """
    left, top, width, height = cv2.boundingRect(mask) if mask.size else (0, 0, 0, 0)
    left, right = left & ~7, left + width  # whole bytes of any depth
    used = mask[top : top + height, left:right]  # a person fills a part of the image
    if used.size == 0:
        return _png(mask.shape, 1, np.zeros((0, 0), np.uint8), 0, 0)
    if cv2.countNonZero(cv2.LUT(used, _NEEDS_FOUR_BITS)):
        return _png(mask.shape, 4, _four_bits(used), top, left)
    packed = _two_bits(used)
    if not (packed & 0x55 & ~(packed >> 1)).any():
        return _png(mask.shape, 1, np.packbits(used, axis=1), top, left)
    return _png(mask.shape, 2, packed, top, left)


def decode(data: bytes, candidates: int = BACKGROUND) -> np.ndarray | None:
    """Mask (h, w) uint8 of 0, 255 and, for shadow candidates, ``candidates``; None unless :func:`encode` wrote it.

    With ``candidates`` SHADOW_CANDIDATE all levels come back as they were sent; otherwise dark pixels are foreground.
    """
    try:
        chunks = _chunks(data)
        width, height, depth, *kind = _HEADER.unpack(chunks[b"IHDR"])
        row_bytes = -(-width * depth // 8)
        size = height * (1 + row_bytes)
        unpacker = zlib.decompressobj()
        rows = np.frombuffer(unpacker.decompress(chunks[b"IDAT"], size), np.uint8)
        sound = unpacker.eof and tuple(kind) == _GREY_AS_WE_WRITE_IT and depth in (1, 2, 4) and rows.size == size
    except (KeyError, ValueError, struct.error, zlib.error):
        return None
    if not sound or (rows := rows.reshape(height, 1 + row_bytes))[:, 0].any():
        return None
    if depth == 1:
        bits = np.unpackbits(rows[:, 1:], axis=1, count=width)
        return np.negative(bits, out=bits)  # 0 - 1 is 255
    levels = _unpacked(rows[:, 1:], candidates) if depth == 2 else _halves(rows[:, 1:], candidates)
    return np.ascontiguousarray(levels[:, :width])


def _four_bits(mask: np.ndarray) -> np.ndarray:
    """Return (h, ceil(w / 2)) uint8: the places of each pixel's level among the sixteen."""
    padded = np.pad(mask, ((0, 0), (0, 1))) if mask.shape[1] % 2 else np.ascontiguousarray(mask)
    two = cv2.LUT(padded, _places()).view("<u2")
    return (two << np.uint16(4) | two >> np.uint16(8)).astype(np.uint8)


@cache
def _places() -> np.ndarray:
    """The place (256,) of each level among the sixteen; a level that is none of them counts by its two highest bits."""
    places = np.repeat(np.array([0, 5, 15, 15], np.uint8), 64)
    places[list(LEVELS)] = range(len(LEVELS))
    return places


def _halves(packed: np.ndarray, candidates: int) -> np.ndarray:
    """Return the levels (h, 2 n) of n bytes a row."""
    first, second = _levels_of_byte(candidates)
    packed = np.ascontiguousarray(packed)
    return cv2.merge([cv2.LUT(packed, first), cv2.LUT(packed, second)]).reshape(len(packed), -1)


@cache
def _levels_of_byte(candidates: int) -> tuple[np.ndarray, np.ndarray]:
    """Return the two levels, (256,) uint8 each, that a byte of four-bit pixels stands for."""
    levels = np.array(LEVELS, np.uint8)
    if candidates != SHADOW_CANDIDATE:
        levels[np.isin(levels, CANDIDATE_LEVELS)] = candidates
        levels[levels > SHADOW_CANDIDATE] = FOREGROUND
    byte = np.arange(256)
    return levels[byte >> 4], levels[byte & 15]


def _two_bits(mask: np.ndarray) -> np.ndarray:
    """Return (h, ceil(w / 4)) uint8: the two highest bits of each pixel."""
    missing = -mask.shape[1] % _PIXELS
    padded = np.pad(mask, ((0, 0), (0, missing))) if missing else np.ascontiguousarray(mask)
    four = padded.view("<u4") & _TWO_HIGHEST_BITS
    gathered = four * _GATHER
    four >>= np.uint32(6)
    gathered |= four
    gathered >>= np.uint32(24)
    return gathered.astype(np.uint8)


def _unpacked(packed: np.ndarray, candidates: int) -> np.ndarray:
    """Return the levels (h, 4 n) of n bytes a row."""
    four = packed.astype("<u4")
    high = four >> np.uint32(7) | four << np.uint32(3) | four << np.uint32(13) | four << np.uint32(23)
    high &= _ONES
    levels = high * np.uint32(FOREGROUND)
    if candidates != BACKGROUND:
        low = four >> np.uint32(6) | four << np.uint32(4) | four << np.uint32(14) | four << np.uint32(24)
        low &= _ONES & ~high
        levels |= low * np.uint32(candidates)
    return levels.view(np.uint8)


def _png(shape: tuple[int, ...], depth: int, packed: np.ndarray, top: int, left: int) -> bytes:
    """``packed`` are the pixels from row ``top`` and column ``left`` on; all others are background."""
    height, width = shape
    rows = np.zeros((height, 1 + -(-width * depth // 8)), np.uint8)  # each row begins with its filter: none
    first = 1 + left * depth // 8
    rows[top : top + packed.shape[0], first : first + packed.shape[1]] = packed
    packer = zlib.compressobj(2, zlib.DEFLATED, 15, 9, zlib.Z_RLE)
    body = packer.compress(rows.data) + packer.flush()
    header = _HEADER.pack(width, height, depth, *_GREY_AS_WE_WRITE_IT)
    return SIGNATURE + _chunk(b"IHDR", header) + _chunk(b"IDAT", body) + _chunk(b"IEND", b"")


def _chunk(kind: bytes, data: bytes) -> bytes:
    return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))


def _chunks(data: bytes) -> dict[bytes, bytes]:
    """Chunks by kind, those of one kind joined. Raises ValueError for what is damaged or cut off."""
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
