"""The pose in the joints of REP-155 (humans in ROS): other axes and another zero pose, converted through rotations.

In the zero pose of the `human_description` URDF all limbs hang along -z and every frame is parallel to the body's
(x forward, y left, z up). Its joints, in order from the trunk, turn about

    head      r +x, y +z, p -y
    shoulder  left: y -z, p +x, r +z;  right: y +z, p -x, r -z;  elbow -y
    hip       y -z, p left +x, right -x, r -y;  knee -y
    waist     +y; our trunk is one stick, so it stays 0
"""

from __future__ import annotations

import numpy as np

from stick_figure.pose import Pose

HRI_JOINT_NAMES = (
    "waist",
    "r_head",
    "y_head",
    "p_head",
    "l_y_shoulder",
    "l_p_shoulder",
    "l_r_shoulder",
    "l_elbow",
    "r_y_shoulder",
    "r_p_shoulder",
    "r_r_shoulder",
    "r_elbow",
    "l_y_hip",
    "l_p_hip",
    "l_r_hip",
    "l_knee",
    "r_y_hip",
    "r_p_hip",
    "r_r_hip",
    "r_knee",
)

SINGULAR_SINE = 1e-6
SHOULDER_PITCH_LOW = -0.4
"""rad; lower limit of p_shoulder in the URDF."""

_ARM_TO_HANGING = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]])
"""Columns: the hanging arm's x, y, z in the stick figure's arm frame, where the arm points along +y."""


def hri_angles(pose: Pose, previous: np.ndarray | None = None) -> np.ndarray:
    """The joints of `HRI_JOINT_NAMES` (20,), rad.

    ``previous`` (20,) keeps them continuous where the shoulder's angles are not unique: with the arm hanging, y and r
    turn about the same axis.
    """
    neck, *limbs = pose.R_joints
    before = np.zeros(20) if previous is None else previous
    angles = np.zeros(20)
    angles[1:4] = _head(neck)
    for side, outward in enumerate((1.0, -1.0)):
        arm, leg = slice(4 + 4 * side, 7 + 4 * side), slice(12 + 4 * side, 15 + 4 * side)
        angles[arm] = _shoulder(limbs[side] @ _ARM_TO_HANGING, outward, before[arm])
        angles[leg] = _hip(limbs[2 + side], outward)
    angles[[7, 11]] = -pose.hinges[:2]  # our elbows bend about +z of the arm, which hangs as +y
    angles[[15, 19]] = -pose.hinges[2:]
    return angles


def body_frame(pose: Pose, half_torso: float) -> tuple[np.ndarray, np.ndarray]:
    """Origin (3,) m, between the hips, and rotation (3, 3) of the frame body_ID in the world (x forward, z up)."""
    return pose.position_world - half_torso * pose.R_world_torso[:, 2], pose.R_world_torso


def _head(R: np.ndarray) -> tuple[float, float, float]:
    """r, y, p with R = Rx(r) Rz(y) Ry(-p)."""
    yaw = np.arctan2(-R[0, 1], np.hypot(R[0, 0], R[0, 2]))
    return np.arctan2(R[2, 1], R[1, 1]), yaw, -np.arctan2(R[0, 2], R[0, 0])


def _shoulder(R: np.ndarray, outward: float, previous: np.ndarray) -> np.ndarray:
    """y, p, r with R = Rz(-s y) Rx(s p) Rz(s r), s = ``outward`` (+1 left, -1 right)."""
    if outward < 0.0:  # mirrored in the sagittal plane (y -> -y), the right arm is a left arm
        R = R * np.outer([1.0, -1.0, 1.0], [1.0, -1.0, 1.0])
    sine = np.hypot(R[0, 2], R[1, 2])
    p = np.arctan2(sine, R[2, 2])
    if sine < SINGULAR_SINE:  # arm straight down (or up): only r -+ y is seen
        y = previous[0]
        turn = np.arctan2(R[1, 0], R[0, 0])
        return np.array([y, p, _wrapped(turn + y if R[2, 2] > 0.0 else -turn - y)])
    first = np.array([-np.arctan2(R[0, 2], -R[1, 2]), p, np.arctan2(R[2, 0], R[2, 1])])
    second = np.array([_wrapped(first[0] + np.pi), -p, _wrapped(first[2] + np.pi)])
    if second[1] < SHOULDER_PITCH_LOW or _distance(first, previous) <= _distance(second, previous):
        return first
    return second


def _hip(R: np.ndarray, outward: float) -> tuple[float, float, float]:
    """y, p, r with R = Rz(-y) Rx(s p) Ry(-r), s = ``outward``."""
    pitch = np.arctan2(R[2, 1], np.hypot(R[0, 1], R[1, 1]))
    return np.arctan2(R[0, 1], R[1, 1]), outward * pitch, -np.arctan2(-R[2, 0], R[2, 2])


def _distance(a: np.ndarray, b: np.ndarray) -> float:
    return float(np.abs(_wrapped(a - b)).sum())


def _wrapped(angle: np.ndarray) -> np.ndarray:
    return (angle + np.pi) % (2.0 * np.pi) - np.pi
