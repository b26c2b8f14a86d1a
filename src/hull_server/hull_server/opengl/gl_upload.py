"""What the compute carve needs of one frame set, laid out on the host as its shaders read it: one upload."""

from __future__ import annotations

import cv2
import numpy as np
import numpy.typing as npt
from numba import njit

from ..views import Masks, RigViews

LISTS = 4  # lists that the kernels hand on: coarse blocks, bricks, blocks, doubts
FRAME_OFFSET = 256  # bytes: the largest alignment that a driver may ask of a bound range
PIXELS_PER_WORD = 16
_HEAD, _BOX = 4, 4  # words: of the frame's head, of a camera's foreground box


class FrameUpload:
    """The words of a frame set: the empty lists; from FRAME_OFFSET on head, boxes, labels and summed areas.

    words : int32, all of them at their largest. labels_start : word at which the labels begin.
    Only rows that hold foreground, now or in the frame set before, are written. Not for two threads at a time.
    """

    def __init__(self, views: RigViews) -> None:
        cameras, height, width = views.seen.shape
        self._names, self._countable = views.names, np.minimum(views.seen, 1)
        columns = width // PIXELS_PER_WORD
        boxes = FRAME_OFFSET // 4 + _HEAD
        starts = boxes + _BOX * cameras
        self.labels_start = starts + cameras
        self._areas_start = self.labels_start + cameras * height * columns
        self.words: npt.NDArray[np.int32] = np.zeros(self._areas_start + cameras * (height + 1) * (width + 1), np.int32)
        self.words[: 4 * LISTS] = [0, 1, 1, 0] * LISTS  # groups x, y, z of a dispatch; length
        self._head = self.words[FRAME_OFFSET // 4 : boxes]
        self._boxes = self.words[boxes:starts].reshape(cameras, _BOX)
        self._area_starts = self.words[starts : self.labels_start]
        labels = self.words[self.labels_start : self._areas_start]
        self._labels = labels.view(np.uint32).reshape(cameras, height, columns)
        self._labels[:] = np.packbits(views.seen == 0, axis=-1, bitorder="little").view("<u2").astype(np.uint32) << 16
        self._rows = np.zeros((cameras, 2), np.int64)  # from and to, of each camera's foreground

    def fill(self, masks: Masks, present: npt.NDArray[np.int64], min_seeing: int) -> npt.NDArray[np.int32]:
        """The words to upload for the masks of the ``present`` cameras; valid until the next call."""
        self._head.view(np.uint32)[:2] = sum(1 << int(camera) for camera in present), min_seeing
        end = self._areas_start
        for camera in present:
            end = self._fill_camera(camera, masks[self._names[camera]], end)
        return self.words[:end]

    def _fill_camera(self, camera: int, mask: npt.NDArray[np.uint8], start: int) -> int:
        """Labels, foreground box and summed areas, these from word ``start``; returns where they end."""
        words = np.ascontiguousarray(mask).view(np.uint64)
        u0, v0, u1, v1 = label_foreground(words, self._labels[camera], self._rows[camera])
        self._boxes[camera] = u0, v0, u1, v1
        self._area_starts[camera] = start
        if u1 == 0:
            return start
        foreground = cv2.min(mask[v0:v1, u0:u1], self._countable[camera, v0:v1, u0:u1])
        end = start + (v1 - v0 + 1) * (u1 - u0 + 1)
        cv2.integral(foreground, self.words[start:end].reshape(v1 - v0 + 1, u1 - u0 + 1), cv2.CV_32S)
        return end


@njit(cache=True, nogil=True)
def label_foreground(words, labels, rows):  # type: ignore[no-untyped-def]
    """Write a mask's foreground into its labels; return a box (u, v from and to) around it, u in steps of 16.

    words (h, w / 8) uint64: the mask, eight pixels a word. labels (H, W / 16) uint32: bit p is set where the camera
    sees foreground, bit 16 + p (kept) where it is blind. rows (2,): the rows that hold foreground, from and to;
    on entry those of the frame set before.
    """
    labels[rows[0] : rows[1]] &= np.uint32(0xFFFF0000)
    groups = words.shape[1] // 2
    left, right, top, bottom = groups, 0, words.shape[0], 0
    for row in range(words.shape[0]):
        any_word = np.uint64(0)
        for column in range(words.shape[1]):
            any_word |= words[row, column]
        if any_word == 0:
            continue
        top, bottom = min(top, row), row + 1
        for group in range(groups):
            bits = _nonzero_bytes(words[row, 2 * group]) | _nonzero_bytes(words[row, 2 * group + 1]) << np.uint64(8)
            if bits != 0:
                left, right = min(left, group), max(right, group + 1)
                labels[row, group] |= np.uint32(bits) & ~(labels[row, group] >> np.uint32(16))
    rows[0], rows[1] = min(top, bottom), bottom
    return (16 * left, top, 16 * right, bottom) if bottom > 0 else (0, 0, 0, 0)


@njit(cache=True, nogil=True)
def _nonzero_bytes(word):  # type: ignore[no-untyped-def]
    """Bit b is set where byte b of a word is not zero."""
    low = np.uint64(0x7F7F7F7F7F7F7F7F)
    flags = ((word & low) + low | word) >> np.uint64(7) & np.uint64(0x0101010101010101)
    return flags * np.uint64(0x0102040810204080) >> np.uint64(56)
