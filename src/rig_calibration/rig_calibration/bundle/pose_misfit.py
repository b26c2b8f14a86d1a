"""Do cameras contradict one another by more than the noise of corners explains?

The corners of one sighting can err together as if the target lay elsewhere: because it moved between the exposures of
cameras that are not quite synchronous, because it is bent, because a lens is not quite known. That part of a residual
is its projection on what a change of the target's pose does to the picture. Cameras and targets, too, act on a sighting
only through that pose, so the rest of the residual is noise of single corners, and the two are compared as in an
analysis of variance.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from .observations import Ints
from .projection import Linearised
from .rigid import Array

SINGULAR = 1e-9


@dataclass(frozen=True, eq=False)
class PoseMisfit:
    """squares (s,): squared length, in standard deviations, of the part of each sighting's residual that a change of
    pose would explain; freedom (s,): how many numbers that is (6 or, for a wand, 5)."""

    squares: Array
    freedom: Ints

    def ratio(self, residual: Array, corners: int, poses: Ints, shared: int) -> tuple[float, int]:
        """Variance of the pose-like part over that of the rest (1: corners err independently), and its degrees of
        freedom. residual (s, 2n) weighted; poses (s,): the pose of each; shared: free shared unknowns."""
        freedom = int(self.freedom.sum()) - pose_freedom(poses, self.freedom) - shared
        rest_freedom = 2 * corners - int(self.freedom.sum())
        rest = float((residual**2).sum() - self.squares.sum())
        if freedom <= 0 or rest_freedom <= 0 or rest <= 0:
            return 1.0, max(freedom, 0)
        return float(self.squares.sum() / freedom / (rest / rest_freedom)), freedom


def pose_misfit(linear: Linearised) -> PoseMisfit:
    """The pose-like part of the residuals of each sighting."""
    V = np.swapaxes(linear.by_pose, 1, 2) @ linear.by_pose
    g = (np.swapaxes(linear.by_pose, 1, 2) @ linear.residual[..., None])[..., 0]
    values, vectors = np.linalg.eigh(V)
    along = (np.swapaxes(vectors, 1, 2) @ g[..., None])[..., 0]
    seen = values > SINGULAR * values[:, -1:]
    squares = np.where(seen, along**2 / np.where(seen, values, 1.0), 0.0)
    return PoseMisfit(squares.sum(axis=1), seen.sum(axis=1))


def pose_freedom(poses: Ints, freedom: Ints) -> int:
    """How many numbers the poses that were seen have: six each, five for a wand."""
    most = np.zeros(int(poses.max(initial=-1)) + 1, np.int64)
    np.maximum.at(most, poses, freedom)
    return int(most.sum())
