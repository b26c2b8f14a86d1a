"""Start values: the focal length that explains the views' perspective best, tried from a fisheye to a long lens."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from capture_rig import lens

from .adjustment import Corners, Fit, adjust, normal_equations
from .parameters import CENTRE, FOCAL, Array, LensModel, prior_of
from .views import View

# --- The pose of a flat board from its corners. A plane has two solutions: both are looked at (Collins & Bartoli 2014).

MIN_CORNERS = 4
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
class BoardPlacement:
    """How the board is seen: centre (2,) px; size: side of its area, as a share of the image's; nearer (2,) how much
    its edges at the image's right (+, left -) and bottom (+, top -) lean towards the camera, rad."""

    centre_px: Array
    size: float
    lean_rad: Array

    @property
    def tilt(self) -> float:
        """Angle between the board and the image plane, rad: the perspective that tells the focal length."""
        return float(np.hypot(*self.lean_rad))


def placement_of(pose: Array, view: View) -> BoardPlacement:
    """What ``pose`` means to the person who holds the board."""
    R, t = cv2.Rodrigues(pose[:3])[0], pose[3:]
    normal = R[:, 2] if R[:, 2] @ t < 0 else -R[:, 2]  # towards the camera
    x, y, z = normal
    angle = np.arctan2(np.hypot(x, y), -z)
    direction = -np.array([x, y]) / max(np.hypot(x, y), 1e-12)  # facing left (-x) means: its right edge is nearer
    return BoardPlacement(view.pixels.mean(axis=0), _size(view), angle * direction)


def _size(view: View) -> float:
    hull = cv2.convexHull(view.pixels.astype(np.float32))
    width, height = view.detection.image_size
    return float(np.sqrt(cv2.contourArea(hull) / (width * height)))


def _both(theta: Array, view: View, model: LensModel) -> list[Array]:
    """IPPE's two poses, from ideal coordinates: OpenCV's own undistortion does not converge for strong lenses."""
    ideal = lens.undistort((view.pixels - theta[CENTRE]) / theta[FOCAL], model.D(theta))
    reached = np.isfinite(ideal).all(axis=1)
    if reached.sum() < MIN_CORNERS:
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


FOCAL_TRIALS = np.geomspace(0.4, 5.0, 7)  # of the image's longer side
ROBUST_SIGMAS = 3.0
COARSE_PX = 1.0  # what a corner's sigma counts for while the lens is unknown, at least
UNEXPLAINED_PX = 1e4  # of a view to which no pose fits
TRIAL_VIEWS = 12
ROUGHLY = 1e-5  # relative decrease of the cost at which a start is good enough


def start_fit(views: Sequence[View], model: LensModel) -> Fit:
    """A first adjustment, robust against views that are wrong altogether."""
    some = list(views[:: max(1, len(views) // TRIAL_VIEWS)])
    size = views[0].detection.image_size
    trials = [model.start(share * max(size), size) for share in FOCAL_TRIALS]
    theta = min(trials, key=lambda theta: _typical_misfit(theta, some, model))
    # the plane's two solutions can be told apart only with a lens that is roughly right: once more
    return fit_from(fit_from(theta, some, model).theta, views, model)


def fit_from(theta: Array, views: Sequence[View], model: LensModel) -> Fit:
    """A robust adjustment from a lens that is roughly known: poses anew, both solutions of the plane looked at."""
    poses = [pose if pose is not None else _somewhere() for pose in poses_of(theta, views, model)]
    prior = prior_of(model, float(theta[:2].mean()), views[0].detection.image_size)
    scale = max(COARSE_PX / float(np.median([view.sigma_px for view in views])), 1.0)
    return adjust(theta, np.array(poses), views, model, prior, robust=ROBUST_SIGMAS * scale, converged=ROUGHLY)


def poses_of(theta: Array, views: Sequence[View], model: LensModel) -> list[Array | None]:
    """The pose of each view's board, None where none fits."""
    return [board_pose(theta, view, model) for view in views]


def _typical_misfit(theta: Array, views: Sequence[View], model: LensModel) -> float:
    poses = poses_of(theta, views, model)
    errors = [
        misfit(theta, pose, Corners.of([view]), model) if pose is not None else UNEXPLAINED_PX
        for pose, view in zip(poses, views, strict=True)
    ]
    return float(np.median(errors))


def _somewhere() -> Array:
    """In front of the camera: a view to which no pose fits is left out later, for what it is."""
    return np.array([np.pi, 0.0, 0.0, 0.0, 0.0, 3.0])
