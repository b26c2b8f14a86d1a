"""The first estimate, from one measurement and nothing else."""

from __future__ import annotations

import numpy as np

from stick_figure.body import Body
from stick_figure.kinematics import forward, inverse
from stick_figure.pose import T_POSE_ANGLES, Pose
from stick_figure.skeleton import TORSO_POINTS

from .measurement import Measurement
from .motion_model import MotionModel
from .slots import DIMENSION, POSE, VELOCITY, per_slot
from .update import Estimate, Iteration, corrected

NEEDED_TORSO_POINTS = 4
"""Of centre, neck, shoulders and hips; fewer may lie on a line and leave the torso's rotation open."""
TORSO_SD_M = 1.0
TORSO_SD_RAD = 1.0
"""What is known of the torso before its first measurement: it stands about where inverse kinematics puts it."""


def enough_to_start(z: Measurement) -> bool:
    """Whether the visible points fix the torso."""
    return int(z.visible[TORSO_POINTS].sum()) >= NEEDED_TORSO_POINTS


def first_estimate(body: Body, z: Measurement, motion: MotionModel, joint_sd: float, iteration: Iteration) -> Estimate:
    """Pose by inverse kinematics, then one update of a wide prior about it, so that the covariance is the points' own.

    Joints that no visible point bears on keep the T-pose and the standard deviation ``joint_sd`` (rad); the velocity
    is unknown. Needs :func:`enough_to_start`.
    """
    resting = Pose.from_angles(*_torso_of(body, z), T_POSE_ANGLES)
    pose = pose_of_points(body, z, z.visible, resting)
    P = np.zeros((DIMENSION, DIMENSION))
    P[POSE, POSE] = np.diag(per_slot(TORSO_SD_M, TORSO_SD_RAD, joint_sd, joint_sd) ** 2)
    P[VELOCITY, VELOCITY] = np.diag(motion.velocity_variance())
    return corrected(body, Estimate(pose.arrays, np.zeros(24), P), z, z.visible, iteration)


def pose_of_points(body: Body, z: Measurement, chosen: np.ndarray, otherwise: Pose) -> Pose:
    """Inverse kinematics of the chosen points (15,) bool; the rest stands as in the pose ``otherwise``."""
    points = np.where(chosen[:, None], z.points_world, forward(body, otherwise))
    return inverse(body, points, otherwise)


def _torso_of(body: Body, z: Measurement) -> tuple[np.ndarray, np.ndarray]:
    """Position (3,) and rotation (3, 3) of the torso: rigid fit of its visible points (Procrustes)."""
    seen = z.visible[TORSO_POINTS]
    model, data = body.torso_points[seen], z.points_world[TORSO_POINTS][seen]
    U, _, Vt = np.linalg.svd((data - data.mean(0)).T @ (model - model.mean(0)))
    R = U @ np.diag([1.0, 1.0, np.linalg.det(U @ Vt)]) @ Vt
    return data.mean(0) - R @ model.mean(0), R
