"""Undistorts what lies in a part of the image, without looking at the rest of the canvas."""

from __future__ import annotations

import cv2
import numpy as np

from capture_rig.camera import UndistortedView

from .frame_source import Mask
from .regions import Box

CELL_PX = 16
BAND_PX = 4 * CELL_PX  # arms make a person wide, but only in few rows


class BoxUndistorter:
    """Gives exactly what ``view.undistort_mask`` gives for a mask that is 0 outside a box, and faster.

    For each cell of the image it knows which rows and columns of the canvas look into it.
    """

    def __init__(self, view: UndistortedView) -> None:
        rows, columns = np.indices(view.image_shape, np.int16)
        nearest = np.stack([view.undistort_mask(columns), view.undistort_mask(rows)], axis=2)
        nearest[~view.seen] = -1
        self._nearest = nearest
        self._low, self._high = _canvas_of_cells(nearest, view.image_shape)

    def undistort(self, mask: Mask, box: Box) -> Mask:
        """``mask`` (H, W) uint8, 0 outside ``box``, to the canvas (h, w): nearest pixel, 0 where unseen."""
        canvas = np.zeros(self._nearest.shape[:2], np.uint8)
        for top in range(box.top // BAND_PX * BAND_PX, box.bottom, BAND_PX):
            band = Box(max(top, box.top), box.left, min(top + BAND_PX, box.bottom), box.right)
            marked = Box.around(mask[band.slices])
            if not marked.empty:
                self._look_up(mask, marked.outside(band), canvas)
        return canvas

    def _look_up(self, mask: Mask, box: Box, canvas: Mask) -> None:
        """Fill that part of the canvas which looks into ``box``."""
        cells = tuple(slice(s.start // CELL_PX, -(-s.stop // CELL_PX)) for s in box.slices)
        (top, left), (bottom, right) = self._low[cells].min(axis=(0, 1)), self._high[cells].max(axis=(0, 1))
        if top < bottom:
            part = slice(top, bottom), slice(left, right)
            canvas[part] = cv2.remap(
                mask,
                self._nearest[part],
                np.empty(0, np.uint16),
                cv2.INTER_NEAREST,
                borderMode=cv2.BORDER_CONSTANT,
                borderValue=0,
            )


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
