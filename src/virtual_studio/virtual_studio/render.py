"""One virtual camera: the light that reaches it from body, room and shadow, and the body's exact silhouette."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from capture_rig.camera import CameraModel

from .body import Capsules
from .ray_caster import cast
from .room import look
from .shadow import shadow_lookup

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

    def see(self, capsules: Capsules, shadow: NDArray[np.float32] | None) -> tuple[NDArray[np.float32], Image]:
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
