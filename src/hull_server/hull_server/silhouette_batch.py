"""The silhouettes of one frame set in one array, of which only the part that has or had foreground is written anew.

A person takes a twentieth of a picture. So each mask is read once, eight pixels at a time, to find the box of its
foreground; whatever follows (levels, binary masks, the places of pixels that may be shadow) stays inside that box.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from capture_rig.kernel import kernel
from capture_rig.mask_levels import ATTENUATED_LEVELS, CANDIDATE_LEVELS, FOREGROUND, SHADOW_CANDIDATE, UNCERTAIN

from .bitset import HIGH_BITS, high_bytes, nonzero_bytes, nonzero_span
from .views import Box, Masks, RigViews

BLIND = 1  # level of pixels that the camera does not see; no camera client sends it
DARKEST, LIGHTEST = CANDIDATE_LEVELS[0], ATTENUATED_LEVELS[-1]  # levels from and to of pixels that may be shadow

FIRST_BITS = np.uint64(0x0101010101010101)  # of every byte of a word
ALL_UNCERTAIN = FIRST_BITS * np.uint64(UNCERTAIN)  # a word of it
NEITHER_SURE_NOR_BLIND = np.uint64(0xFEFEFEFEFEFEFEFE)  # bits that 0, BLIND and, turned over, FOREGROUND do not have

ANYWHERE = (-(1 << 30), -(1 << 30), 1 << 30, 1 << 30)  # a box

Mask = npt.NDArray[np.uint8]


class SilhouetteBatch:
    """Levels of all cameras of a rig, for one frame set after another. One thread at a time.

    levels (N, H, W) uint8: of ``capture_rig.mask_levels``; BLIND where a camera is absent or does not see.
    """

    def __init__(self, views: RigViews) -> None:
        self._views = views
        self._blind = np.where(views.seen > 0, np.uint8(0), np.uint8(BLIND))
        self.levels = np.full_like(views.seen, BLIND)
        words = self._words = self.levels.view(np.uint64)
        blind_words = self._blind.view(np.uint64)
        n = len(views.names)
        self._absent = np.ones(n, bool)
        self._shown, self._doubtful = np.zeros((n, 4), np.int64), np.zeros((n, 4), np.int64)
        self._of_camera = [
            (blind_words[c], words[c], self.levels[c], self._shown[c], self._doubtful[c]) for c in range(n)
        ]

    def take(self, masks: Masks) -> dict[str, Box]:
        """Take the masks (h, w) of one frame set; return the box of the pixels that may be shadow, where there are any.

        By camera, in name order: left, top, right, bottom (exclusive). The masks must be those of the rig's canvases.
        """
        boxes = {}
        for camera, name in enumerate(self._views.names):
            if name in masks:
                if self._absent[camera]:
                    self.levels[camera], self._shown[camera], self._absent[camera] = self._blind[camera], 0, False
                if _take(np.ascontiguousarray(masks[name]).view(np.uint64), *self._of_camera[camera]):
                    left, top, right, bottom = self._doubtful[camera].tolist()
                    boxes[name] = left, top, right, bottom
            elif not self._absent[camera]:
                self.levels[camera], self._absent[camera] = BLIND, True
        return boxes

    def shown(self, name: str) -> Box:
        """Return a box that holds all foreground of a mask that was taken with the last set."""
        left, top, right, bottom = self._shown[self._views.number[name]].tolist()
        return left, top, right, bottom

    def binary(self, name: str, mask: Mask) -> Mask:
        """Return :func:`binary_mask` of a mask that was taken with the last set."""
        camera, binary = self._views.number[name], np.zeros_like(mask)
        _threshold(self._words[camera], self._shown[camera], binary.view(np.uint64))
        return binary

    def write_body_boxes(self, boxes: npt.NDArray[np.int64]) -> None:
        """Write a box that holds each camera's pixels that may be the person to ``boxes`` (N, 4); an absent camera's is
        boundless."""
        for camera, absent in enumerate(self._absent):
            if absent:
                boxes[camera] = ANYWHERE
            else:
                _bound_body(self._words[camera], self._shown[camera], boxes[camera])


def binary_mask(mask: Mask) -> Mask:
    """Make a mask of 0, UNCERTAIN and 255 as a camera alone would: candidates are background, attenuated pixels the
    person."""
    sure = np.where(mask > SHADOW_CANDIDATE, np.uint8(FOREGROUND), np.uint8(0))
    return np.where(mask == UNCERTAIN, np.uint8(UNCERTAIN), sure)


@kernel
def _take(mask_words, blind_words, level_words, levels, shown, doubtful):  # type: ignore[no-untyped-def]
    """Write the levels of one mask (h, w / 8), and the boxes (4,) of what it shows and of what may be shadow.

    The words are pixels, eight to a word; levels (H, W) are the same as level_words. ``shown`` comes with the box of
    the mask before, whose levels are forgotten. Returns whether any pixel may be shadow.
    """
    left, top, right, bottom = nonzero_bounds(mask_words)
    for v in range(shown[1], shown[3]):
        first, last = shown[0] // 8, shown[2] // 8
        _copy(blind_words[v, first:last], level_words[v, first:last])
    shown[0], shown[1], shown[2], shown[3] = 8 * left, top, 8 * right, bottom
    first, last, above, below = levels.shape[1], 0, levels.shape[0], 0
    for v in range(top, bottom):
        graded = _write_row(mask_words[v, left:right], blind_words[v, left:right], level_words[v, left:right])
        if graded & NEITHER_SURE_NOR_BLIND:
            row, row_words = levels[v, 8 * left : 8 * right], level_words[v, left:right]
            first_here, last_here = _doubtful_part(row, row_words)
            if last_here > 0:
                first, last = min(first, 8 * left + first_here), max(last, 8 * left + last_here)
                above, below = min(above, v), v + 1
    doubtful[0], doubtful[1], doubtful[2], doubtful[3] = first, above, last, below
    return below > 0


@kernel
def _copy(source, target):  # type: ignore[no-untyped-def]
    for word in range(source.size):
        target[word] = source[word]


@kernel
def _write_row(mask_words, blind_words, level_words):  # type: ignore[no-untyped-def]
    """Write the levels of a part of a row; return the bits of its pixels' distances from 0 or FOREGROUND."""
    graded = np.uint64(0)
    for word in range(mask_words.size):
        pixels = mask_words[word] | blind_words[word]
        level_words[word] = pixels
        graded |= pixels ^ _spread_high_bits(pixels)
    return graded


