"""The pinhole camera with lens distortion, and its undistorted view on a padded canvas (thesis 6.1).

Pixel centres lie at whole numbers, as in OpenCV: pixel (0, 0) covers [-0.5, 0.5).
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cached_property

import cv2
import numpy as np
import numpy.typing as npt

from . import lens
from .errors import InputError
from .lens import NEGLIGIBLE, Array

CANVAS_WIDTH_MULTIPLE = 32
BAND_ROWS = 32
# Thresholds: judgement, no measurement.
ROUNDING_PX = 1e-6
CELLS = 200  # a side: a share is exact to a thousandth
RIM_POINTS = 720  # half a degree apart
MAX_CANVAS_GROWTH = 2.0  # a canvas wider than this times the image means that the lens model diverges at the edges


@dataclass(frozen=True, eq=False)
class CameraModel:
    """A calibrated camera: ``x_camera = R_camera_world x_world + t_camera_world``, z forward, x right, y down.

    ``K`` (3, 3) in pixels; ``D`` holds the coefficients of ``distortion_model`` in OpenCV's order (plumb_bob:
    k1 k2 p1 p2 k3; rational_polynomial: + k4 k5 k6; equidistant, a fisheye's: k1 k2 k3 k4); ``T_camera_world`` (4, 4)
    maps world to camera, metres. ``line_time_s``: of a rolling shutter, from the exposure of one row to that of the
    next; an image's stamp is that of its middle row.
    """

    name: str
    width: int
    height: int
    K: Array
    distortion_model: str
    D: Array
    T_camera_world: Array
    line_time_s: float = 0.0

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
        """World points (..., 3) to pixels (..., 2), lens distortion included.

        NaN at or behind the camera, and beyond the reach of the lens model: there its polynomial folds back, and would
        put a point far outside the view into the middle of the image.
        """
        points = np.asarray(points_world, float)
        x, y, z = (points.reshape(-1, 3) @ self.R_camera_world.T + self.t_camera_world).T
        z = np.where(z > NEGLIGIBLE, z, np.nan)
        return self._pixels(np.stack([x / z, y / z], axis=1)).reshape(*points.shape[:-1], 2)

    def rays_world(self, pixels: npt.ArrayLike) -> Array:
        """Unit viewing directions (n, 3) in world coordinates of (distorted) pixels (n, 2).

        NaN for a pixel that the lens model does not reach (a strong barrel lens calibrated in the middle only).
        """
        ideal = self.ideal_points(np.asarray(pixels, float).reshape(-1, 2))
        rays = np.column_stack([ideal, np.ones(len(ideal))]) @ self.R_camera_world
        return rays / np.linalg.norm(rays, axis=1, keepdims=True)

    def ideal_points(self, pixels: Array) -> Array:
        """Pixels (n, 2) to normalised image coordinates (n, 2) without distortion; NaN beyond the lens's reach."""
        return lens.undistort((pixels - self.K[:2, 2]) / self.K.diagonal()[:2], self.D)

    def _pixels(self, ideal: Array) -> Array:
        """Return the inverse of :meth:`ideal_points`; NaN beyond the reach of the lens model."""
        within = np.hypot(*ideal.T) < self._reach_radius
        distorted = lens.distort(np.where(within[:, None], ideal, np.nan), self.D)
        return distorted * self.K.diagonal()[:2] + self.K[:2, 2]

    @cached_property
    def _reach_radius(self) -> float:
        return lens.reach_radius(self.D)

    @property
    def reach_rad(self) -> float:
        """Angle off the optical axis up to which the image is used: where the lens model folds, where the undistorted
        canvas ends, or the farthest corner's."""
        return self._use[0]

    @property
    def unused_share(self) -> float:
        """Share of the image's pixels that the undistorted canvas leaves out: the lens model has no ray for them, or
        one that lies beyond the largest canvas."""
        return self._use[1]

    @cached_property
    def _use(self) -> tuple[float, float]:
        w, h = self.width, self.height
        x, y = ((np.arange(CELLS) + 0.5) * size / CELLS - 0.5 for size in (w, h))
        cells = np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)
        corners = np.array([[0.0, 0.0], [w - 1.0, 0.0], [0.0, h - 1.0], [w - 1.0, h - 1.0]])
        ideal = self.ideal_points(np.concatenate([corners, cells]))
        on_canvas = ideal * self.K.diagonal()[:2] + self.K[:2, 2]
        low, high = _canvas_bounds(self)
        used = np.asarray(((on_canvas >= low - 0.5) & (on_canvas < high + 0.5)).all(axis=1))  # NaN: not
        radius = np.hypot(*ideal[used].T).max(initial=0.0)
        if not np.isfinite(ideal).all():  # the lens model ends inside the image, or the canvas before it
            edge = (np.array([low, high]) - self.K[:2, 2]) / self.K.diagonal()[:2]
            radius = min(self._reach_radius, float(np.hypot(*np.abs(edge).max(axis=0))))
        return float(np.arctan(radius)), float(1.0 - used[len(corners) :].mean())

    @cached_property
    def _undistorted_view(self) -> UndistortedView:
        return _make_undistorted_view(self)

    def undistorted_view(self) -> UndistortedView:
        """Return the same camera without distortion, on a canvas that loses no pixel of the image (computed once)."""
        return self._undistorted_view


