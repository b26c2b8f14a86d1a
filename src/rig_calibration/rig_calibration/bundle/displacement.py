"""Targets that move between the exposures.

Cameras that are not quite synchronous see a moving target in different places, all corners together. Least squares
would believe the many corners of one sighting far too much, above all across the line of sight, where a single picture
tells a target's place to a fraction of a millimetre. So each sighting is allowed a displacement of its own, unknown but
for its standard deviation tau (m), which is estimated from how far the cameras contradict one another:

    covariance of a sighting's residuals = I + tau^2 A A^T,    A: derivatives by the target's position

This is what weighing moments down by the target's speed would do, without the need to know speed or delay.
"""

from __future__ import annotations

import numpy as np

from .observations import Ints
from .pose_misfit import PoseMisfit, pose_misfit
from .projection import Linearised
from .rigid import Array

POSITION = slice(3, 6)
CAUTION = 6.0  # imagined numbers that hold a moment's displacement to that of all
MOST_CHANGE = 4.0  # of tau^2 in one round


def whitened(linear: Linearised, tau: Array) -> Linearised:
    """The same rows after which the residuals are independent again; tau (s,), m."""
    A = linear.by_pose[:, :, POSITION]
    values, vectors = np.linalg.eigh(np.swapaxes(A, 1, 2) @ A)
    values = np.maximum(values, 1e-12 * values[:, -1:] + 1e-300)
    shrink = (1 - 1 / np.sqrt(1 + tau[:, None] ** 2 * values)) / values
    M = (vectors * shrink[:, None]) @ np.swapaxes(vectors, 1, 2)

    def apply(rows: Array) -> Array:
        return rows - A @ (M @ (np.swapaxes(A, 1, 2) @ rows))

    return Linearised(apply(linear.residual[..., None])[..., 0], apply(linear.by_shared), apply(linear.by_pose))


def first_tau(linear: Linearised, misfit: PoseMisfit, freedom: int) -> float:
    """The displacement (m) that makes the residuals' part along it as large as it is, the same for all sightings."""
    A = linear.by_pose[:, :, POSITION]
    information = np.swapaxes(A, 1, 2) @ A
    pull = np.swapaxes(A, 1, 2) @ linear.residual[..., None]
    squares = float((np.swapaxes(pull, 1, 2) @ np.linalg.pinv(information, hermitian=True) @ pull).sum())
    left = max(freedom, 1) / misfit.freedom.sum()  # the share that fitting poses leaves
    excess = squares / left - 3 * len(A)
    return float(np.sqrt(max(excess, 0.0) / np.trace(information, axis1=1, axis2=2).sum()))


def next_tau(tau: Array, linear: Linearised, poses: Ints) -> Array:
    """Better displacements (s,), pose by pose, from what contradiction is left in whitened residuals."""
    misfit = pose_misfit(linear)
    squares, total = np.bincount(poses, misfit.squares), np.bincount(poses, misfit.freedom)
    own = np.zeros(len(total))
    np.maximum.at(own, poses, misfit.freedom)
    ratio = (CAUTION + squares) / (CAUTION + total - own)
    return tau * np.sqrt(np.clip(ratio, 1 / MOST_CHANGE, MOST_CHANGE))[poses]
