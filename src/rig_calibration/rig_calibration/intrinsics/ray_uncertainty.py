"""How uncertain a calibrated lens leaves the rays of its pixels, and how far out it has rays at all."""

from __future__ import annotations

import cv2
import numpy as np

from capture_rig.camera import CameraModel

from .lens_model import Array


def edge_sd_px(camera: CameraModel, covariance: Array) -> float:
    """Return the uncertainty, px, of the outermost rays, the worst of the four corners."""
    return float(projection_sd(camera, covariance, outermost_pixels(camera)).max())


def outermost_pixels(camera: CameraModel) -> Array:
    """Return (4, 2) the image's corners; where the lens model does not reach one, the last pixel on the way there from
    the principal point for which it has a ray."""
    centre = camera.K[:2, 2]
    corners = np.array([[x, y] for y in (0, camera.height - 1) for x in (0, camera.width - 1)], float)
    along = centre + np.linspace(0.0, 1.0, max(camera.width, camera.height))[:, None, None] * (corners - centre)
    reached = np.isfinite(camera.ideal_points(along.reshape(-1, 2))).all(axis=1, keepdims=True).reshape(len(along), -1)
    last = len(along) - 1 - np.argmax(reached[::-1], axis=0)
    return along[last, np.arange(len(corners))]


def projection_sd(camera: CameraModel, covariance: Array, pixels: Array) -> Array:
    """(n,) px: how uncertain it is where a ray is seen that is seen at ``pixels`` (n, 2), apart from a common rotation
    of the camera, which extrinsics take up. The larger axis of the error ellipse; NaN where the lens has no ray.

    ``covariance`` : of the lens's parameters, in order."""
    ideal = camera.ideal_points(pixels)
    reached = np.isfinite(ideal).all(axis=1)
    sd = np.full(len(pixels), np.nan)
    if not reached.any():
        return sd
    rays = np.column_stack([ideal[reached], np.ones(int(reached.sum()))])
    _, jacobian = cv2.projectPoints(rays, np.zeros(3), np.zeros(3), camera.K, camera.D)
    by_rotation, by_lens = jacobian[:, :3], jacobian[:, 6 : 6 + len(covariance)]
    by_lens = by_lens - by_rotation @ np.linalg.lstsq(by_rotation, by_lens, rcond=None)[0]
    blocks = by_lens.reshape(len(rays), 2, -1)
    ellipses = blocks @ covariance @ blocks.transpose(0, 2, 1)
    sd[reached] = np.sqrt(np.linalg.eigvalsh(ellipses)[:, -1].clip(0.0))
    return sd