def looking_at(centre_world: Array, target_world: Array, roll_rad: float = 0.0) -> Array:
    """Return T_camera_world (4, 4) of a camera at one place (3,) that faces another, world z up.

    The horizon is level, or turned by ``roll_rad``; a camera that faces nearly along z has world x upwards.
    """
    forward = (target_world - centre_world) / np.linalg.norm(target_world - centre_world)
    up = np.array([0.0, 0.0, 1.0]) if abs(forward[2]) < 0.9 else np.array([1.0, 0.0, 0.0])
    right = np.cross(forward, up)
    right /= np.linalg.norm(right)
    down = np.cross(forward, right)
    c, s = np.cos(roll_rad), np.sin(roll_rad)
    T = np.eye(4)
    T[:3, :3] = np.vstack([c * right + s * down, c * down - s * right, forward])
    T[:3, 3] = -T[:3, :3] @ centre_world
    return T


@dataclass(frozen=True, eq=False)
class UndistortedView:
    """A camera's undistorted view on a canvas padded so that no original pixel is lost.

    ``camera`` has D = 0 and the canvas's size and principal point. ``seen`` (h, w) marks the canvas pixels that lie
    inside the original image; elsewhere the camera is blind, which is not the same as seeing background.
    ``image_shape`` (H, W) is the original image's.
    """

    camera: CameraModel
    seen: npt.NDArray[np.bool_]
    image_shape: tuple[int, int]
    _nearest: npt.NDArray[np.int16] = field(repr=False)  # (h, w, 2) column and row in the original image, -1 unseen

    def undistort_mask(self, mask: np.ndarray) -> np.ndarray:
        """Mask (H, W) uint8 of the original image to the canvas (h, w): nearest pixel, 0 where unseen."""
        if mask.shape[:2] != self.image_shape:
            raise InputError(
                f"an image of {mask.shape[1]} x {mask.shape[0]} pixels is not one of camera '{self.camera.name}', "
                f"whose images are {self.image_shape[1]} x {self.image_shape[0]}",
                remedy="Give the rig file that belongs to this camera.",
            )
        unused = np.empty(0, np.uint16)
        return cv2.remap(mask, self._nearest, unused, cv2.INTER_NEAREST, borderMode=cv2.BORDER_CONSTANT, borderValue=0)


def _make_undistorted_view(camera: CameraModel) -> UndistortedView:
    low, high = _canvas_bounds(camera)
    width = -(-int(high[0] - low[0] + 1) // CANVAS_WIDTH_MULTIPLE) * CANVAS_WIDTH_MULTIPLE
    height = int(high[1] - low[1] + 1)
    K = camera.K.copy()
    K[:2, 2] -= low
    canvas = replace(camera, width=width, height=height, K=K, distortion_model="plumb_bob", D=np.zeros(5))
    nearest = np.empty((height, width, 2), np.int16)
    for top in range(0, height, BAND_ROWS):  # in bands: the lens model's temporaries are forty times the result
        rows = np.arange(top, min(top + BAND_ROWS, height))
        nearest[rows] = _nearest_pixels(camera, (np.arange(width) - K[0, 2]) / K[0, 0], (rows - K[1, 2]) / K[1, 1])
    seen = np.all((nearest >= 0) & (nearest < [camera.width, camera.height]), axis=2)
    nearest[~seen] = -1
    return UndistortedView(canvas, seen, (camera.height, camera.width), nearest)


def _nearest_pixels(camera: CameraModel, x: Array, y: Array) -> npt.NDArray[np.int16]:
    """Column and row (len(y), len(x), 2) of the image at ideal coordinates x, y; rounded once, here, so that ``seen``
    and the remap agree on every pixel. Outside the image, or where the lens model has no pixel: some pixel outside."""
    grid = np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)
    pixels = camera._pixels(grid).reshape(len(y), len(x), 2)
    return np.rint(np.nan_to_num(pixels, nan=-1.0)).clip(-1, [camera.width, camera.height]).astype(np.int16)


def _canvas_bounds(camera: CameraModel) -> tuple[Array, Array]:
    """Integer pixel bounds (low, high) of the undistorted image's border, in undistorted pixels."""
    w, h = camera.width, camera.height
    x, y = np.arange(w, dtype=float), np.arange(h, dtype=float)
    border = np.concatenate(
        [
            np.stack([x, 0 * x], 1),
            np.stack([x, 0 * x + h - 1], 1),
            np.stack([0 * y, y], 1),
            np.stack([0 * y + w - 1, y], 1),
        ]
    )
    ideal = np.concatenate([camera.ideal_points(border), _rim_in_view(camera)])
    pixels = ideal * camera.K.diagonal()[:2] + camera.K[:2, 2]
    last = np.array([w - 1.0, h - 1.0])
    pixels = np.concatenate([pixels[np.isfinite(pixels).all(axis=1)], [[0.0, 0.0], last]])
    margin = np.floor(np.array([w, h]) * (MAX_CANVAS_GROWTH - 1) / 2)
    low = np.maximum(np.floor(pixels.min(0) + ROUNDING_PX), -margin)
    high = np.minimum(np.ceil(pixels.max(0) - ROUNDING_PX), last + margin)
    return low, high


def _rim_in_view(camera: CameraModel) -> Array:
    """Return ideal points (n, 2) of the circle where the lens model ends, as far as it lies in the image: a border of
    the seen pixels beside the image's own."""
    if not np.isfinite(camera._reach_radius):
        return np.empty((0, 2))
    around = np.linspace(0.0, 2.0 * np.pi, RIM_POINTS, endpoint=False)
    rim = (1.0 - ROUNDING_PX) * camera._reach_radius * np.column_stack([np.cos(around), np.sin(around)])
    pixels = camera._pixels(rim)
    return rim[((pixels >= 0) & (pixels <= [camera.width - 1, camera.height - 1])).all(axis=1)]
