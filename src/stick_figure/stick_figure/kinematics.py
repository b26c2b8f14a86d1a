"""Forward and inverse kinematics of the stick figure, and the rates of its angles (thesis 5.1, 5.2, corrected)."""

from __future__ import annotations

import math

import numpy as np

from capture_rig.errors import InputError
from capture_rig.kernel import njit
from capture_rig.rigid import rigid_transform

from . import kernels
from .body import Body
from .pose import Pose
from .rotations import GIMBAL_SINE, Array, ball_rates, ball_rotation, excess_over_range, wrap_into_range
from .skeleton import BALL_ANGLES, HINGE_ANGLES, POINT_NAMES, T_POSE_ANGLES, TORSO_POINTS

_LIMB_POINTS = np.array([[3, 7, 11], [4, 8, 12], [5, 9, 13], [6, 10, 14]])
"""(4, 3) points at the joint, middle and end of each limb."""
_SEGMENTS = np.vstack([[[2, 1]], _LIMB_POINTS[:, :2], _LIMB_POINTS[:, 1:]])


def inverse(body: Body, points_world: Array, previous: Pose | None = None) -> Pose:
    """Return the pose of reference points (15, 3), world frame, metres: the exact inverse of `kinematics.forward`.

    The torso is the rigid fit to its six points; limbs follow from directions, so limbs of other lengths than the
    body's do no harm. Undetermined angles (the twist of a straight arm or leg, the first angle where the limb points
    along its axis) keep their value of `previous`, or of the T-pose. Elbows and knees bend the right way.
    Raises InputError for a wrong shape, a point that is not finite, or two joints of one limb in the same place.
    """
    points = np.asarray(points_world, float)
    _check(points)
    R0, t0 = rigid_transform(body.torso_points, points[TORSO_POINTS])
    remembered = T_POSE_ANGLES if previous is None else previous.angles()
    R_joints, hinges = np.empty((5, 3, 3)), np.empty(4)
    _joints(points @ R0, remembered, R_joints, hinges)
    return Pose(t0, R0, R_joints, hinges)


@njit(cache=True)
def _joints(points_torso, remembered, R_joints, hinges):
    """R_joints (5, 3, 3), hinges (4,) <- from the points (15, 3) turned into the torso's axes."""
    head = points_torso[1] - points_torso[2]
    kernels.neck_from_direction(head[0], head[1], head[2], R_joints[0])
    for limb in range(4):
        joint, middle, end = _LIMB_POINTS[limb]
        upper = _unit(points_torso[middle] - points_torso[joint])
        lower = _unit(points_torso[end] - points_torso[middle])
        hinges[limb] = _limb(limb, upper, lower, remembered, R_joints[1 + limb])


@njit(cache=True)
def _limb(limb, upper, lower, remembered, R):
    """R (3, 3) <- ball rotation of an arm (0, 1) or leg (2, 3) from two unit directions; returns the hinge's angle."""
    arm = limb < 2
    along = np.dot(lower, upper)
    across = lower - along * upper
    bend = math.sqrt(np.dot(across, across))
    if bend < GIMBAL_SINE:  # a straight limb's points do not show the twist of its upper part
        _straight_limb(limb, upper, remembered, R)
        if along > 0.0:
            return 0.0
        return -math.pi if arm else math.pi
    across /= bend
    if arm:  # forearm in the upper arm's frame: (-sin h, cos h, 0), h <= 0, so it bends towards +x
        R[:, 0], R[:, 1], R[:, 2] = across, upper, np.cross(across, upper)
        return -math.atan2(bend, along)
    # calf in the thigh's frame: (-sin h, 0, -cos h), h >= 0, so it bends towards -x
    R[:, 0], R[:, 1], R[:, 2] = -across, np.cross(upper, across), -upper
    return math.atan2(bend, along)


