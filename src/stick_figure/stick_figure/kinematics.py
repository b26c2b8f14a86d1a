"""Forward and inverse kinematics of the stick figure and the Jacobians of its points (thesis 5.1, 5.2, corrected)."""

from __future__ import annotations

import numpy as np
from numba import njit

from . import kernels
from .body import Body
from .euler import ball_rates, euler_axes
from .inverse import inverse
from .pose import Pose
from .rotations import Array
from .skeleton import BALL_ANGLES, HINGE_ANGLES, POINT_STICK

__all__ = ["angle_jacobian", "angle_rates", "forward", "inverse", "jacobian", "sticks"]


def forward(body: Body, pose: Pose) -> Array:
    """The 15 reference points (15, 3), world frame, metres (thesis Table 5.2 with the hips' third angle)."""
    _, _, A, B = _placed(body, pose)
    points = np.empty((15, 3))
    kernels.reference_points(A, B, pose.position_world, points)
    return points


def sticks(body: Body, pose: Pose) -> Array:
    """Start and end of the ten sticks (10, 2, 3), world frame, metres."""
    _, _, A, B = _placed(body, pose)
    return np.stack([A, B], axis=1)


def jacobian(body: Body, pose: Pose) -> Array:
    """Derivative (15, 3, 24) of the 15 points with respect to the pose's tangent (`Pose.retract`)."""
    _, axes, A, B = _placed(body, pose)
    return _points_jacobian(A, B, pose.position_world, axes)


def angle_jacobian(body: Body, pose: Pose, angles: Array | None = None) -> Array:
    """Derivative (15, 3, 24) of the 15 points with respect to p1, the torso's rotation increment and the 18 angles.

    Thesis Table 5.8, p1's row corrected: the column of theta_k is a_k x (p - o_k), a_k the joint's world axis and
    o_k its pivot, for the points downstream. `angles` defaults to the pose's own.
    """
    angles = pose.angles() if angles is None else np.ascontiguousarray(angles, float)
    _, axes, A, B = _placed(body, pose)
    axes[HINGE_ANGLES] *= _hinge_signs(pose, angles)[:, None]
    axes_torso = np.empty((3, 3))
    for ball, slots in enumerate(BALL_ANGLES):
        euler_axes(ball, angles, axes_torso)
        axes[slots[slots >= 0]] = (axes_torso @ pose.R_world_torso.T)[slots >= 0]
    return _points_jacobian(A, B, pose.position_world, axes)


def angle_rates(pose: Pose, tangent_velocity: Array, angles: Array | None = None) -> Array:
    """Rates (18,) of the Euler angles, rad/s, of a pose that moves with a tangent velocity (24,) per second.

    Near gimbal lock (where the exact rates grow without bound) a damped inverse is used. `angles` defaults to the
    pose's own; give the published ones so that rates and angles describe the same cover.
    """
    angles = pose.angles() if angles is None else np.ascontiguousarray(angles, float)
    velocity = np.asarray(tangent_velocity, float)
    rates = np.zeros(18)
    rates[HINGE_ANGLES] = _hinge_signs(pose, angles) * velocity[6 + HINGE_ANGLES]
    for ball in range(5):
        slots = kernels.SLOT_OF_JOINT_AXIS[ball]
        omega = np.where(slots >= 0, velocity[slots], 0.0)
        ball_rates(ball, angles, omega, rates)
    return rates


@njit(cache=True)
def _points_jacobian(A, B, t0, axes):
    """(15, 3, 24) derivative of the reference points for joints that turn about the world axes (18, 3)."""
    result, points = np.zeros((15, 3, 24)), np.empty((15, 3))
    columns, slots = np.empty((3, 11)), np.empty(11, np.int64)
    kernels.reference_points(A, B, t0, points)
    for p in range(15):
        n = kernels.point_jacobian(POINT_STICK[p], points[p], t0, A, axes, columns, slots)
        for k in range(n):
            result[p, :, slots[k]] = columns[:, k]
    return result


def _hinge_signs(pose: Pose, angles: Array) -> Array:
    """(4,) -1 where the angles describe a hinge the other way round than the pose's matrices."""
    reported = angles[HINGE_ANGLES]
    return np.where(np.abs(reported + pose.hinges) < np.abs(reported - pose.hinges), -1.0, 1.0)


def _placed(body: Body, pose: Pose) -> tuple[Array, Array, Array, Array]:
    """Stick frames G (10, 3, 3), joint axes (18, 3), stick starts A and ends B (10, 3), all in the world."""
    G, axes = np.empty((10, 3, 3)), np.zeros((18, 3))
    A, B = np.empty((10, 3)), np.empty((10, 3))
    kernels.stick_frames(pose.R_world_torso, pose.R_joints, pose.hinges, G, axes)
    kernels.stick_ends(G, pose.position_world, body.lengths, body.stick_origins_torso, A, B)
    return G, axes, A, B
