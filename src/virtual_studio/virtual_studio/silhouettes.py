"""Exact silhouettes alone, without light, shadow or video: what benchmarks of hull and tracker feed on."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from capture_rig.camera import CameraModel
from capture_rig.rig import Rig

from .body import Capsules
from .ray_caster import cast_silhouette
from .render import part_boxes

Masks = dict[str, NDArray[np.uint8]]


class ExactSilhouettes:
    """The eyes of a rig; what does not move is computed once."""

    def __init__(self, rig: Rig) -> None:
        self.rig = rig
        self._rays = [_rays(camera) for camera in rig.cameras]
        self._views = [camera.undistorted_view() for camera in rig.cameras]

    def see(self, capsules: Capsules) -> Masks:
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
