"""The silhouettes of one frame set in one array, of which only the part that has or had foreground is written anew.

A person takes a twentieth of a picture. So each mask is read once, eight pixels at a time, to find the box of all that
is not background; whatever follows stays inside that box.
"""

from __future__ import annotations

import numpy as np

from capture_rig.kernel import kernel

from .bitset import high_bytes, nonzero_span
from .views import Box, Masks, RigViews

BLIND = 1  # level of pixels that the camera does not see; no camera client sends it
NEITHER_SURE_NOR_BLIND = np.uint64(0xFEFEFEFEFEFEFEFE)  # bits that 0, BLIND and, turned over, FOREGROUND do not have


class SilhouetteBatch:
    """Levels of all cameras of a rig, for one frame set after another. One thread at a time.

    levels (N, H, W) uint8: of ``capture_rig.mask_levels``; BLIND where a camera is absent or does not see.
    """

    def __init__(self, views: RigViews) -> None:
        self._views = views
        self._blind = np.where(views.seen > 0, np.uint8(0), np.uint8(BLIND))
        self.levels = np.full_like(views.seen, BLIND)
        words, blind_words = self.levels.view(np.uint64), self._blind.view(np.uint64)
        self._absent = np.ones(len(views.names), bool)
        self._shown = np.zeros((len(views.names), 4), np.int64)
        self._of_camera = list(zip(blind_words, words, self._shown, strict=True))

    def take(self, masks: Masks) -> list[str]:
        """Take the masks (h, w) of one frame set; return the cameras, in name order, that show uncertain levels.

        The masks must be those of the rig's canvases.
        """
        uncertain = []
        for camera, name in enumerate(self._views.names):
            if name in masks:
                if self._absent[camera]:
                    self.levels[camera], self._shown[camera], self._absent[camera] = self._blind[camera], 0, False
                if _take(np.ascontiguousarray(masks[name]).view(np.uint64), *self._of_camera[camera]):
                    uncertain.append(name)
            elif not self._absent[camera]:
                self.levels[camera], self._absent[camera] = BLIND, True
        return uncertain

    def shown(self, name: str) -> Box:
        """Return a box that holds all but background of a mask that was taken with the last set."""
        left, top, right, bottom = self._shown[self._views.number[name]].tolist()
        return left, top, right, bottom


@kernel
def _take(mask_words, blind_words, level_words, shown):  # type: ignore[no-untyped-def]
    """Write the levels of one mask (h, w / 8), and the box (4,) of what it shows.

    The words are pixels, eight to a word. ``shown`` comes with the box of the mask before, whose levels are forgotten.
    Returns whether any pixel is neither background, nor blind, nor certainly foreground.
    """
    for v in range(shown[1], shown[3]):
        first, last = shown[0] // 8, shown[2] // 8
        _copy(blind_words[v, first:last], level_words[v, first:last])
    left, top, right, bottom = _nonzero_bounds(mask_words)
    shown[0], shown[1], shown[2], shown[3] = 8 * left, top, 8 * right, bottom
    graded = np.uint64(0)
    for v in range(top, bottom):
        graded |= _write_row(mask_words[v, left:right], blind_words[v, left:right], level_words[v, left:right])
    return graded & NEITHER_SURE_NOR_BLIND != 0


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
