"""Natural postures that somebody who comes in may have, at every heading: where a fit of a first pose may start."""

from __future__ import annotations

import numpy as np

from capture_rig.rigid import rotation_matrix
from stick_figure.body import Body
from stick_figure.pose import T_POSE_ANGLES, Pose
from stick_figure.skeleton import ANGLE_NAMES, HEAD, mirror_angles

HEADINGS = 8  # a fit finds a trunk that is turned by half of an eighth
_HANG = -1.35  # rad, of an arm below the horizontal
# angles of each side (rad); what is not named is the T-pose's. A step has the other side's arm in front.
_STANDING = {"shoulder_x": _HANG}
_FRONT_LEG = {"shoulder_x": _HANG, "shoulder_z": 0.35, "hip_y": -0.45, "knee": 0.15}
_BACK_LEG = {"shoulder_x": _HANG, "shoulder_z": -0.35, "elbow": -0.4, "hip_y": 0.25, "knee": 0.5}
_BENT_ARM = {"shoulder_x": _HANG, "elbow": -1.5}
POSTURES: tuple[tuple[dict[str, float], dict[str, float]], ...] = (
    (_STANDING, _STANDING),
    (_FRONT_LEG, _BACK_LEG),
    (_BACK_LEG, _FRONT_LEG),
    (_BENT_ARM, _BENT_ARM),
    ({"shoulder_z": -1.35}, {"shoulder_z": -1.35}),
    ({}, {}),
)
"""Left and right side: standing, both steps, arms bent, arms forward, T-pose."""


def natural_poses(body: Body, place_world: np.ndarray, crown_world: float) -> list[Pose]:
    """Return every posture at every heading, its trunk above a place (2,) m and its head at a height, m."""
    height = crown_world - body.half_lengths[0] - body.lengths[HEAD]
    return [
        Pose.from_angles(np.r_[place_world, height], rotation_matrix(np.array([0.0, 0.0, heading])), angles)
        for heading in np.arange(HEADINGS) * 2.0 * np.pi / HEADINGS
        for angles in _ANGLES
    ]


def _both(left: dict[str, float], right: dict[str, float]) -> np.ndarray:
    """Return the angles (18,) of a posture."""
    sides = []
    for side in (left, right):
        angles = T_POSE_ANGLES.copy()
        for name, value in side.items():
            angles[ANGLE_NAMES.index(f"left_{name}")] = value
        sides.append(angles)
    is_right = np.array([name.startswith("right") for name in ANGLE_NAMES])
    return np.where(is_right, mirror_angles(sides[1]), sides[0])


_ANGLES = tuple(_both(left, right) for left, right in POSTURES)
