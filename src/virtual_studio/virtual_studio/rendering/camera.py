"""One virtual camera: the light that reaches it from body, room and shadow, and the body's exact silhouette."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import cv2
import numpy as np
from numpy.typing import NDArray

from capture_rig.camera import CameraModel
from capture_rig.rig import Rig

from ..people import Capsules
from ..scene.room import look
from .capsules import cast, cast_silhouette, shadow_lookup

Image = NDArray[np.uint8]

LIGHT_WORLD = np.array([0.35, 0.25, 0.90]) / np.linalg.norm([0.35, 0.25, 0.90])
BOX_MARGIN_PX = 4
NEAR_M = 0.05
_CORNERS = np.array([[x, y, z] for x in (-1.0, 1.0) for y in (-1.0, 1.0) for z in (-1.0, 1.0)])


class VirtualCamera:
    """A camera of the studio; what does not move is computed once."""

    def __init__(self, camera: CameraModel) -> None:
        self.camera = camera
        self._view = look(camera)
        lookup = shadow_lookup(self._view.floor_xy)
        self._shadow_map = cv2.convertMaps(lookup[..., 0], lookup[..., 1], cv2.CV_16SC2)

    def empty_room(self) -> NDArray[np.float32]:
        """Light (h, w), 0..1, without anybody."""
        return self._view.grey

    def render(self, capsules: Capsules, shadow: NDArray[np.float32] | None) -> tuple[NDArray[np.float32], Image]:
        """Light (h, w), 0..1, and exact silhouette (h, w), 0 or 255, of a body and its shadow on the floor (if any)."""
        shape = self.camera.height, self.camera.width
        light = self._view.grey.copy()
        if shadow is not None:
            light *= cv2.remap(shadow, *self._shadow_map, cv2.INTER_LINEAR, None, cv2.BORDER_CONSTANT, 1.0)
        depth, mask = np.full(shape, np.inf, np.float32), np.zeros(shape, np.uint8)
        cast(
            self.camera.centre_world,
            self._view.rays,
            capsules.starts,
            capsules.ends,
            capsules.radii,
            part_boxes(self.camera, capsules),
            LIGHT_WORLD,
            capsules.albedo,
            depth,
            light,
            mask,
        )
        return light, mask


def part_boxes(camera: CameraModel, capsules: Capsules) -> NDArray[np.int64]:
    """Pixel boxes (P, 4) x0, y0, x1, y1 (end excluded) that hold each part: the cubes around its spheres, projected."""
    cubes = np.stack([capsules.starts, capsules.ends], 1)[:, :, None] + capsules.radii[:, :, None, None] * _CORNERS
    corners = cubes.reshape(len(cubes), -1, 3)
    pixels = camera.project(corners)
    depth = corners @ camera.R_camera_world[2] + camera.t_camera_world[2]
    size = np.array([camera.width, camera.height])
    low, high = pixels.min(1) - BOX_MARGIN_PX, pixels.max(1) + BOX_MARGIN_PX + 1
    unbounded = ~(depth.min(1) > NEAR_M) | np.isnan(pixels).any((1, 2))  # around the camera or beyond its lens
    low[unbounded], high[unbounded] = 0, size
    return np.hstack([np.clip(np.floor(low), 0, size), np.clip(np.ceil(high), 0, size)]).astype(np.int64)


# --- Exact silhouettes alone, without light, shadow or video: what benchmarks of hull and tracker feed on.

Masks = dict[str, NDArray[np.uint8]]


class ExactSilhouettes:
    """The eyes of a rig; what does not move is computed once."""

    def __init__(self, rig: Rig) -> None:
        self.rig = rig
        self._rays = [_rays(camera) for camera in rig.cameras]
        self._views = [camera.undistorted_view() for camera in rig.cameras]

    def render(self, capsules: Capsules) -> Masks:
        """Canvas masks {camera: (h, w) uint8}, 0 or 255: the session's exact silhouettes, undistorted."""
        masks = {}
        for camera, rays, view in zip(self.rig.cameras, self._rays, self._views, strict=True):
            mask = np.zeros((camera.height, camera.width), np.uint8)
            cast_silhouette(
                camera.centre_world,
                rays,
                capsules.starts,
                capsules.ends,
                capsules.radii,
                part_boxes(camera, capsules),
                mask,
            )
            masks[camera.name] = view.undistort_mask(mask)
        return masks


def _rays(camera: CameraModel) -> NDArray[np.float64]:
    """Unit viewing directions (h, w, 3) of the camera's pixels, world frame."""
    y, x = np.mgrid[: camera.height, : camera.width]
    rays = camera.rays_world(np.column_stack([x.ravel(), y.ravel()]).astype(float))
    return np.ascontiguousarray(rays.reshape(camera.height, camera.width, 3))


# --- From light to grey levels: exposure, flicker of the lamps, noise of the sensor.

WHITE = 240.0
"""Grey level of a perfectly white surface in full light."""
_BANK_SIZE = 1 << 22


@dataclass(frozen=True)
class Sensor:
    """Imperfections of the sensor and the lamps.

    noise: standard deviation of each pixel's noise, grey levels; flicker: relative standard deviation of the whole
    frame's brightness. Both follow from (seed, camera, frame), so any frame can be made again on its own.
    """

    noise: float = 3.0
    flicker: float = 0.005
    seed: int = 0

    def expose(self, light: NDArray[np.float32], camera: int, frame: int) -> NDArray[np.uint8]:
        """The picture (h, w) uint8 of light (h, w), 0..1, taken by one camera at one frame."""
        rng = np.random.Generator(np.random.SFC64([self.seed, camera, frame]))
        gain = WHITE * (1.0 + self.flicker * rng.standard_normal())
        start = int(rng.integers(_BANK_SIZE - light.size))
        noise = self._noise_bank[start : start + light.size].reshape(light.shape)
        picture = np.maximum(cv2.addWeighted(light, gain, noise, self.noise, 0.0), 0.0)
        return np.asarray(cv2.convertScaleAbs(picture), np.uint8)

    @cached_property
    def _noise_bank(self) -> NDArray[np.float32]:
        """Standard normal numbers; each frame takes a stretch at a place of its own, which costs nothing."""
        return np.random.Generator(np.random.SFC64(self.seed)).standard_normal(_BANK_SIZE, dtype=np.float32)
