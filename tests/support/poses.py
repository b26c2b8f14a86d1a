"""Poses for tests: of angles by name, and random ones within the ranges of the joints."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from scipy.spatial.transform import Rotation

from stick_figure.pose import T_POSE_ANGLES, Pose
from stick_figure.skeleton import ANGLE_HIGH, ANGLE_LOW, ANGLE_NAMES

MIRRORED_POINTS = [0, 1, 2, 4, 3, 6, 5, 8, 7, 10, 9, 12, 11, 14, 13]
"""The reference points with left and right exchanged."""


def angles_with(otherwise: np.ndarray = T_POSE_ANGLES, **changed: float) -> np.ndarray:
    """Angles (18,) rad, some of them by name."""
    angles = np.array(otherwise, float)
    for name, value in changed.items():
        angles[ANGLE_NAMES.index(name)] = value
    return angles


def pose_with(otherwise: np.ndarray = T_POSE_ANGLES, at: Iterable[float] = (0.0, 0.0, 1.1), **changed: float) -> Pose:
    """An upright pose of such angles."""
    return Pose.from_angles(np.array(list(at)), np.eye(3), angles_with(otherwise, **changed))


def random_pose(rng: np.random.Generator, margin: float = 0.0) -> Pose:
    """A pose anywhere, turned anyhow, every angle at least ``margin`` rad within its range."""
    angles = rng.uniform(ANGLE_LOW + margin, ANGLE_HIGH - margin)
    return Pose.from_angles(rng.normal(size=3), Rotation.random(random_state=rng).as_matrix(), angles)
