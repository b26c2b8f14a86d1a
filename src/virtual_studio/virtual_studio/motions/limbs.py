"""Joint angles for limbs: both sides from one, arms that reach a place, legs that stand under the body."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from stick_figure.body import Body
from stick_figure.kinematics import forward, inverse
from stick_figure.pose import Pose
from stick_figure.skeleton import ANGLE_NAMES, L_FOREARM, L_UPPER_ARM, T_POSE_ANGLES, mirror_angles

Array = NDArray[np.float64]
Side = Callable[[Array, Array, tuple[str, ...]], Array]
"""with_left or with_right."""

L_SHOULDER_POINT, L_ELBOW_POINT, L_HAND_POINT = 3, 7, 11
ARM = ("shoulder_x", "shoulder_z", "shoulder_y", "elbow")
NEARLY_STRAIGHT = 0.995


def both_sides(**left: float) -> Array:
    """Makes angles (18,) of both sides from the left side's (and the neck's): the right side mirrors it."""
    angles = np.zeros(18)
    for name, value in left.items():
        angles[ANGLE_NAMES.index(name if name.startswith("neck") else f"left_{name}")] = value
    right = np.array([name.startswith("right") for name in ANGLE_NAMES])
    return np.where(right, mirror_angles(angles), angles)


def left(name: str) -> int:
    """Returns the slot of a left joint's angle."""
    return ANGLE_NAMES.index(f"left_{name}")


def right(name: str) -> int:
    """Returns the slot of a right joint's angle."""
    return ANGLE_NAMES.index(f"right_{name}")


def with_left(angles: Array, other: Array, names: tuple[str, ...]) -> Array:
    """Copies angles (18,), with the named left joints of another pose."""
    slots = [left(name) for name in names]
    mixed = angles.copy()
    mixed[slots] = other[slots]
    return mixed


def with_right(angles: Array, other: Array, names: tuple[str, ...]) -> Array:
    """Copies angles (18,), with the named right joints of another pose."""
    slots = [right(name) for name in names]
    mixed = angles.copy()
    mixed[slots] = other[slots]
    return mixed


def reaching(body: Body, hand_torso: tuple[float, float, float], elbow_torso: tuple[float, float, float]) -> Array:
    """Finds angles (18,) with the left hand's tip at a place in the torso frame (m), and the right one mirrored.

    The elbow lies as near as it can to `elbow_torso`; a place out of reach is approached as far as the arm goes.
    """
    points = forward(body, Pose.from_angles(np.zeros(3), np.eye(3), T_POSE_ANGLES))
    shoulder, upper, fore = points[L_SHOULDER_POINT], body.lengths[L_UPPER_ARM], body.lengths[L_FOREARM]
    to_hand = np.array(hand_torso) - shoulder
    distance = np.clip(np.linalg.norm(to_hand), abs(upper - fore) / NEARLY_STRAIGHT, (upper + fore) * NEARLY_STRAIGHT)
    along = to_hand / np.linalg.norm(to_hand)
    aside = np.array(elbow_torso) - shoulder
    aside -= (aside @ along) * along
    aside /= np.linalg.norm(aside)
    foot = (upper**2 - fore**2 + distance**2) / (2.0 * distance)
    points[L_ELBOW_POINT] = shoulder + foot * along + np.sqrt(max(upper**2 - foot**2, 0.0)) * aside
    points[L_HAND_POINT] = shoulder + distance * along
    angles = inverse(body, points).angles()
    return both_sides(**{name: angles[left(name)] for name in ARM})


def legs(thigh: float, calf: float, lean: float = 0.0, apart: float = 0.04) -> Array:
    """Makes angles (18,) of legs under a torso that leans forward by `lean` rad, arms and neck zero.

    thigh: how far the knees are ahead of the hips, calf: how far the ankles are behind the knees, both rad from the
    vertical; apart: thighs outward, rad.
    """
    return both_sides(hip_x=apart, hip_y=-thigh - lean, knee=thigh + calf)
