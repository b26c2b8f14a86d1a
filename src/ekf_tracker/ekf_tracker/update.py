"""Prediction and correction of the articulated EKF (thesis Tables 5.5 and 5.7) on the manifold of poses.

The covariance belongs to an error vector of 48 slots: 24 of the pose's tangent (`stick_figure.pose`), 24 of its
velocity. The pose itself stays a set of rotation matrices, so nothing needs normalising and no gimbal locks.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from stick_figure.body import Body
from stick_figure.pose import HINGE_MARGIN_RAD, Pose

from .compiled import advance, correct
from .linearised import squared_distances
from .measurement import Measurement
from .motion_model import Transition

Arrays = tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]


@dataclass(frozen=True, eq=False)
class Estimate:
    """Mean and covariance of the state.

    arrays : the pose as `stick_figure.pose.Pose.arrays` names it
    velocity : (24,) rates of the pose's tangent, m/s and rad/s
    covariance : (48, 48), pose before velocity
    """

    arrays: Arrays
    velocity: np.ndarray
    covariance: np.ndarray

    @property
    def pose(self) -> Pose:
        """The pose, with arrays of its own."""
        return Pose(*self.arrays)


@dataclass(frozen=True)
class Iteration:
    """How an update is iterated: relinearisations at most, weight of a joint limit (1/rad^2), and how far (rad) an
    elbow or knee may pass straight before it is described the other way round."""

    most: int
    limit_weight: float = 0.0
    hinge_margin_rad: float = HINGE_MARGIN_RAD


def predicted(estimate: Estimate, transition: Transition, joint_sd_cap_rad: float) -> Estimate:
    """The estimate one transition later (thesis Table 5.5, from the a-posteriori state and covariance).

    No joint's pose is left with a standard deviation above the cap (rad): see `compiled.cap_joints`.
    """
    x = estimate
    return Estimate(*advance(x.arrays, x.velocity, x.covariance, *transition, joint_sd_cap_rad))


def corrected(
    body: Body, prior: Estimate, z: Measurement, chosen: np.ndarray, iteration: Iteration, start: Pose | None = None
) -> Estimate:
    """The estimate after the chosen points (15,) bool of z: iterated EKF update (thesis Table 5.7, relinearised).

    Each iteration is one Gauss-Newton step on the sum of the points' and the prior's squared residuals (Bell &
    Cathey 1993). ``start`` is the pose of the first linearisation; the prior's own by default. Joint limits move the
    mean but are left out of the covariance: that an arm cannot be there does not say where it is. ValueError when the
    prior's covariance is not positive definite.
    """
    return Estimate(
        *correct(
            prior.arrays,
            prior.arrays if start is None else start.arrays,
            prior.velocity,
            prior.covariance,
            body.lengths,
            body.stick_origins_torso,
            z.points_world,
            z.covariance,
            chosen,
            iteration.limit_weight,
            iteration.most,
            iteration.hinge_margin_rad,
        )
    )


def innovation_distances(body: Body, prior: Estimate, z: Measurement) -> np.ndarray:
    """(15,) squared Mahalanobis distance of each visible point from its prediction; 0 for the others.

    Each is chi-square with 3 degrees of freedom while model and covariances are right.
    """
    lengths, origins = body.lengths, body.stick_origins_torso
    return squared_distances(prior.arrays, lengths, origins, prior.covariance, z.points_world, z.covariance, z.visible)
