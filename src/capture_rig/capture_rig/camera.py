"""The pinhole camera with lens distortion, and its undistorted view on a padded canvas (thesis 6.1).

Pixel centres lie at whole numbers, as in OpenCV: pixel (0, 0) covers [-0.5, 0.5).
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cached_property

import cv2
import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]

DISTORTION_COEFFICIENTS = {"plumb_bob": 5, "rational_polynomial": 8}
CANVAS_WIDTH_MULTIPLE = 32
UNDISTORT_ITERATIONS = 40
MAX_CANVAS_GROWTH = 2.0  # a canvas wider than this times the image means that the lens model diverges at the edges


@dataclass(frozen=True, eq=False)
class CameraModel:
    """A calibrated camera: ``x_camera = R_camera_world x_world + t_camera_world``, z forward, x right, y down.

    ``K`` (3, 3) in pixels; ``D`` holds the coefficients of ``distortion_model`` in OpenCV's order (plumb_bob:
    k1 k2 p1 p2 k3; rational_polynomial: + k4 k5 k6); ``T_camera_world`` (4, 4) maps world to camera, metres.
    """

    name: str
    width: int
    height: int
    K: Array
    distortion_model: str
    D: Array
    T_camera_world: Array

    @property
    def R_camera_world(self) -> Array:
        return self.T_camera_world[:3, :3]

    @property
    def t_camera_world(self) -> Array:
        return self.T_camera_world[:3, 3]

    @property
    def centre_world(self) -> Array:
        """(3,) the optical centre in world coordinates."""
        return -self.R_camera_world.T @ self.t_camera_world

    @property
    def P(self) -> Array:
        """(3, 4) projection ``K [R | t]`` of the pinhole, without distortion (thesis eq. 3.1)."""
        return self.K @ self.T_camera_world[:3]

    def project(self, points_world: npt.ArrayLike) -> Array:
        """World points (..., 3) to pixels (..., 2), lens distortion included; NaN at or behind the camera."""
        points = np.asarray(points_world, float)
        flat = points.reshape(-1, 3)
        pixels = np.full((len(flat), 2), np.nan)
        in_front = flat @ self.R_camera_world[2] + self.t_camera_world[2] > 1e-9
        if in_front.any():
            rotation, _ = cv2.Rodrigues(self.R_camera_world)
            projected, _ = cv2.projectPoints(
                flat[in_front].reshape(-1, 1, 3), rotation, self.t_camera_world, self.K, self.D
            )
            pixels[in_front] = projected.reshape(-1, 2)
        return pixels.reshape(*points.shape[:-1], 2)

    def rays_world(self, pixels: npt.ArrayLike) -> Array:
        """Unit viewing directions (n, 3) in world coordinates of (distorted) pixels (n, 2)."""
        undistorted = undistort_pixels(np.asarray(pixels, float).reshape(-1, 2), self.K, self.D)
        rays_camera = np.column_stack([undistorted, np.ones(len(undistorted))])
        rays = rays_camera @ self.R_camera_world
        return rays / np.linalg.norm(rays, axis=1, keepdims=True)

    @cached_property
    def _undistorted_view(self) -> UndistortedView:
        return _make_undistorted_view(self)

    def undistorted_view(self) -> UndistortedView:
        """The same camera without distortion, on a canvas that loses no pixel of the image (computed once)."""
        return self._undistorted_view


@dataclass(frozen=True, eq=False)
class UndistortedView:
    """What a camera sees, undistorted, on a canvas padded so that no original pixel is lost.

    ``camera`` has D = 0 and the canvas's size and principal point. ``seen`` (h, w) marks the canvas pixels that lie
    inside the original image; elsewhere the camera is blind, which is not the same as seeing background.
    """

    camera: CameraModel
    seen: npt.NDArray[np.bool_]
    _map: tuple[np.ndarray, np.ndarray] = field(repr=False)

    def undistort_mask(self, mask: np.ndarray) -> np.ndarray:
        """Mask (H, W) uint8 of the original image to the canvas (h, w): nearest pixel, 0 where unseen."""
        canvas = cv2.remap(mask, *self._map, cv2.INTER_NEAREST, borderMode=cv2.BORDER_CONSTANT, borderValue=0)
        return canvas

    def undistort_image(self, image: np.ndarray) -> np.ndarray:
        """Image (H, W[, 3]) to the canvas, black where unseen; nearest pixel, meant for looking at."""
        return self.undistort_mask(image)


def undistort_pixels(pixels: Array, K: Array, D: Array) -> Array:
    """Distorted pixels (n, 2) to normalised image coordinates (n, 2), refined until the forward model agrees.

    OpenCV's own inverse stops after a few iterations, and its signature differs between versions.
    """
    normalised = cv2.undistortPoints(pixels.reshape(-1, 1, 2), K, np.zeros(5)).reshape(-1, 2)
    if not np.any(D):
        return normalised
    target, zero = normalised.copy(), np.zeros(3)
    for _ in range(UNDISTORT_ITERATIONS):
        points = np.column_stack([normalised, np.ones(len(normalised))]).reshape(-1, 1, 3)
        distorted = cv2.projectPoints(points, zero, zero, np.eye(3), D)[0].reshape(-1, 2)
        normalised += target - distorted
    return normalised


def _make_undistorted_view(camera: CameraModel) -> UndistortedView:
    low, high = _canvas_bounds(camera)
    width = -(-int(high[0] - low[0] + 1) // CANVAS_WIDTH_MULTIPLE) * CANVAS_WIDTH_MULTIPLE
    height = int(high[1] - low[1] + 1)
    K = camera.K.copy()
    K[:2, 2] -= low
    canvas = replace(camera, width=width, height=height, K=K, distortion_model="plumb_bob", D=np.zeros(5))
    map_x, map_y = cv2.initUndistortRectifyMap(camera.K, camera.D, np.eye(3), K, (width, height), cv2.CV_32FC1)
    # rounded once, here, so that `seen` and the remap agree on every pixel
    column, row = np.rint(map_x).astype(np.int32), np.rint(map_y).astype(np.int32)
    seen = (column >= 0) & (column < camera.width) & (row >= 0) & (row < camera.height)
    seen &= _lens_model_is_monotonic(camera, K, width, height)
    column, row = np.where(seen, column, -1), np.where(seen, row, -1)
    fixed_point = np.stack([column, row], axis=-1).astype(np.int16)
    return UndistortedView(canvas, seen, (fixed_point, np.empty(0, np.uint16)))


def _canvas_bounds(camera: CameraModel) -> tuple[Array, Array]:
    """Integer pixel bounds (low, high) of the undistorted image's border, in undistorted pixels."""
    w, h = camera.width, camera.height
    x, y = np.arange(w, dtype=float), np.arange(h, dtype=float)
    border = np.concatenate([np.stack([x, 0 * x], 1), np.stack([x, 0 * x + h - 1], 1),
                             np.stack([0 * y, y], 1), np.stack([0 * y + w - 1, y], 1)])  # fmt: skip
    normalised = undistort_pixels(border, camera.K, camera.D)
    pixels = normalised * [camera.K[0, 0], camera.K[1, 1]] + camera.K[:2, 2]
    limit = np.array([w, h]) * (MAX_CANVAS_GROWTH - 1) / 2
    low = np.maximum(np.minimum(np.floor(pixels.min(0)), 0), -np.floor(limit))
    high = np.minimum(np.maximum(np.ceil(pixels.max(0)), [w - 1, h - 1]), np.array([w, h]) - 1 + np.floor(limit))
    return low, high


def _lens_model_is_monotonic(camera: CameraModel, K: Array, width: int, height: int) -> npt.NDArray[np.bool_]:
    """False where the distortion polynomial folds back: such canvas pixels would show a wrong part of the image."""
    if not np.any(camera.D):
        return np.ones((height, width), bool)
    x = (np.arange(width) - K[0, 2]) / K[0, 0]
    y = (np.arange(height) - K[1, 2]) / K[1, 1]
    r2 = x[None, :] ** 2 + y[:, None] ** 2
    coefficients = np.zeros(8)
    coefficients[: len(camera.D)] = camera.D
    k1, k2, _, _, k3, k4, k5, k6 = coefficients
    radius = np.sqrt(np.linspace(0, r2.max(), 2048))
    q = radius**2
    distorted = radius * (1 + q * (k1 + q * (k2 + q * k3))) / (1 + q * (k4 + q * (k5 + q * k6)))
    folds = np.flatnonzero(np.diff(distorted) <= 0)
    limit = radius[folds[0]] ** 2 if len(folds) else np.inf
    return r2 < limit
