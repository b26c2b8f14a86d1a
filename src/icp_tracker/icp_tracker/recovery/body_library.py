"""Other poses of the whole body: turned round, sides exchanged, or found anew from the hull's place."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from stick_figure.body import Body
from stick_figure.kinematics import forward, inverse
from stick_figure.pose import T_POSE_ANGLES, Pose
from stick_figure.rotations import rotation_matrix
from stick_figure.skeleton import ANGLE_NAMES, mirror_angles

HEADINGS = 8
_WITH_SIDES = [0, 1, 2, 4, 3, 6, 5, 8, 7, 10, 9, 12, 11, 14, 13]  # left and right of every reference point
_WITH_ARMS = [0, 1, 2, 3, 4, 5, 6, 8, 7, 9, 10, 12, 11, 13, 14]  # elbows and hands exchanged
_WITH_LEGS = [0, 1, 2, 3, 4, 5, 6, 7, 8, 10, 9, 11, 12, 14, 13]
# what a person may be found doing, as angles of the left side (rad); the right side mirrors them
STANCES: dict[str, dict[str, float]] = {
    "arms down": {"shoulder_x": -1.35},
    "T-pose": {},
    "arms forward": {"shoulder_z": -1.35},
    "hands up": {"shoulder_x": 1.2},
    "arms bent": {"shoulder_x": -1.2, "elbow": -1.5},
    "squat": {"shoulder_x": -1.2, "hip_y": -1.6, "knee": 1.8},
}


def sides_exchanged(body: Body, pose: Pose) -> Pose:
    """Left and right change names, limbs and trunk stay where they are: the body faces the other way."""
    return inverse(body, forward(body, pose)[_WITH_SIDES], pose)


def about_face(pose: Pose) -> Pose:
    """Every limb where it is on the body, the body facing the other way."""
    return replace(pose, R_world_torso=rotation_matrix(np.pi * pose.R_world_torso[:, 2]) @ pose.R_world_torso)


def arms_exchanged(body: Body, pose: Pose) -> Pose:
    """Left elbow and hand where the right ones are, and the other way round."""
    return inverse(body, forward(body, pose)[_WITH_ARMS], pose)


def legs_exchanged(body: Body, pose: Pose) -> Pose:
    """Left knee and foot where the right ones are, and the other way round."""
    return inverse(body, forward(body, pose)[_WITH_LEGS], pose)


def moved_to(pose: Pose, hull_world: np.ndarray) -> Pose:
    """The pose above the middle of the hull's samples (m, 3)."""
    x, y = np.median(hull_world[:, :2], axis=0)
    return replace(pose, position_world=np.array([x, y, pose.position_world[2]]))


def stances(body: Body, hull_world: np.ndarray) -> list[Pose]:
    """Every stance at every heading, above the middle of the hull (m, 3), its head at the hull's crown."""
    x, y = np.median(hull_world[:, :2], axis=0)
    crown = float(np.percentile(hull_world[:, 2], 99.5))
    height = crown - body.half_lengths[0] - body.lengths[1]
    return [
        Pose.from_angles(np.array([x, y, height]), rotation_matrix(np.array([0.0, 0.0, heading])), angles)
        for heading in np.arange(HEADINGS) * 2.0 * np.pi / HEADINGS
        for angles in STANCE_ANGLES
    ]


def _angles(left: dict[str, float]) -> np.ndarray:
    """Both sides' angles (18,) of a stance."""
    angles = T_POSE_ANGLES.copy()
    for name, value in left.items():
        angles[ANGLE_NAMES.index(f"left_{name}")] = value
    mirrored = mirror_angles(angles)
    for index, name in enumerate(ANGLE_NAMES):
        if name.startswith("right"):
            angles[index] = mirrored[index]
    return angles


STANCE_ANGLES = tuple(_angles(left) for left in STANCES.values())
