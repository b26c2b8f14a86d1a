"""The pose of a flat board from its corners. A plane has two solutions: both are looked at (Collins & Bartoli 2014)."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from capture_rig import lens

from .parameters import CENTRE, FOCAL, Array, LensModel
from .projection import Corners, normal_equations
from .views import View

LEAST_CORNERS = 4
POLISH_STEPS = 8
WORTHWHILE = 0.99  # a step that leaves more of the misfit than this is the last


def board_pose(theta: Array, view: View, model: LensModel) -> Array | None:
    """(6,) rotation vector and translation camera from board: the better of the plane's two solutions.

    None when the corners determine none in front of the camera.
    """
    corners = Corners.of([view])
    candidates = [_polished(theta, pose, corners, model) for pose in _both(theta, view, model)]
    ahead = [pose for pose in candidates if pose[5] > 0 and np.isfinite(pose).all()]
    return min(ahead, key=lambda pose: misfit(theta, pose, corners, model), default=None)


def misfit(theta: Array, pose: Array, corners: Corners, model: LensModel) -> float:
    """Mean distance between seen and expected corners of one view, px."""
    return float(np.hypot(*corners.residuals(theta, pose[None], model).T).mean())


@dataclass(frozen=True, eq=False)
class BoardView:
    """How the board is seen: centre (2,) px; size: side of its area, as a share of the image's; nearer (2,) how much
    its edges at the image's right (+, left -) and bottom (+, top -) lean towards the camera, rad."""

    centre_px: Array
    size: float
    nearer: Array

    @property
    def tilt(self) -> float:
        """Angle between the board and the image plane, rad: the perspective that tells the focal length."""
        return float(np.hypot(*self.nearer))


def look_of(pose: Array, view: View) -> BoardView:
    """What ``pose`` means to the person who holds the board."""
    R, t = cv2.Rodrigues(pose[:3])[0], pose[3:]
    normal = R[:, 2] if R[:, 2] @ t < 0 else -R[:, 2]  # towards the camera
    x, y, z = normal
    angle = np.arctan2(np.hypot(x, y), -z)
    direction = -np.array([x, y]) / max(np.hypot(x, y), 1e-12)  # facing left (-x) means: its right edge is nearer
    return BoardView(view.pixels.mean(axis=0), _size(view), angle * direction)


def _size(view: View) -> float:
    hull = cv2.convexHull(view.pixels.astype(np.float32))
    width, height = view.sighting.image_size
    return float(np.sqrt(cv2.contourArea(hull) / (width * height)))


def _both(theta: Array, view: View, model: LensModel) -> list[Array]:
    """IPPE's two poses, from ideal coordinates: OpenCV's own undistortion does not converge for strong lenses."""
    ideal = lens.undistort((view.pixels - theta[CENTRE]) / theta[FOCAL], model.D(theta))
    reached = np.isfinite(ideal).all(axis=1)
    if reached.sum() < LEAST_CORNERS:
        return []
    try:
        _, rotations, translations, _ = cv2.solvePnPGeneric(
            view.points_board[reached], ideal[reached][:, None], np.eye(3), None, flags=cv2.SOLVEPNP_IPPE
        )
    except cv2.error:
        return []
    return [np.concatenate([np.ravel(r), np.ravel(t)]) for r, t in zip(rotations, translations, strict=True)]


def _polished(theta: Array, pose: Array, corners: Corners, model: LensModel) -> Array:
    """Gauss-Newton on the pose alone: IPPE solves the plane's homography, not the least squares of the pixels."""
    error = misfit(theta, pose, corners, model)
    for _ in range(POLISH_STEPS):
        equations = normal_equations(theta, pose[None], corners, model)
        tried = pose + np.linalg.lstsq(equations.pose[0], equations.of_pose[0], rcond=None)[0]
        before, error = error, misfit(theta, tried, corners, model)
        if not error < before:
            break
        pose = tried
        if error > WORTHWHILE * before:
            break
    return pose
