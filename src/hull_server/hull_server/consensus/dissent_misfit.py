"""How far one camera's silhouette lies beside the hull of the others: the sign of a camera that was moved.

A silhouette lies inside the outline of the hull that the others make. When the camera has turned by a degree or two it
sticks out on one side, and it fits again when it is pushed back: by how many pixels, and how much better? What sticks
out for other reasons, such as a shadow on the floor, is not cured by pushing.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from numba import njit

from .dissent_kernels import BACKGROUND_CELL, Room, project

REACH = 8  # cells, in each direction, by which a silhouette is pushed at most
CLEAR = 0.01  # a gain smaller than this says nothing about where to


@dataclass(frozen=True)
class Misfit:
    """share : of a silhouette, that comes to lie inside the hull's outline when it is pushed to where it fits best.

    push_px : by how many pixels to the right and down; (0, 0) when nothing is gained.
    """

    share: float = 0.0
    push_px: tuple[float, float] = (0.0, 0.0)


def find_misfit(
    room: Room, labels: npt.NDArray[np.int32], camera: int, voxels: npt.NDArray[np.int16], stride: int
) -> Misfit:
    """Push the silhouette of ``camera``, labelled (H, W), over the outline of the ``voxels`` (M, 3) of the hull."""
    height, width = labels.shape
    outline = np.zeros((height + 2 * REACH, width + 2 * REACH), np.uint8)
    _draw(room, camera, voxels, outline)
    outside = np.zeros((2 * REACH + 1, 2 * REACH + 1), np.int64)
    size = room.sizes[camera]
    cells = _push(labels, int(size[0]), int(size[1]), outline, outside)
    share = (outside[REACH, REACH] - outside.min()) / max(cells, 1)
    if share < CLEAR:
        return Misfit()
    down, right = np.nonzero(outside == outside.min())
    nearest = np.argmin(np.hypot(down - REACH, right - REACH))
    return Misfit(float(share), (float(right[nearest] - REACH) * stride, float(down[nearest] - REACH) * stride))


@njit(cache=True, nogil=True)
def _draw(room, camera, voxels, outline):  # type: ignore[no-untyped-def]
    """Set the cells of ``outline``, which has a margin of REACH, that the voxels' pictures touch."""
    width, height = room.sizes[camera, 0], room.sizes[camera, 1]
    for found in range(voxels.shape[0]):
        u, v, w = project(room.projections, camera, voxels[found, 0], voxels[found, 1], voxels[found, 2])
        if w > 0:
            reach = room.reach[camera] / w
            for row in range(int(max(v - reach, 0.0)), int(min(v + reach + 1.0, height))):
                for column in range(int(max(u - reach, 0.0)), int(min(u + reach + 1.0, width))):
                    outline[row + REACH, column + REACH] = 1


@njit(cache=True, nogil=True)
def _push(labels, width, height, outline, outside):  # type: ignore[no-untyped-def]
    """Count the foreground cells that lie outside the outline after each push; return the number of all."""
    cells, pushes = 0, outside.shape[0]
    for row in range(height):
        for column in range(width):
            if labels[row, column] > BACKGROUND_CELL:
                cells += 1
                for down in range(pushes):
                    for right in range(pushes):
                        outside[down, right] += 1 - np.int64(outline[row + down, column + right])
    return cells
