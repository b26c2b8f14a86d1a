"""What the CPU carve reads: the calibration and the labelled silhouettes of one frame set, as plain arrays."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import numpy.typing as npt
from numba import njit

BACKGROUND, FOREGROUND, BLIND = 0, 1, 2  # what a camera says of a pixel


class Scene(NamedTuple):
    """What one carve reads: the calibration (fixed) and the silhouettes of one frame set.

    projections (N, 3, 4): voxel index to pixel. sizes (N, 2): canvases. seen_table (N, H + 1, W + 1).
    labels (N, H * W + 1): BACKGROUND, FOREGROUND or BLIND for every pixel, and BLIND for all that lies outside.
    stride: W. foreground_box (N, 4): u, v from and to of a box that holds all foreground pixels.
    foreground_table (N, H + 1, W + 1): summed areas of the foreground inside that box, from its corner.
    present (n,): cameras of this frame set. min_seeing: cameras that must see a voxel. shape (3,): the grid.
    """

    projections: npt.NDArray[np.float64]
    sizes: npt.NDArray[np.int64]
    seen_table: npt.NDArray[np.int32]
    labels: npt.NDArray[np.uint8]
    stride: int
    foreground_box: npt.NDArray[np.int64]
    foreground_table: npt.NDArray[np.int32]
    present: npt.NDArray[np.int64]
    min_seeing: int
    shape: npt.NDArray[np.int64]


@njit(cache=True, nogil=True)
def foreground_bounds(words):  # type: ignore[no-untyped-def]
    """u, v from and to of all nonzero pixels of an image given as (h, w / 8) words; u to the multiple of 8."""
    columns = np.zeros(words.shape[1], np.uint64)
    top, bottom = words.shape[0], 0
    for row in range(words.shape[0]):
        any_word = np.uint64(0)
        for column in range(words.shape[1]):
            any_word |= words[row, column]
        if any_word != 0:
            top, bottom = min(top, row), row + 1
            for column in range(words.shape[1]):
                columns[column] |= words[row, column]
    used = np.flatnonzero(columns)
    if used.size == 0:
        return 0, 0, 0, 0
    return 8 * used[0], top, 8 * (used[-1] + 1), bottom
