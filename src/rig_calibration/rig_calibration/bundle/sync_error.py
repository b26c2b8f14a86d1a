"""Targets that move between the exposures of cameras that are not quite synchronous.

Cameras then see a moving target in different places, all corners together. Least squares would believe the many corners
of one detection far too much, above all across the line of sight, where a single picture tells a target's place to a
fraction of a millimetre. So each detection is allowed a displacement of its own, unknown but for its standard deviation
tau (m), which is estimated from how far the cameras contradict one another:

    covariance of a detection's residuals = I + tau^2 A A^T,    A: derivatives by the target's position

This is what weighing frames down by the target's speed would do, without the need to know speed or delay.

Whether cameras contradict one another by more than the noise of corners explains is an analysis of variance. The
corners of one detection err together as if the target lay elsewhere when it moved between exposures, is bent, or a lens
is not quite known: that part of a residual is its projection on what a change of the target's pose does to the picture.
Cameras and targets, too, act on a detection only through that pose, so the rest of the residual is noise of corners.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from .projection import Linearised
from .rigid import Array
from .state import Ints

SINGULAR = 1e-9
POSITION = slice(3, 6)
# Thresholds: judgement, no measurement.
PRIOR_DOF = 6.0  # degrees of freedom of the prior that holds a frame's displacement to that of all
MAX_CHANGE = 4.0  # of tau^2 in one round


@dataclass(frozen=True, eq=False)
class PoseMisfit:
    """squares (s,): squared length, in standard deviations, of the part of each detection's residual that a change of
    pose would explain; dof (s,): how many numbers that is (6 or, for a wand, 5)."""

    squares: Array
    dof: Ints

    def ratio(self, residual: Array, corners: int, poses: Ints, shared: int) -> tuple[float, int]:
        """Variance of the pose-like part over that of the rest (1: corners err independently), and its degrees of
        freedom. residual (s, 2n) weighted; poses (s,): the pose of each; shared: free shared unknowns."""
        dof = int(self.dof.sum()) - pose_dof(poses, self.dof) - shared
        rest_dof = 2 * corners - int(self.dof.sum())
        rest = float((residual**2).sum() - self.squares.sum())
        if dof <= 0 or rest_dof <= 0 or rest <= 0:
            return 1.0, max(dof, 0)
        return float(self.squares.sum() / dof / (rest / rest_dof)), dof


def pose_misfit(linear: Linearised) -> PoseMisfit:
    """Find the pose-like part of the residuals of each detection."""
    V = np.swapaxes(linear.by_pose, 1, 2) @ linear.by_pose
    g = (np.swapaxes(linear.by_pose, 1, 2) @ linear.residual[..., None])[..., 0]
    values, vectors = np.linalg.eigh(V)
    along = (np.swapaxes(vectors, 1, 2) @ g[..., None])[..., 0]
    seen = values > SINGULAR * values[:, -1:]
    squares = np.where(seen, along**2 / np.where(seen, values, 1.0), 0.0)
    return PoseMisfit(squares.sum(axis=1), seen.sum(axis=1))


def pose_dof(poses: Ints, dof: Ints) -> int:
    """Count how many numbers the poses that were seen have: six each, five for a wand."""
    most = np.zeros(int(poses.max(initial=-1)) + 1, np.int64)
    np.maximum.at(most, poses, dof)
    return int(most.sum())


def whitened(linear: Linearised, tau: Array) -> Linearised:
    """Transform the rows so that the residuals are independent again; tau (s,), m."""
    A = linear.by_pose[:, :, POSITION]
    values, vectors = np.linalg.eigh(np.swapaxes(A, 1, 2) @ A)
    values = np.maximum(values, 1e-12 * values[:, -1:] + 1e-300)
    shrink = (1 - 1 / np.sqrt(1 + tau[:, None] ** 2 * values)) / values
    M = (vectors * shrink[:, None]) @ np.swapaxes(vectors, 1, 2)

    def apply(rows: Array) -> Array:
        return rows - A @ (M @ (np.swapaxes(A, 1, 2) @ rows))

    return Linearised(apply(linear.residual[..., None])[..., 0], apply(linear.by_shared), apply(linear.by_pose))


def first_tau(linear: Linearised, misfit: PoseMisfit, dof: int) -> float:
    """Estimate the displacement (m) that makes the residuals' part along it as large as it is, the same for all
    detections."""
    A = linear.by_pose[:, :, POSITION]
    information = np.swapaxes(A, 1, 2) @ A
    pull = np.swapaxes(A, 1, 2) @ linear.residual[..., None]
    squares = float((np.swapaxes(pull, 1, 2) @ np.linalg.pinv(information, hermitian=True) @ pull).sum())
    left = max(dof, 1) / misfit.dof.sum()  # the share that fitting poses leaves
    excess = squares / left - 3 * len(A)
    return float(np.sqrt(max(excess, 0.0) / np.trace(information, axis1=1, axis2=2).sum()))


def next_tau(tau: Array, linear: Linearised, poses: Ints) -> Array:
    """Improve the displacements (s,), pose by pose, from what contradiction is left in whitened residuals."""
    misfit = pose_misfit(linear)
    squares, total = np.bincount(poses, misfit.squares), np.bincount(poses, misfit.dof)
    own = np.zeros(len(total))
    np.maximum.at(own, poses, misfit.dof)
    ratio = (PRIOR_DOF + squares) / (PRIOR_DOF + total - own)
    return tau * np.sqrt(np.clip(ratio, 1 / MAX_CHANGE, MAX_CHANGE))[poses]
