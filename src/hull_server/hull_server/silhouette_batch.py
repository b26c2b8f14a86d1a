"""The silhouettes of one frame set in one array, of which only the part that has or had foreground is rewritten.

A person covers a twentieth of a picture. So each mask is read once, eight pixels at a time, to find the box of all that
is not background; later stages stay inside that box.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from capture_rig.kernel import kernel

from .bitset import high_bytes, nonzero_bytes, nonzero_span
from .views import Box

BLIND = 1  # level of pixels that the camera does not see; no camera client sends it
NOT_BLIND = np.uint64(0xFEFEFEFEFEFEFEFE)  # bits that 0, BLIND and, turned over, FOREGROUND do not have
EVEN_BYTES = np.uint64(0x00FF00FF00FF00FF)


class SilhouetteBatch:
    """Levels of all cameras of a rig, for one frame set after another. One thread at a time.

    seen (N, H, W) : nonzero where a camera sees. levels (N, H, W) uint8: of ``capture_rig.mask_levels``; BLIND where a
    camera is absent or does not see. flat (N, H * W) : the same, and behind it BLIND for all that is ``outside``.
    words (N, H, W / 8) uint64: the same, eight pixels to a word. box (N, 4) : left, top, right, bottom of all that is
    not background.
    """

    def __init__(self, seen: npt.NDArray[np.uint8], outside: int = 0) -> None:
        """``outside`` : how many pixels to append, a multiple of eight."""
        cameras, height, width = seen.shape
        self.flat = np.full((cameras, height * width + outside), BLIND, np.uint8)
        self.levels = self.flat[:, : height * width].reshape(seen.shape)
        self.words = self.flat.view(np.uint64)[:, : height * width // 8].reshape(cameras, height, width // 8)
        self.box = np.zeros((cameras, 4), np.int64)
        self._blind = np.where(seen > 0, np.uint8(0), np.uint8(BLIND)).view(np.uint64)
        self._absent = np.ones(cameras, bool)

    def load(self, camera: int, mask: npt.NDArray[np.uint8] | None, within: Box | None = None) -> bool:
        """Load the mask (h, w) of a camera's canvas, None of an absent one; return whether it has uncertain levels.

        within : left, top, right, bottom of a box of all that is not background, if known; the rest is not read.
        """
        if mask is None or self._absent[camera]:
            self.words[camera], self.box[camera] = self._blind[camera], 0
            self._absent[camera] = mask is None
        if mask is None:
            self.levels[camera] = BLIND
            return False
        words = np.ascontiguousarray(mask).view(np.uint64)
        part = _nonzero_bounds(words) if within is None else (within[0] // 8, within[1], -(-within[2] // 8), within[3])
        return bool(_load(words, part, self._blind[camera], self.words[camera], self.box[camera]))


@kernel
def _load(mask_words, part, blind_words, level_words, box):  # type: ignore[no-untyped-def]
    """Write the levels of the ``part`` (left, top, right, bottom, in words and rows) of a mask, and its box (4,).

    The words are pixels, eight to a word. ``box`` holds that of the mask before, whose levels are erased.
    Returns whether any pixel is neither background, nor blind, nor certainly foreground.
    """
    for v in range(box[1], box[3]):
        first, last = box[0] // 8, box[2] // 8
        _copy(blind_words[v, first:last], level_words[v, first:last])
    left, top, right, bottom = part
    box[0], box[1], box[2], box[3] = 8 * left, top, 8 * right, bottom
    graded = np.uint64(0)
    for v in range(top, bottom):
        graded |= _write_row(mask_words[v, left:right], blind_words[v, left:right], level_words[v, left:right])
    return graded & NOT_BLIND != 0


@kernel
def _copy(source, target):  # type: ignore[no-untyped-def]
    for word in range(source.size):
        target[word] = source[word]


@kernel
def _write_row(mask_words, blind_words, level_words):  # type: ignore[no-untyped-def]
    """Write the levels of a part of a row; return the bits of its pixels' distances from 0 or FOREGROUND."""
    graded = np.uint64(0)
    for word in range(mask_words.size):
        blind = blind_words[word]
        pixels = mask_words[word] & ~((blind << np.uint64(8)) - blind) | blind
        level_words[word] = pixels
        high = high_bytes(pixels)
        graded |= pixels ^ ((high << np.uint64(8)) - high)  # 255 in every byte that is above SHADOW_CANDIDATE
    return graded


@kernel
def _nonzero_bounds(words):  # type: ignore[no-untyped-def]
    """Bound all that is nonzero in (h, words): left, top, right, bottom, in words and rows; zeros where nothing is."""
    left, top, right, bottom = words.shape[1], words.shape[0], 0, 0
    for v in range(words.shape[0]):
        first, last = nonzero_span(words[v])
        if last:
            top, bottom = min(top, v), v + 1
            left, right = min(left, first), max(right, last)
    return (left, top, right, bottom) if bottom else (0, 0, 0, 0)


# --- summed areas


class SummedSquares:
    """The summed areas of the last silhouette of each camera, inside its box.

    table (N, (H / 2 + 2) * (W / 2 + 1)) : in squares of 2 x 2 pixels, 2 for each foreground pixel and 1 for each
    uncertain one (:data:`.carving.pixel_boxes.ALL_SURE`); from the box's corner, row after row without gaps, which
    touches a fraction of the memory pages of a canvas.
    """

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
    """Add the counts of the pixels of a part of a row."""
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
