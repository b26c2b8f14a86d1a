"""Names, numbering and joint ranges of the stick figure (thesis 5.1, Tables 5.1 to 5.3; Mikic's limb numbering).

Torso and world frames follow REP-103: x forward, y left, z up, metres and radians. All numbering here is 0-based:
thesis point p1 is row 0, theta1 is slot 0. Beyond the thesis the hips have a third angle, the rotation of the
thigh about itself: with two angles the knee's axis is tied to the thigh's direction and real feet are out of reach.
"""

from __future__ import annotations

import numpy as np

STICK_NAMES = (
    *("torso", "head", "left_upper_arm", "right_upper_arm", "left_thigh", "right_thigh"),
    *("left_forearm", "right_forearm", "left_calf", "right_calf"),
)
TORSO, HEAD, L_UPPER_ARM, R_UPPER_ARM, L_THIGH, R_THIGH, L_FOREARM, R_FOREARM, L_CALF, R_CALF = range(10)

PARENT = np.array([-1, 0, 0, 0, 0, 0, 2, 3, 4, 5])
"""(10,) stick that carries each stick; -1 for the torso."""
PREORDER = (0, 1, 2, 6, 3, 7, 4, 8, 5, 9)
"""Order in which the hierarchical fit visits the sticks: parents first, each limb to its end."""
STICK_AXIS = np.array([2, 2, 1, 1, 2, 2, 1, 1, 2, 2])
"""(10,) coordinate axis along which each stick lies in its own frame (arms y, the rest z)."""
STICK_SIGN = np.array([1.0, 1.0, 1.0, 1.0, -1.0, -1.0, 1.0, 1.0, -1.0, -1.0])
"""(10,) direction along that axis: legs point down; both arms point along +y of their own frame."""

POINT_NAMES = (
    *("torso", "head", "neck", "left_shoulder", "right_shoulder", "left_hip", "right_hip"),
    *("left_elbow", "right_elbow", "left_knee", "right_knee", "left_hand", "right_hand", "left_foot", "right_foot"),
)
POINT_STICK = np.array([0, 1, 0, 0, 0, 0, 0, 2, 3, 4, 5, 6, 7, 8, 9])
"""(15,) stick to which each reference point is fixed."""
TORSO_POINTS = np.array([0, 2, 3, 4, 5, 6])
"""Reference points that are rigid with the torso: centre, neck, shoulders, hips."""

_PI = np.pi
# Thresholds: from thesis Table 5.1, the shoulders' z cut to +-pi/2 so that a direction has one description.
_RANGES = {
    "neck_x": (-_PI / 2, _PI / 2),
    "neck_y": (-_PI / 2, _PI / 2),
    "left_shoulder_x": (-_PI, _PI),
    "right_shoulder_x": (0.0, 2 * _PI),
    "left_shoulder_z": (-_PI / 2, _PI / 2),
    "right_shoulder_z": (-_PI / 2, _PI / 2),
    "left_shoulder_y": (-_PI / 2, 3 * _PI / 4),
    "right_shoulder_y": (-3 * _PI / 4, _PI / 2),
    "left_elbow": (-_PI, 0.0),
    "right_elbow": (-_PI, 0.0),
    "left_hip_x": (-_PI / 3, _PI / 2),
    "right_hip_x": (-_PI / 2, _PI / 3),
    "left_hip_y": (-_PI, _PI / 2),
    "right_hip_y": (-_PI, _PI / 2),
    "left_knee": (0.0, _PI),
    "right_knee": (0.0, _PI),
    "left_hip_z": (-_PI / 3, _PI / 3),
    "right_hip_z": (-_PI / 3, _PI / 3),
}
ANGLE_NAMES = tuple(_RANGES)
"""theta1 to theta16 in the thesis's order, then the third angle of the left and right hip."""
ANGLE_LOW, ANGLE_HIGH = (np.array(ends) for ends in zip(*_RANGES.values(), strict=True))
"""(18,) rad, the ends of each angle's range."""
T_POSE_ANGLES = np.zeros(18)
"""(18,) rad. Arms stretched sideways; the right arm points along +y of its own frame, hence theta4 = pi."""
T_POSE_ANGLES[3] = _PI

TANGENT_NAMES = ("torso_x", "torso_y", "torso_z", "torso_rx", "torso_ry", "torso_rz", *ANGLE_NAMES)
"""The 24 tangent slots; a ball joint's slots are increments about the torso's x, y, z (not Euler angles)."""
TORSO_POSITION = slice(0, 3)
JOINTS = slice(6, 24)

BALL_NAMES = ("neck", "left_shoulder", "right_shoulder", "left_hip", "right_hip")
BALL_ANGLES = np.array([[0, 1, -1], [2, 4, 6], [3, 5, 7], [10, 12, 16], [11, 13, 17]])
"""(5, 3) angle slots of each ball joint in the order they are applied; -1 where the neck has none."""
BALL_EULER_AXES = np.array([[0, 1, -1], [0, 2, 1], [0, 2, 1], [0, 1, 2], [0, 1, 2]])
"""(5, 3) coordinate axes of those angles: neck Rx Ry, shoulders Rx Rz Ry, hips Rx Ry Rz."""
HINGE_NAMES = ("left_elbow", "right_elbow", "left_knee", "right_knee")
HINGE_ANGLES = np.array([8, 9, 14, 15])
"""(4,) angle slots of the hinges: elbows Rz, knees Ry."""

_MIRROR_SLOT = np.array([0, 1, 3, 2, 5, 4, 7, 6, 9, 8, 11, 10, 13, 12, 15, 14, 17, 16])
_MIRROR_SIGN = np.array([-1, 1, -1, -1, 1, 1, -1, -1, 1, 1, -1, -1, 1, 1, 1, 1, -1, -1.0])
_IS_RIGHT = np.array([name.startswith("right") for name in ANGLE_NAMES])
_MIRROR_OFFSET = np.zeros(18)
_MIRROR_OFFSET[[2, 3]] = _PI


def mirror_angles(angles: np.ndarray) -> np.ndarray:
    """Angles (..., 18) of the pose reflected in the torso's x-z plane: left and right change places.

    theta4 = pi - theta3, theta8 = -theta7, theta12 = -theta11, theta1 -> -theta1, hip z -> -hip z, others equal.
    """
    return _MIRROR_OFFSET + _MIRROR_SIGN * np.asarray(angles, float)[..., _MIRROR_SLOT]


def angles_of_sides(left: np.ndarray, right: np.ndarray) -> np.ndarray:
    """Angles (18,) of a pose from its left side's and, as if they were the left's, its right side's (18,) each."""
    return np.where(_IS_RIGHT, mirror_angles(right), left)
