"""Boxes of pixels: a person fills a tenth of the image, and the rest need not be worked on."""

from __future__ import annotations

from typing import NamedTuple

import cv2
import numpy as np

from .frame_source import Mask

BLOCK_PX = 8
MOST_IN_BLOCK_PX = 8
_PIXEL_OF_BLOCK = 4  # what one pixel of 255 adds to the mean of its block, halved three times


class Box(NamedTuple):
    """Pixels of rows top to bottom and columns left to right, ends excluded; empty when it has none."""

    top: int
    left: int
    bottom: int
    right: int

    @classmethod
    def whole(cls, shape: tuple[int, ...]) -> Box:
        """All of an image of that shape."""
        return cls(0, 0, shape[0], shape[1])

    @classmethod
    def around(cls, mask: Mask) -> Box:
        """What holds every pixel of ``mask`` that is not 0."""
        x, y, width, height = cv2.boundingRect(mask)
        return cls(y, x, y + height, x + width)

    @property
    def empty(self) -> bool:
        return self.bottom <= self.top or self.right <= self.left

    @property
    def slices(self) -> tuple[slice, slice]:
        """To index an image with."""
        return slice(self.top, self.bottom), slice(self.left, self.right)

    def grown(self, by_px: int, shape: tuple[int, ...], multiple: int = 1) -> Box:
        """Larger by ``by_px`` on all sides, then to multiples of ``multiple``, but within an image of ``shape``."""
        top, left = (max(start - by_px, 0) // multiple * multiple for start in self[:2])
        bottom, right = (-(-(end + by_px) // multiple) * multiple for end in self[2:])
        return Box(top, left, min(bottom, shape[0]), min(right, shape[1]))

    def within(self, outer: Box) -> Box:
        """The same box, counted from the corner of ``outer``."""
        return Box(self.top - outer.top, self.left - outer.left, self.bottom - outer.top, self.right - outer.left)

    def outside(self, outer: Box) -> Box:
        """The inverse of :meth:`within`."""
        return Box(self.top + outer.top, self.left + outer.left, self.bottom + outer.top, self.right + outer.left)


class Surroundings:
    """Finds, fast, a box that holds everything in an image that may be a part of a person.

    Foreground is counted in blocks of 8 x 8 pixels by halving the image three times. Noise, at one pixel in a hundred,
    fills no block, so that it does not widen the box as it would widen a bounding box.
    """

    def __init__(self, shape: tuple[int, ...], min_area_px: float, least_in_block_px: int) -> None:
        """Parts below ``min_area_px`` may be missed; a block counts from ``least_in_block_px`` (or a sixth of the
        smallest part, if that is more, up to 8) pixels on."""
        self._shape, self._min_area_px = shape[:2], min_area_px
        least_px = max(least_in_block_px, min(int(min_area_px / 6), MOST_IN_BLOCK_PX))
        self._sparse = 255 - _PIXEL_OF_BLOCK * least_px + 1
        height, width = (-(-n // BLOCK_PX) * BLOCK_PX for n in shape[:2])
        self._padded = np.full((height, width), 255, np.uint8)
        self.busy = np.zeros((height // BLOCK_PX, width // BLOCK_PX), np.uint8)
        """Blocks (of the last call of :meth:`box`) that the box was made for are 1, the others 0."""

    @property
    def buffer(self) -> Mask:
        """(H, W) to write the mask of the *background* into, 255 or 0, before :meth:`box`."""
        return self._padded[: self._shape[0], : self._shape[1]]

    def box(self) -> Box:
        """A box of whole blocks around all neighbouring dense blocks that hold the smallest part, together."""
        blocks: np.ndarray = self._padded
        for _ in range(3):
            blocks = cv2.resize(blocks, (blocks.shape[1] // 2, blocks.shape[0] // 2), interpolation=cv2.INTER_AREA)
        dense = cv2.threshold(blocks, self._sparse, 255, cv2.THRESH_BINARY_INV)[1]
        count, labels = cv2.connectedComponents(dense, connectivity=8)
        pixels = np.bincount(labels.reshape(-1), (255 - blocks).reshape(-1), count) / _PIXEL_OF_BLOCK
        large = (pixels >= self._min_area_px).astype(np.uint8)
        large[0] = 0  # what is not dense
        self.busy = large[labels]
        top, left, bottom, right = (BLOCK_PX * side for side in Box.around(self.busy))
        return Box(top, left, min(bottom, self._shape[0]), min(right, self._shape[1]))
