"""Start values: the focal length that explains the views' perspective best, tried from a fisheye to a long lens."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from .adjustment import Fit, adjust
from .parameters import Array, LensModel, prior_of
from .pose import board_pose, misfit
from .projection import Corners
from .views import View

FOCAL_TRIALS = np.geomspace(0.4, 5.0, 7)  # of the image's longer side
ROBUST_SIGMAS = 3.0
COARSE_PX = 1.0  # what a corner's sigma counts for while the lens is unknown, at least
UNEXPLAINED_PX = 1e4  # of a view to which no pose fits
TRIAL_VIEWS = 12
ROUGHLY = 1e-5  # relative decrease of the cost at which a start is good enough


def start_fit(views: Sequence[View], model: LensModel) -> Fit:
    """A first adjustment, robust against views that are wrong altogether."""
    some = list(views[:: max(1, len(views) // TRIAL_VIEWS)])
    size = views[0].sighting.image_size
    trials = [model.start(share * max(size), size) for share in FOCAL_TRIALS]
    theta = min(trials, key=lambda theta: _typical_misfit(theta, some, model))
    # the plane's two solutions can be told apart only with a lens that is roughly right: once more
    return fit_from(fit_from(theta, some, model).theta, views, model)


def fit_from(theta: Array, views: Sequence[View], model: LensModel) -> Fit:
    """A robust adjustment from a lens that is roughly known: poses anew, both solutions of the plane looked at."""
    poses = [pose if pose is not None else _somewhere() for pose in poses_of(theta, views, model)]
    prior = prior_of(model, float(theta[:2].mean()), views[0].sighting.image_size)
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
