"""The tables that the CPU carve reads: of the calibration, and of one frame set's silhouettes, labelled and summed."""

from __future__ import annotations

from typing import NamedTuple

import cv2
import numpy as np
import numpy.typing as npt

from capture_rig.kernel import kernel

from ..bitset import high_bytes, nonzero_bytes
from ..views import Box

BACKGROUND, FOREGROUND, BLIND = 0, 1, 2  # labels of pixels; blind are those that are uncertain, too
SURE, UNSURE = 2, 1  # what a foreground and an uncertain pixel count in the summed areas; see also ALL_SURE

EVEN_BYTES = np.uint64(0x00FF00FF00FF00FF)
ONE_BYTES = np.uint64(0x0101010101010101)


class Scene(NamedTuple):
    """The calibration (fixed) and the silhouettes of one frame set.

    projections (N, 3, 4): voxel index to pixel. sizes (N, 2): canvases. seen_table (N, H + 1, W + 1).
    voxel_steps (N, 3, 64), octant_steps (N, 3, 64): see :mod:`.carve_blocks`.
    labels (N, H * W + 8): BACKGROUND, FOREGROUND or BLIND for every pixel, and BLIND for all that lies outside.
    stride: W. foreground_box (N, 4): u, v from and to of a box that holds all foreground pixels.
    foreground_table (N, (H / 2 + 2) * (W / 2 + 1)): summed areas inside that box, in squares of 2 x 2 pixels, of the
    foreground, SURE a pixel, and of what is uncertain, UNSURE a pixel; from its corner, row after row without gaps
    (which takes a fraction of the memory pages that a canvas would).
    present (n,): cameras of this frame set, in the order in which they are tested; the result does not depend on it.
    min_seeing: cameras that must see a voxel. vetoes: how many may veto it nevertheless, 0 or 1. shape (3,): the grid.
    """

    projections: npt.NDArray[np.float64]
    voxel_steps: npt.NDArray[np.float64]
    octant_steps: npt.NDArray[np.float32]
    sizes: npt.NDArray[np.int64]
    seen_table: npt.NDArray[np.int32]
    labels: npt.NDArray[np.uint8]
    stride: int
    foreground_box: npt.NDArray[np.int64]
    foreground_table: npt.NDArray[np.int32]
    present: npt.NDArray[np.int64]
    min_seeing: int
    vetoes: int
    shape: npt.NDArray[np.int64]


class Tabulator:
    """Tabulates labels and summed areas of silhouettes, one frame set after another.

    seen (N, H, W) uint8, nonzero where a camera sees. labels, box, table : see Scene; of the last silhouette
    of each camera.
    """

    def __init__(self, seen: npt.NDArray[np.uint8]) -> None:
        cameras, height, width = seen.shape
        seen_words = np.minimum(seen, 1).view(np.uint64)  # 1 in every byte that is seen
        self.labels = np.full((cameras, height * width + 8), BLIND, np.uint8)  # a word more, for all that is outside
        self.labels[:, :-8][seen.reshape(cameras, -1) > 0] = BACKGROUND
        label_words = self.labels.view(np.uint64)[:, :-1].reshape(seen_words.shape)
        self.table = np.zeros((cameras, (height // 2 + 2) * (width // 2 + 1)), np.int32)
        self.box = np.zeros((cameras, 4), np.int64)
        counts, sums = np.empty(width // 8, np.uint64), np.empty(width // 2, np.int32)
        scratch = counts, counts.view(np.uint16), sums
        self._of_camera = [(seen_words[c], label_words[c], self.table[c], self.box[c], scratch) for c in range(cameras)]

    def tabulate(self, camera: int, mask: npt.NDArray[np.uint8], within: Box | None = None) -> int:
        """Tabulate a camera's silhouette (h, w); return the sum of its table.

        within : left, top, right, bottom of a box that holds all of them, where one is known; the rest is not read.
        """
        words = np.ascontiguousarray(mask).view(np.uint64)
        if within is None:
            left, top, width, height = cv2.boundingRect(mask)
            within = left, top, left + width, top + height
        part = within[0] // 8, within[1], -(-within[2] // 8), within[3]
        return int(_tabulate(words, part, *self._of_camera[camera]))


@kernel
def _tabulate(mask_words, part, seen_words, label_words, table, box, scratch):  # type: ignore[no-untyped-def]
    """Tabulate one silhouette, touching only a box that holds its foreground.

    mask_words (h, w / 8), seen_words and label_words (H, W / 8): images of bytes, eight pixels to a word. label_words
    and box (4,) come with what the frame before left in them. part : words and rows from and to that hold all
    foreground. scratch : counts (W / 8,), of squares their quarters (W / 2,), and sums (W / 2,). Returns the sum of the
    table.
    """
    counts, square_counts, sums = scratch
    left, top, right, bottom = part
    _forget(label_words, seen_words, box, left, top, right, bottom)
    box[0], box[1], box[2], box[3] = 8 * left, top, 8 * right, bottom
    width = 4 * (right - left)
    for u in range(width):
        sums[u] = 0
    for u in range(width + 1):
        table[u] = 0
    for row in range((bottom - top + 1) // 2):
        counts[: right - left] = 0
        for v in range(top + 2 * row, min(top + 2 * row + 2, bottom)):
            _label_row(mask_words[v, left:right], seen_words[v, left:right], label_words[v, left:right], counts)
        for word in range(right - left):
            counts[word] = (counts[word] & EVEN_BYTES) + (counts[word] >> np.uint64(8) & EVEN_BYTES)
        _sum_row(square_counts, sums, table[(row + 1) * (width + 1) : (row + 2) * (width + 1)])
    return table[(bottom - top + 1) // 2 * (width + 1) + width]


@kernel
def _label_row(mask_words, seen_words, label_words, counts):  # type: ignore[no-untyped-def]
    """Label part of a row, and add what each pixel counts."""
    for word in range(mask_words.size):
        pixels, seen = mask_words[word], seen_words[word]
        sure = high_bytes(pixels) & seen
        uncertain = (nonzero_bytes(pixels) & seen) ^ sure
        counts[word] += (sure << np.uint64(1)) | uncertain  # SURE is 2, UNSURE 1
        label_words[word] = _label(seen) | sure | uncertain << np.uint64(1)  # FOREGROUND is 1, BLIND 2


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


@kernel
def _forget(label_words, seen_words, box, left, top, right, bottom):  # type: ignore[no-untyped-def]
    """Label the foreground box of the frame before as empty, except for the part that is labelled next."""
    first, last = box[0] // 8, box[2] // 8
    for v in range(box[1], box[3]):
        if v < top or v >= bottom:
            _clear(label_words[v, first:last], seen_words[v, first:last])
        else:
            _clear(label_words[v, first : min(left, last)], seen_words[v, first : min(left, last)])
            _clear(label_words[v, max(right, first) : last], seen_words[v, max(right, first) : last])


@kernel
def _clear(label_words, seen_words):  # type: ignore[no-untyped-def]
    for word in range(label_words.size):
        label_words[word] = _label(seen_words[word])


@kernel
def _label(seen):  # type: ignore[no-untyped-def]
    """Return BACKGROUND (0) in every byte that is seen, BLIND in the others."""
    return (~seen & ONE_BYTES) << np.uint64(BLIND - 1)
