"""Operations on masks that look only where foreground is: a person fills a tenth of the image.

In the order of the pipeline: :class:`ForegroundLocator` finds the box to work in, :func:`majority` filters noise (then
:mod:`.components` drops specks and far parts), :func:`trim_outline` puts the outline at half contrast, and
:class:`BoxUndistorter` maps the result onto the canvas.
"""

from __future__ import annotations

from typing import NamedTuple

import cv2
import numpy as np
import numpy.typing as npt

from capture_rig.camera import UndistortedView
from capture_rig.kernel import njit

from ..background.kernels import BLOCK_PX, OPTIONS
from ..frame_source import Mask

MOST_IN_BLOCK_PX = 8


Spans = tuple[npt.NDArray[np.int64], npt.NDArray[np.int64]]
"""Of each row (h, 2) and of each column (w, 2) of a part of an image: first pixel and end; 0, 0 for nothing."""


class Box(NamedTuple):
    """Pixels of rows top to bottom and columns left to right, ends excluded; empty when it has none."""

    top: int
    left: int
    bottom: int
    right: int

    @classmethod
    def around(cls, mask: Mask) -> Box:
        """Return what holds every pixel of ``mask`` that is not 0."""
        x, y, width, height = cv2.boundingRect(mask)
        return cls(y, x, y + height, x + width)

    @property
    def empty(self) -> bool:
        return self.bottom <= self.top or self.right <= self.left

    @property
    def slices(self) -> tuple[slice, slice]:
        """The box as slices that index an image."""
        return slice(self.top, self.bottom), slice(self.left, self.right)

    def grown(self, by_px: int, shape: tuple[int, ...], multiple: int = 1) -> Box:
        """Larger by ``by_px`` on all sides, then to multiples of ``multiple``, but within an image of ``shape``; an
        empty box stays empty."""
        if self.empty:
            return self
        (top, left), side = (max(self.top - by_px, 0), max(self.left - by_px, 0)), multiple
        bottom, right = -(-(self.bottom + by_px) // side) * side, -(-(self.right + by_px) // side) * side
        return Box(top - top % side, left - left % side, min(bottom, shape[0]), min(right, shape[1]))

    def divided(self, by: int) -> Box:
        """Return the same box in pixels ``by`` times as large: it begins at multiples of them."""
        return Box(self.top // by, self.left // by, -(-self.bottom // by), -(-self.right // by))

    def joined(self, other: Box) -> Box:
        """Return the smallest box that holds both."""
        if self.empty or other.empty:
            return other if self.empty else self
        (top, left, bottom, right), o = self, other
        return Box(min(top, o.top), min(left, o.left), max(bottom, o.bottom), max(right, o.right))


class ForegroundLocator:
    """Finds, fast, a box that holds everything in an image that may be a part of a person.

    Foreground is counted in blocks of 8 x 8 pixels by halving the image, or samples of it, until a block is one pixel.
    Noise, at one pixel in a hundred, fills no block, so that it does not widen the box as it would widen a bounding
    box.
    """

    def __init__(self, shape: tuple[int, ...], min_area_px: float, least_in_block_px: int, step_px: int = 1) -> None:
        """Parts below ``min_area_px`` may be missed; a block counts from ``least_in_block_px`` (or a sixth of the
        smallest part, if that is more, up to 8) pixels on. Every ``step_px``-th row and column is looked at."""
        self._shape, self._min_area_px, self._step_px = shape[:2], min_area_px, step_px
        least_px = max(least_in_block_px, min(int(min_area_px / 6), MOST_IN_BLOCK_PX))
        side = BLOCK_PX // step_px
        self._in_mean = 256 // side**2  # what one sample of 255 adds to the mean of its block, halved several times
        self._sparse = 255 - self._in_mean * max(round(least_px / step_px**2), 1) + 1
        down, across = (-(-n // BLOCK_PX) for n in shape[:2])
        self._padded = np.full((down * side, across * side), 255, np.uint8)
        self.dense = np.zeros((down, across), np.uint8)
        """Blocks (of the last call of :meth:`find`) that the box was made for are 1, the others 0."""

    def find(self, distance: Mask, threshold: float) -> Box:
        """Return a box of whole blocks around all neighbouring dense blocks that hold the smallest part, together.

        distance (h, w) uint8 : of the samples; above the ``threshold`` they are foreground.
        """
        height, width = distance.shape
        cv2.threshold(distance, threshold, 255, cv2.THRESH_BINARY_INV, dst=self._padded[:height, :width])
        blocks: np.ndarray = self._padded
        while blocks.shape[0] > len(self.dense):
            blocks = cv2.resize(blocks, (blocks.shape[1] // 2, blocks.shape[0] // 2), interpolation=cv2.INTER_AREA)
        dense = cv2.threshold(blocks, self._sparse, 255, cv2.THRESH_BINARY_INV)[1]
        count, labels = cv2.connectedComponents(dense, connectivity=8)
        samples = np.bincount(labels.reshape(-1), (255 - blocks).reshape(-1), count) / self._in_mean
        pixels = samples * self._step_px**2
        large = (pixels >= self._min_area_px).astype(np.uint8)
        large[0] = 0  # what is not dense
        self.dense = large[labels]
        top, left, bottom, right = (BLOCK_PX * side for side in Box.around(self.dense))
        return Box(top, left, min(bottom, self._shape[0]), min(right, self._shape[1]))

    def spans(self, at: tuple[slice, slice], reach_blocks: int) -> Spans:
        """Return the spans of a part of the image, from the first dense block to the last and so many blocks around."""
        blocks = cv2.dilate(self.dense, np.ones((2 * reach_blocks + 1,) * 2, np.uint8))
        rows, columns = (np.zeros((side.stop - side.start, 2), np.int64) for side in at)
        find_spans(blocks, at[0].start, at[1].start, rows, columns)
        return rows, columns


@njit(**OPTIONS)
def find_spans(blocks, top, left, rows, columns):  # type: ignore[no-untyped-def]
    """Fill ``rows`` and ``columns``, zeros before, with the spans of the nonzero blocks of the part at (top, left)."""
    for i in range(blocks.shape[0]):
        for j in range(blocks.shape[1]):
            if blocks[i, j] == 0:
                continue
            y0, y1 = max(BLOCK_PX * i - top, 0), min(BLOCK_PX * (i + 1) - top, len(rows))
            x0, x1 = max(BLOCK_PX * j - left, 0), min(BLOCK_PX * (j + 1) - left, len(columns))
            if y0 >= y1 or x0 >= x1:
                continue
            for y in range(y0, y1):
                if rows[y, 1] == 0:
                    rows[y, 0] = x0
                rows[y, 1] = x1
            for x in range(x0, x1):
                if columns[x, 1] == 0:
                    columns[x, 0] = y0
                columns[x, 1] = y1


# --- half of the size, and whole again

ALL_BYTES: dict[int, np.unsignedinteger] = {
    2: np.uint16(0x0101),
    4: np.uint32(0x01010101),
    8: np.uint64(0x0101010101010101),
}


def halve(image: np.ndarray) -> np.ndarray:
    """The image at half its size (rounded up), each pixel the mean of the four it covers; odd sides are continued."""
    down, right = image.shape[0] % 2, image.shape[1] % 2
    if down or right:
        image = cv2.copyMakeBorder(image, 0, down, 0, right, cv2.BORDER_REPLICATE)
    return cv2.resize(image, (image.shape[1] // 2, image.shape[0] // 2), interpolation=cv2.INTER_AREA)


def enlarged(small: Mask, times: int, shape: tuple[int, ...]) -> Mask:
    """Return each pixel repeated both ways, cut to ``shape``. (A sixth of the time of OpenCV's nearest neighbour.)"""
    if times in ALL_BYTES:
        wide = np.multiply(small, ALL_BYTES[times], dtype=ALL_BYTES[times].dtype).view(np.uint8)
    else:
        wide = np.repeat(small, times, axis=1)
    return np.ascontiguousarray(np.repeat(wide, times, axis=0)[: shape[0], : shape[1]])


# --- filters: which parts of a raw mask belong to the person


MEDIAN_PX = 5  # side of the filter by which the thesis's rules decide with the neighbourhood


def majority(mask: Mask, side_px: int = MEDIAN_PX) -> Mask:
    """The median filter of a mask of 0 and 255, as a box filter: several times faster, and equal for odd sides."""
    mean = cv2.blur(mask, (side_px, side_px), borderType=cv2.BORDER_REPLICATE)
    return cv2.threshold(mean, 127, 255, cv2.THRESH_BINARY)[1]


def majority_count(side_px: int = MEDIAN_PX) -> int:
    """A pixel that survives the filter has so many pixels of foreground in one 8 x 8 block that its window meets.

    The window lies in four blocks at most, which leaves (side^2 + 1) / 8 for one of them; fewer at the image's border,
    where a pixel also stands for its neighbours outside: in the corner, (side + 1) / 2 of them outvote all others.
    """
    return side_px // 2 + 1


# --- the outline: at half contrast, not where the background ends

CROSS = np.array([[0, 1, 0], [1, 1, 1], [0, 1, 0]], np.uint8)
_DISC_PX = 7
_DISC = np.asarray(cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (_DISC_PX, _DISC_PX)), np.uint8)


def trim_outline(person: Mask, change: Mask, least_share: float, colour: bool, times: int = 1) -> Mask:
    """Return ``person`` (h, w) without pixels of its outline that are mostly background.

    A pixel on the edge is a blend, and lens, codec and noise filter spread it over its neighbours; a background test
    that notices a few grey levels calls all of it foreground, and people become a pixel wider all around. So a pixel
    that touches the background stays only if it differs from it by ``least_share`` of the largest difference around.
    Colour is measured at half the resolution (Bayer sensors, 4:2:0 video), which spreads it further: what is around
    reaches to where the colour is whole.
    change (h, w) uint8 : grey levels between frame and background, in the channel that differs most. times : how many
    times finer the result is: there the share is interpolated, and the outline lies between the pixels.
    """
    around, trimmed = _DISC if colour else CROSS, np.zeros([times * n for n in person.shape], np.uint8)
    part = Box.around(person).grown(_DISC_PX, person.shape).slices
    person = person[part]
    if person.size == 0:
        return trimmed
    difference = cv2.bitwise_and(change[part], person)
    inside = cv2.erode(person, CROSS, borderType=cv2.BORDER_CONSTANT, borderValue=255)
    most = cv2.dilate(difference, around)
    if times > 1:
        share = cv2.max(inside, cv2.min(person, cv2.divide(difference, most, scale=255)))
        fine = cv2.resize(share, None, fx=times, fy=times, interpolation=cv2.INTER_LINEAR)
        at = tuple(slice(times * side.start, times * side.stop) for side in part)
        trimmed[at] = cv2.threshold(fine, 255 * least_share, 255, cv2.THRESH_BINARY)[1]
        return trimmed
    wanted = cv2.convertScaleAbs(most, alpha=least_share)
    trimmed[part] = cv2.bitwise_or(inside, cv2.bitwise_and(person, cv2.compare(difference, wanted, cv2.CMP_GE)))
    return trimmed


# --- undistortion of a part of the image, without looking at the rest of the canvas

CELL_PX = 16
_UNSEEN = np.uint32(0xFFFFFFFF)


class BoxUndistorter:
    """Gives exactly what ``view.undistort_mask`` gives for a mask that is 0 outside a box, and faster.

    For each cell of the image it knows which rows and columns of the canvas look into it.
    """

    def __init__(self, view: UndistortedView) -> None:
        rows, columns = np.indices(view.image_shape, np.int16)
        nearest = np.stack([view.undistort_mask(columns), view.undistort_mask(rows)], axis=2)
        nearest[~view.seen] = -1
        place = nearest[..., 1].astype(np.uint32) * np.uint32(view.image_shape[1]) + nearest[..., 0].astype(np.uint32)
        self._place = np.where(view.seen, place, _UNSEEN)
        self._low, self._high = _canvas_of_cells(nearest, view.image_shape)

    def undistort(self, mask: Mask, box: Box) -> Mask:
        """Map ``mask`` (H, W) uint8, 0 outside ``box``, to the canvas (h, w): nearest pixel, 0 where unseen."""
        canvas = np.zeros(self._place.shape, np.uint8)
        fill_canvas(mask, *box, self._place, self._low, self._high, canvas)
        return canvas


@njit(**OPTIONS)
def fill_canvas(mask, top, left, bottom, right, place, low, high, canvas):  # type: ignore[no-untyped-def]
    """Fill the parts of the canvas that look into what ``mask`` (H, W) holds within a box; see :class:`BoxUndistorter`.

    place (h, w) uint32 : index of the pixel that each pixel of the canvas shows, or _UNSEEN. low, high : of
    :func:`_canvas_of_cells`. canvas (h, w) uint8 : written, zeros before.
    """
    for row in range(top // CELL_PX, -(-bottom // CELL_PX)):
        y0, y1 = max(top, row * CELL_PX), min(bottom, (row + 1) * CELL_PX)
        begin = -1
        for cell in range(left // CELL_PX, -(-right // CELL_PX) + 1):  # runs of cells that hold anything
            x0, x1 = max(left, cell * CELL_PX), min(right, (cell + 1) * CELL_PX)
            holds = x0 < x1 and _holds_anything(mask[y0:y1, x0:x1])
            if holds and begin < 0:
                begin = cell
            elif not holds and begin >= 0:
                _fill_cells(mask, low[row, begin:cell], high[row, begin:cell], place, canvas)
                begin = -1


@njit(**OPTIONS)
def _holds_anything(part):  # type: ignore[no-untyped-def]
    for y in range(part.shape[0]):
        row, found = part[y], np.uint8(0)
        for x in range(len(row)):
            found |= row[x]
        if found:
            return True
    return False


@njit(**OPTIONS)
def _fill_cells(mask, low, high, place, canvas):  # type: ignore[no-untyped-def]
    """Fill the rectangle of the canvas that looks into a run of cells; low, high (n, 2) : of each."""
    v0, u0, v1, u1 = canvas.shape[0], canvas.shape[1], 0, 0
    for cell in range(len(low)):
        v0, u0 = min(v0, low[cell, 0]), min(u0, low[cell, 1])
        v1, u1 = max(v1, high[cell, 0]), max(u1, high[cell, 1])
    pixels = mask.reshape(-1)
    for v in range(v0, v1):
        to, looks_at = canvas[v, u0:u1], place[v, u0:u1]
        for u in range(len(to)):
            if looks_at[u] != _UNSEEN:
                to[u] = pixels[looks_at[u]]


def _canvas_of_cells(nearest: np.ndarray, shape: tuple[int, int]) -> tuple[np.ndarray, np.ndarray]:
    """For each image cell (r, c) the lowest and highest + 1 canvas (row, column) that looks into it, both (r, c, 2)."""
    grid = tuple(-(-n // CELL_PX) for n in shape)
    low = np.full((*grid, 2), np.iinfo(np.int32).max, np.int32)
    high = np.zeros((*grid, 2), np.int32)
    row, column = np.nonzero(nearest[..., 0] >= 0)
    cell = nearest[row, column, 1] // CELL_PX, nearest[row, column, 0] // CELL_PX
    for axis, place in enumerate((row, column)):
        np.minimum.at(low[..., axis], cell, place.astype(np.int32))
        np.maximum.at(high[..., axis], cell, place.astype(np.int32) + 1)
    return low, high
