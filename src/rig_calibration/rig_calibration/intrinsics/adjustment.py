"""Bundle adjustment of one camera: Levenberg-Marquardt with the poses eliminated view by view (Schur complement).

Written here rather than left to OpenCV, because it needs what that does not give: corners of unlike accuracy, a loss
that wrong corners cannot spoil, boards that are bent, and each view's own information about the camera, from which the
choice of views, honest standard deviations and the rejection of whole views follow.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from . import kernel
from .parameters import BOW_NAMES, Array, LensModel, Prior
from .views import View

# --- Where a camera sees the corners of views, and the normal equations of the differences.


@dataclass(frozen=True, eq=False)
class Corners:
    """The corners of several views behind one another: those of view v are first[v] .. first[v + 1]."""

    first: npt.NDArray[np.int64]
    points_board: Array
    bow: Array
    pixels: Array
    sigma_px: Array

    @classmethod
    def of(cls, views: Sequence[View]) -> Corners:
        first = np.concatenate([[0], np.cumsum([len(view) for view in views])]).astype(np.int64)
        points, bow, pixels = (
            np.ascontiguousarray(np.concatenate([getattr(view, name) for view in views]))
            for name in ("points_board", "bow", "pixels")
        )
        return cls(first, points, bow, pixels, np.array([view.sigma_px for view in views]))

    def residuals(self, theta: Array, poses: Array, model: LensModel) -> Array:
        """(N, 2) seen minus expected, px."""
        expected = np.empty_like(self.pixels)
        kernel.project_all(_widened(theta, model), poses, self.first, self.points_board, self.bow, expected)
        return self.pixels - expected


@dataclass(frozen=True, eq=False)
class NormalEquations:
    """Blocks of the views: camera (V, p, p), mixed (V, p, 6), pose (V, 6, 6); right: theta (V, p), of_pose (V, 6)."""

    camera: Array
    mixed: Array
    pose: Array
    theta: Array
    of_pose: Array


def normal_equations(
    theta: Array, poses: Array, corners: Corners, model: LensModel, robust: float = np.inf
) -> NormalEquations:
    """For the parameters (p,) and poses (V, 6), rotation vector and translation camera from board.

    ``robust`` : standard deviations from which a corner counts for less (Cauchy's loss).
    """
    size = kernel.PARAMETERS + kernel.POSE
    matrices, rights = np.empty((len(poses), size, size)), np.empty((len(poses), size))
    kernel.normal_equations(
        _widened(theta, model),
        poses,
        corners.first,
        corners.points_board,
        corners.bow,
        corners.pixels,
        corners.sigma_px,
        robust,
        matrices,
        rights,
    )
    own, pose = _places(model), slice(kernel.PARAMETERS, size)
    return NormalEquations(
        matrices[:, own[:, None], own], matrices[:, own, pose], matrices[:, pose, pose], rights[:, own], rights[:, pose]
    )


def residuals(theta: Array, pose: Array, view: View, model: LensModel) -> Array:
    """(n, 2) of one view seen from ``pose`` (6,): seen minus expected, px."""
    return Corners.of([view]).residuals(theta, pose[None], model)


def _places(model: LensModel) -> npt.NDArray[np.int64]:
    """Where the model's parameters are among the kernel's."""
    count = len(model.names)
    return np.r_[:count, kernel.PARAMETERS - len(BOW_NAMES) : kernel.PARAMETERS]


def _widened(theta: Array, model: LensModel) -> Array:
    """The kernel's parameters; coefficients that the model has not are zero."""
    wide = np.zeros(kernel.PARAMETERS)
    wide[_places(model)] = theta
    return wide


MAX_STEPS = 60
CONVERGED = 1e-8  # relative decrease of the cost
DAMPING, EASIER, HARDER, MAX_DAMPING = 1e-4, 0.2, 8.0, 1e8


@dataclass(frozen=True, eq=False)
class Fit:
    """theta (p,); poses (V, 6), camera from board; information (V, p, p) and score (V, p) of each view about theta
    with its pose eliminated: the gradient is their sum; cost: sum of squares over variances, prior included."""

    theta: Array
    poses: Array
    information: Array
    score: Array
    cost: float
    prior: Prior

    @property
    def precision(self) -> Array:
        """(p, p) the inverse of the covariance, if the views' sigmas are right and their noise is white."""
        return self.information.sum(axis=0) + self.prior.precision


def adjust(
    theta: Array,
    poses: Array,
    views: Sequence[View],
    model: LensModel,
    prior: Prior,
    *,
    robust: float = np.inf,
    converged: float = CONVERGED,
) -> Fit:
    """The most probable camera and poses, from a start (p,), (V, 6).

    ``robust`` : standard deviations from which a corner counts for less (Cauchy's loss); infinite for least squares.
    ``converged`` : the relative decrease of the cost that is no longer worth a step.
    """
    corners = Corners.of(views)
    damping, cost = DAMPING, _cost(theta, poses, corners, model, prior, robust)
    for _ in range(MAX_STEPS):
        equations = normal_equations(theta, poses, corners, model, robust)
        decrease = 0.0
        while damping < MAX_DAMPING:
            step, steps = _solve(equations, theta, prior, damping)
            tried = _cost(theta + step, poses + steps, corners, model, prior, robust)
            if tried <= cost:
                decrease = (cost - tried) / max(cost, 1e-300)
                theta, poses, cost, damping = theta + step, poses + steps, tried, damping * EASIER
                break
            damping *= HARDER
        if decrease < converged:
            break
    information, score = reduced(normal_equations(theta, poses, corners, model, robust))
    return Fit(theta, poses, information, score, cost, prior)


def view_information(theta: Array, poses: Array, views: Sequence[View], model: LensModel) -> Array:
    """(V, p, p): what each view says about the camera once its own pose has been paid for."""
    return reduced(normal_equations(theta, poses, Corners.of(views), model))[0]


def reduced(equations: NormalEquations) -> tuple[Array, Array]:
    """(V, p, p) and (V, p): the normal equations of each view with its pose eliminated."""
    right = np.concatenate([equations.mixed.transpose(0, 2, 1), equations.of_pose[:, :, None]], axis=2)
    back = np.linalg.solve(_damped(equations.pose, 1e-12), right)
    information = equations.camera - equations.mixed @ back[:, :, :-1]
    return information, equations.theta - (equations.mixed @ back[:, :, -1:])[:, :, 0]


def _solve(equations: NormalEquations, theta: Array, prior: Prior, damping: float) -> tuple[Array, Array]:
    """The step of the parameters (p,), and of the poses (V, 6) that follow from it."""
    mixed, turned = equations.mixed, equations.mixed.transpose(0, 2, 1)
    inverses = np.linalg.inv(_damped(equations.pose, damping))
    matrix = _damped(prior.precision + equations.camera.sum(axis=0), damping)
    matrix = matrix - (mixed @ inverses @ turned).sum(axis=0)
    of_pose = equations.of_pose[:, :, None]
    right = equations.theta.sum(axis=0) - (mixed @ inverses @ of_pose).sum(axis=0)[:, 0]
    step = np.linalg.solve(matrix, right + prior.precision @ (prior.mean - theta))
    return step, (inverses @ (of_pose - turned @ step[:, None]))[:, :, 0]


def _damped(matrices: Array, damping: float) -> Array:
    """(..., n, n) with larger diagonals."""
    diagonal = np.diagonal(matrices, axis1=-2, axis2=-1)
    return matrices + damping * (diagonal + 1e-12)[..., None] * np.eye(matrices.shape[-1])


def _cost(theta: Array, poses: Array, corners: Corners, model: LensModel, prior: Prior, robust: float) -> float:
    if not (theta[0] > 0 and theta[1] > 0 and (poses[:, 5] > 0).all()):
        return np.inf
    misses = corners.residuals(theta, poses, model) / np.repeat(corners.sigma_px, np.diff(corners.first))[:, None]
    squares = (misses**2).sum(axis=1)
    return prior.cost(theta) + float((squares if np.isinf(robust) else robust**2 * np.log1p(squares / robust**2)).sum())