@njit(cache=True)
def _straight_limb(limb, upper, remembered, R):
    """R (3, 3) <- a straight limb: the first two angles from its direction, the twist remembered.

    Both covers point the same way but carry the remembered twist differently: the one inside the joint ranges is
    chosen, or the one nearer the remembered angles.
    """
    x, y, z = upper
    slots = BALL_ANGLES[1 + limb]
    level = math.hypot(y, z)
    first = remembered[slots[0]]
    if level > GIMBAL_SINE:
        first = math.atan2(z, y) if limb < 2 else math.atan2(y, -z)
    second = math.atan2(-x, level)
    angles, values, best_cost = remembered.copy(), np.empty(3), math.inf
    for cover in range(2):
        values[0] = wrap_into_range(first + cover * math.pi, slots[0])
        values[1] = wrap_into_range(second if cover == 0 else math.pi - second, slots[1])
        values[2] = remembered[slots[2]]
        cost = 0.0 if excess_over_range(values, slots) == 0.0 else 100.0
        for k in range(3):
            cost += abs(math.sin(0.5 * (values[k] - remembered[slots[k]])))
        if cost < best_cost:
            best_cost = cost
            for k in range(3):
                angles[slots[k]] = values[k]
    ball_rotation(1 + limb, angles, R)


@njit(cache=True)
def _unit(vector):
    return vector / math.sqrt(np.dot(vector, vector))


def _check(points: Array) -> None:
    if points.shape != (15, 3):
        raise InputError(f"reference points have shape {points.shape}", remedy="Expected (15, 3).")
    bad = ~np.isfinite(points).all(axis=1)
    if bad.any():
        names = ", ".join(POINT_NAMES[i] for i in np.flatnonzero(bad))
        raise InputError(f"points are not finite: {names}", remedy="Give all 15 points or drop the frame.")
    lengths = np.linalg.norm(points[_SEGMENTS[:, 1]] - points[_SEGMENTS[:, 0]], axis=1)
    if lengths.min() < 1e-6:
        start, end = _SEGMENTS[np.argmin(lengths)]
        raise InputError(f"{POINT_NAMES[start]} and {POINT_NAMES[end]} are in the same place", remedy="Drop the frame.")


def forward(body: Body, pose: Pose) -> Array:
    """Return the 15 reference points (15, 3), world frame, metres (thesis Table 5.2 with the hips' third angle)."""
    return _points(pose.arrays, body.lengths, body.stick_origins_torso)


def farthest_apart_m(body: Body, pose: Pose, other: Pose) -> float:
    """Return the largest distance, m, of corresponding reference points of two poses."""
    return float(np.linalg.norm(forward(body, pose) - forward(body, other), axis=1).max())


@njit(cache=True)
def _points(pose, lengths, origins):
    _, _, A, B = kernels.place_sticks(pose, lengths, origins)
    points = np.empty((15, 3))
    kernels.reference_points(A, B, pose[0], points)
    return points


def sticks(body: Body, pose: Pose) -> Array:
    """Start and end of the ten sticks (10, 2, 3), world frame, metres."""
    _, _, A, B = kernels.place_sticks(pose.arrays, body.lengths, body.stick_origins_torso)
    return np.stack([A, B], axis=1)


def stick_frames(pose: Pose) -> Array:
    """Rotations (10, 3, 3) of the sticks' own frames, in which they lie along `skeleton.STICK_AXIS`, to the world."""
    G, axes = np.empty((10, 3, 3)), np.empty((18, 3))
    kernels.stick_frames(pose.R_world_torso, pose.R_joints, pose.hinges, G, axes)
    return G


@njit(cache=True)
def rates_of_angles(hinges, velocity, angles):
    """Return the rates (18,) rad/s of the angles (18,), for a tangent velocity (24,) and the pose's own hinges (4,).

    Near gimbal lock, where the exact rates grow without bound, a damped inverse is used.
    """
    rates, omega = np.zeros(18), np.empty(3)
    for ball in range(5):
        for k in range(3):
            slot = kernels.SLOT_OF_JOINT_AXIS[ball, k]
            omega[k] = velocity[slot] if slot >= 0 else 0.0
        ball_rates(ball, angles, omega, rates)
    signs = hinge_signs(hinges, angles)
    for h in range(4):
        rates[HINGE_ANGLES[h]] = signs[h] * velocity[kernels.HINGE_SLOT[h]]
    return rates


@njit(cache=True)
def hinge_signs(hinges, angles):
    """Return (4,) -1 where the angles describe a hinge the other way round than the pose's own hinges (4,), else 1."""
    signs = np.ones(4)
    for h in range(4):
        reported = angles[HINGE_ANGLES[h]]
        if abs(reported + hinges[h]) < abs(reported - hinges[h]):
            signs[h] = -1.0
    return signs