@kernel
def _spread_high_bits(pixels):  # type: ignore[no-untyped-def]
    """Return 255 in every byte of a word that is above SHADOW_CANDIDATE = 127, 0 in the others."""
    high = high_bytes(pixels)
    return (high << np.uint64(8)) - high


@kernel
def _doubtful_part(row, row_words):  # type: ignore[no-untyped-def]
    """Bound the pixels of a row that may be shadow: first, and last (exclusive); 0, 0 where there are none."""
    first, last = 0, row_words.size
    while first < last and not _is_graded(row_words[first]):
        first += 1
    while first < last and not _is_graded(row_words[last - 1]):
        last -= 1
    first, last = 8 * first, 8 * last
    while first < last and not DARKEST <= row[first] <= LIGHTEST:
        first += 1
    while first < last and not DARKEST <= row[last - 1] <= LIGHTEST:
        last -= 1
    return (first, last) if first < last else (0, 0)


@kernel
def _is_graded(pixels):  # type: ignore[no-untyped-def]
    """Check whether some pixel of a word is neither 0, nor BLIND, nor FOREGROUND."""
    return (pixels ^ _spread_high_bits(pixels)) & NEITHER_SURE_NOR_BLIND != 0


@kernel
def _threshold(level_words, box, binary_words):  # type: ignore[no-untyped-def]
    """Write FOREGROUND where levels (H, W / 8) in the box are above SHADOW_CANDIDATE, UNCERTAIN where they are that, 0
    elsewhere in it."""
    for v in range(box[1], box[3]):
        levels, binary = level_words[v, box[0] // 8 : box[2] // 8], binary_words[v, box[0] // 8 : box[2] // 8]
        for word in range(levels.size):
            uncertain = FIRST_BITS ^ nonzero_bytes(levels[word] ^ ALL_UNCERTAIN)
            binary[word] = _spread_high_bits(levels[word]) | uncertain * np.uint64(UNCERTAIN)


@kernel
def nonzero_bounds(words):  # type: ignore[no-untyped-def]
    """Bound all that is nonzero in (h, words): left, top, right, bottom, in words and rows; zeros where nothing is."""
    left, top, right, bottom = words.shape[1], words.shape[0], 0, 0
    for v in range(words.shape[0]):
        row = words[v]
        first, last = nonzero_span(row)
        if last:
            top, bottom = min(top, v), v + 1
            left, right = min(left, first), max(right, last)
    return (left, top, right, bottom) if bottom else (0, 0, 0, 0)


@kernel
def _bound_body(level_words, shown, box):  # type: ignore[no-untyped-def]
    """Write the box of the pixels (H, W / 8) above SHADOW_CANDIDATE, or UNCERTAIN, within the box ``shown``."""
    left, top, right, bottom = level_words.shape[1], level_words.shape[0], 0, 0
    for v in range(shown[1], shown[3]):
        for word in range(shown[0] // 8, shown[2] // 8):
            uncertain = FIRST_BITS ^ nonzero_bytes(level_words[v, word] ^ ALL_UNCERTAIN)
            if (level_words[v, word] & HIGH_BITS) | uncertain:
                top, bottom = min(top, v), v + 1
                left, right = min(left, word), max(right, word + 1)
    box[0], box[1], box[2], box[3] = 8 * left, top, 8 * right, bottom
