"""Chooses the edge points by which pictures of a scene are aligned: the steepest places of a pyramid of local contrast.

They are spread over the picture, so that a person hides only some of them.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import cv2
import numpy as np
import numpy.typing as npt

from capture_rig.camera import CameraModel

Array = npt.NDArray[np.float64]
Picture = npt.NDArray[np.float32]

WORK_AREA_PX = 320 * 240  # pictures are compared at about this size: a tenth of its pixel is 0.02 degrees
LEVELS = 3  # each half as large as the one before
CELLS_ACROSS = 16  # the strongest places of every cell are taken, so that they are spread over the picture
POINTS_IN_CELL = 6
SURROUNDINGS = 1 / 6  # of the picture's longer side: brightness is taken relative to the mean of so much around
DARK_LEVEL = 8.0  # grey levels; keeps noise in black places small
# Thresholds: SMOOTHED from the filter (1 2 1)/4; else, in standard deviations of the pixels' noise, measured by
# python bench/camera_movement.py.
SMOOTHED = 0.375  # what a smoothing by (1 2 1) / 4, across and down, leaves of the noise
LEAST_NOISE = 0.4  # grey levels at working size: codecs smooth noise away, and what they leave is no signal
CLEAR_OF_NOISE = 4.0  # an edge rises by so many standard deviations of the noise a pixel
FLAT = 0.012  # an edge that rises by less than this share of the brightness a pixel is none
TINY_TURN_RAD = 1e-4


@dataclass(frozen=True, eq=False)
class EdgePoints:
    """The n places that are compared at one level of the pyramid.

    rays (n, 3) : directions in the camera's frame, of length 1. value (n,) : the reference's contrast there.
    steepness (n,) : how much that changes in a pixel of this level at most. slope (n, 3) : how much it changes for a
    turn of the camera, 1 / rad. cell (n,) : which part of the picture. noise : standard deviation of a frame's
    contrast. scale, offset : u_image = scale u_level + offset.
    """

    rays: Array
    value: Array
    steepness: Array
    slope: Array
    cell: npt.NDArray[np.int64]
    noise: float
    scale: float

    @property
    def offset(self) -> float:
        return (self.scale - 1) / 2

    def subset(self, chosen: npt.NDArray[np.bool_] | npt.NDArray[np.int64]) -> EdgePoints:
        """Some of the places: a mask, or their numbers."""
        parts = {name: getattr(self, name)[chosen] for name in ("rays", "value", "steepness", "slope", "cell")}
        return replace(self, **parts)


def contrast_pyramid(image: npt.NDArray, levels: int = LEVELS) -> list[Picture]:
    """Local contrast of an image (H, W[, 3]) at the working size and at each half of it, the finest first.

    Contrast is the difference to the mean of the surroundings as a share of it: lamps, flicker and wide shadows, which
    dim a place and its surroundings alike, leave it as it is.
    """
    factor = work_factor(image.shape)
    height, width = (n // (factor << levels) * (factor << levels) or n // factor * factor for n in image.shape[:2])
    green = image if image.ndim == 2 else cv2.extractChannel(image, 1)
    size = width // factor, height // factor
    grey = cv2.resize(green[:height, :width], size, interpolation=cv2.INTER_AREA).astype(np.float32)
    found = [_contrast(grey)]
    for level in range(1, levels):
        half = cv2.resize(grey, (size[0] >> level, size[1] >> level), interpolation=cv2.INTER_AREA)
        found.append(_contrast(half.astype(np.float32)))
    return found


def work_factor(shape: tuple[int, ...]) -> int:
    """Return how many pixels of the image, across and down, make one of the working size."""
    return max(1, round(math.sqrt(shape[0] * shape[1] / WORK_AREA_PX)))


def _contrast(grey: Picture) -> Picture:
    side = 2 * round(SURROUNDINGS * max(grey.shape) / 2) + 1
    around = cv2.blur(grey, (side, side), borderType=cv2.BORDER_REFLECT) + DARK_LEVEL
    smooth = cv2.GaussianBlur(grey, (3, 3), 0)
    return np.asarray((smooth - around + DARK_LEVEL) / around, np.float32)


def choose_edge_points(camera: CameraModel, mean: npt.NDArray[np.float32], sigma: float) -> list[EdgePoints]:
    """Return the places to compare at each level, finest first; few or none where the picture has no edges.

    ``mean`` (H, W[, 3]) : the reference picture, grey levels. ``sigma`` : noise of a pixel of a frame, grey levels.
    """
    camera = replace(camera, T_camera_world=np.eye(4))  # its world is its own frame
    factor = work_factor(mean.shape)
    green = mean if mean.ndim == 2 else mean[..., 1]
    brightness = float(np.median(green)) + DARK_LEVEL
    found = []
    for level, picture in enumerate(contrast_pyramid(mean)):
        scale = factor << level
        noise = max(SMOOTHED * sigma / scale, LEAST_NOISE / (1 << level)) / brightness
        found.append(_choose(camera, picture, float(scale), noise))
    return found


def _choose(camera: CameraModel, picture: Picture, scale: float, noise: float) -> EdgePoints:
    gradient = np.stack([cv2.Scharr(picture, cv2.CV_32F, *d) / 32 for d in ((1, 0), (0, 1))], axis=-1)
    steepness = np.hypot(gradient[..., 0], gradient[..., 1])
    row, column, cell = strongest(steepness, max(CLEAR_OF_NOISE * noise, FLAT), CELLS_ACROSS, POINTS_IN_CELL)
    pixels = scale * np.column_stack([column, row]) + (scale - 1) / 2
    rays = camera.rays_world(pixels)
    moves = np.stack(
        [
            (camera.project(rays + np.cross(axis, rays)) - pixels) / TINY_TURN_RAD / scale
            for axis in TINY_TURN_RAD * np.eye(3)
        ],
        axis=-1,
    )
    slope = np.einsum("nk,nkj->nj", gradient[row, column], moves)
    found = EdgePoints(
        rays=rays,
        value=picture[row, column].astype(float),
        steepness=steepness[row, column].astype(float),
        slope=slope,
        cell=cell,
        noise=noise,
        scale=scale,
    )
    return found.subset(np.isfinite(slope).all(axis=1))


def strongest(
    steepness: Picture, least: float, cells_across: int, in_cell: int
) -> tuple[npt.NDArray[np.int64], npt.NDArray[np.int64], npt.NDArray[np.int64]]:
    """Return row, column and cell (n,) of the ``in_cell`` steepest places of every cell.

    Those that are not steeper than ``least``, next to a steeper one, or at the border are left out.
    """
    width = steepness.shape[1]
    side = max(width // cells_across, 4)
    peak = (steepness >= cv2.dilate(steepness, np.ones((3, 3), np.uint8))) & (steepness > least)
    peak[[0, 1, 2, -3, -2, -1]] = False
    peak[:, [0, 1, 2, -3, -2, -1]] = False
    row, column = np.nonzero(peak)
    cell = row // side * (-(-width // side)) + column // side
    order = np.lexsort((-steepness[row, column], cell))
    row, column, cell = row[order], column[order], cell[order]
    taken = np.arange(len(cell)) - np.searchsorted(cell, cell) < in_cell
    return row[taken], column[taken], cell[taken]
