"""Prediction and correction of the articulated EKF (thesis Tables 5.5 and 5.7) on the manifold of poses.

The covariance belongs to an error vector of 48 slots: 24 of the pose's tangent (`stick_figure.pose`), 24 of its
velocity. The pose itself stays a set of rotation matrices, so nothing needs normalising and no gimbal locks.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from stick_figure.body import Body
from stick_figure.pose import Pose
from stick_figure.skeleton import POINT_STICK

from .compiled import joseph, mahalanobis, point_covariances, points_and_jacobian, relinearised
from .covariance import symmetrised
from .measurement import Measurement
from .slots import POSE, VELOCITY


@dataclass(frozen=True, eq=False)
class Estimate:
    """Mean and covariance of the state.

    velocity : (24,) rates of the pose's tangent, m/s and rad/s
    covariance : (48, 48), pose before velocity
    """

    pose: Pose
    velocity: np.ndarray
    covariance: np.ndarray


def predicted(estimate: Estimate, F: np.ndarray, Q: np.ndarray) -> Estimate:
    """The estimate one transition later (thesis Table 5.5, from the a-posteriori state and covariance)."""
    x, P = estimate, estimate.covariance
    return Estimate(
        pose=x.pose.retract(F[POSE, VELOCITY] @ x.velocity),
        velocity=F[VELOCITY, VELOCITY] @ x.velocity,
        covariance=symmetrised(F @ P @ F.T + Q),
    )


def corrected(
    body: Body, prior: Estimate, z: Measurement, chosen: np.ndarray, iterations: int, start: Pose | None = None
) -> Estimate:
    """The estimate after the chosen points (15,) bool of z: iterated EKF update (thesis Table 5.7, relinearised).

    Each iteration is one Gauss-Newton step on the sum of the points' and the prior's squared residuals (Bell &
    Cathey 1993). ``start`` is the pose of the first linearisation; the prior's own by default.
    """
    P, points = prior.covariance, np.flatnonzero(chosen)
    pose = copy_of(prior.pose if start is None else start)
    H, SH, innovation = relinearised(
        prior.pose.arrays, pose.arrays, body.lengths, body.stick_origins_torso, POINT_STICK,
        np.ascontiguousarray(P[POSE, POSE]), z.points_world, z.covariance, points, iterations,
    )  # fmt: skip
    K = P[:, POSE] @ SH.T  # P H' S^-1; H has no columns for the velocity
    x = K @ innovation
    return Estimate(pose, prior.velocity + x[VELOCITY], joseph(P, K, H, z.covariance[points]))


def innovation_distances(body: Body, prior: Estimate, z: Measurement) -> np.ndarray:
    """(15,) squared Mahalanobis distance of each visible point from its prediction; 0 for the others.

    Each is chi-square with 3 degrees of freedom while model and covariances are right.
    """
    h, H = points_and_jacobian(body, prior.pose)
    S = point_covariances(H, prior.covariance[POSE, POSE]) + z.covariance
    return np.where(z.visible, mahalanobis(z.points_world - h, S), 0.0)


def copy_of(pose: Pose) -> Pose:
    """A pose with arrays of its own."""
    return Pose(pose.position_world, pose.R_world_torso, pose.R_joints, pose.hinges)
