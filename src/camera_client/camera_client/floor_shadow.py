"""Shadows in mono images: floor that is darker by a locally constant factor, with its texture unchanged."""

from __future__ import annotations

import cv2
import numpy as np

from capture_rig.camera import CameraModel

from .background_model import BackgroundModel
from .frame_source import Image, Mask
from .settings import FloorShadowSettings

GRID_PX = 8  # the floor's outline in the image needs no finer grid
MAX_FLOOR_DISTANCE_M = 20.0
MIN_WINDOW_PX = 5  # 3 x 3 pixels hold too little texture to tell anything apart
MIN_PATCH_WINDOWS = 10  # fewer windows agree by chance


class FloorShadow:
    """Tells which foreground pixels only show the floor in shadow.

    Around each pixel, in a small window, the image x is compared with the background mu times one factor
    a = sum x / sum mu. In a shadow x = a mu but for noise, texture included; a body brings a texture and edges of its
    own. A pixel fits when the mean square of x - a mu stays below (residual * sigma)^2, when a is that of a shadow,
    and when its ray meets the floor at all: bodies above the horizon are never touched. Fitting pixels are a shadow
    only as a large patch: a body's smooth places agree with the floor behind them by chance, in small ones.
    """

    def __init__(
        self, camera: CameraModel, background: BackgroundModel, sigma_floor: float, settings: FloorShadowSettings
    ) -> None:
        side = 2 * round((settings.window * camera.height - 1) / 2) + 1
        self._settings, self._window = settings, (max(side, MIN_WINDOW_PX), max(side, MIN_WINDOW_PX))
        mean = background.mean
        self._mean, self._mean_window = mean, np.maximum(self._blur(mean), np.float32(1e-3))
        self._power = self._blur(mean * mean)
        typical = max(float(np.median(background.sigma)), sigma_floor)
        sigma = np.maximum(self._blur(background.sigma), np.float32(typical))
        self._limit = (settings.residual * sigma) ** 2
        self._floor = floor_pixels(camera)
        self._min_area_px = max(settings.min_area * camera.height**2, MIN_PATCH_WINDOWS * self._window[0] ** 2)

    def shadow(self, image: Image, mask: Mask) -> Mask:
        """255 at pixels of ``mask`` (H, W) where ``image`` (H, W) fits the shadowed floor, else 0."""
        found = np.zeros_like(mask)
        candidates = cv2.bitwise_and(mask, self._floor)
        x, y, width, height = cv2.boundingRect(candidates)
        if width:
            margin = self._window[0] // 2
            rows = slice(max(y - margin, 0), y + height + margin)
            columns = slice(max(x - margin, 0), x + width + margin)
            fits = cv2.bitwise_and(candidates[rows, columns], self._fits(image, (rows, columns)))
            found[rows, columns] = large_patches(fits, self._min_area_px)
        return found

    def _fits(self, image: Image, box: tuple[slice, slice]) -> Mask:
        """255 where the window around a pixel of ``box`` is a darkened background, else 0."""
        s, mean = self._settings, self._mean[box]
        x = image[box].astype(np.float32)
        factor = cv2.divide(self._blur(x), self._mean_window[box])
        departure = cv2.subtract(x, cv2.multiply(factor, mean))
        residual = self._blur(cv2.multiply(departure, departure))
        darker = cv2.inRange(factor, s.darkest, s.lightest)
        return cv2.bitwise_and(darker, cv2.compare(residual, self._limit[box], cv2.CMP_LE))

    def _blur(self, values: np.ndarray) -> np.ndarray:
        return cv2.blur(values, self._window)


def floor_pixels(camera: CameraModel) -> Mask:
    """(H, W) uint8: 255 where a pixel's ray meets the floor z = 0 within 20 m, else 0."""
    u, v = np.meshgrid(np.arange(0, camera.width, GRID_PX), np.arange(0, camera.height, GRID_PX))
    rays = camera.rays_world(np.stack([u.ravel(), v.ravel()], axis=1)).reshape(*u.shape, 3)
    height_m = camera.centre_world[2]
    meets = (height_m > 0) & (-rays[..., 2] * MAX_FLOOR_DISTANCE_M > height_m)
    grid = np.where(meets, np.uint8(255), np.uint8(0))
    full = cv2.resize(grid, (u.shape[1] * GRID_PX, u.shape[0] * GRID_PX), interpolation=cv2.INTER_NEAREST)
    return np.ascontiguousarray(full[: camera.height, : camera.width])


def large_patches(mask: Mask, min_area_px: float) -> Mask:
    """The connected parts of ``mask`` of at least ``min_area_px``, after breaking bridges thinner than 3 pixels."""
    opened = cv2.morphologyEx(mask, cv2.MORPH_OPEN, np.ones((3, 3), np.uint8))
    count, labels, stats, _ = cv2.connectedComponentsWithStats(opened, connectivity=4)
    large = np.zeros_like(mask)
    for label in range(1, count):
        if stats[label, cv2.CC_STAT_AREA] >= min_area_px:
            cv2.bitwise_or(large, cv2.inRange(labels, label, label), dst=large)
    return large
