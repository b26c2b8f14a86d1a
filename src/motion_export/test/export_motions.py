"""Motions with a known course for the tests of exports."""

from __future__ import annotations

import numpy as np

from capture_rig.rigid import rotation_matrix
from motion_export.motion import Motion
from stick_figure.body import Body
from stick_figure.kinematics import forward
from stick_figure.pose import Pose
from stick_figure.skeleton import ANGLE_NAMES, T_POSE_ANGLES

BODY = Body.from_stature(1.75)
RATE_HZ, START_NS = 60.0, 1_700_000_000_000_000_000


def swinging(
    frames: int = 90, gap: tuple[int, int] = (0, 0), bodies: list[Body] | None = None, rate_hz: float | None = None
) -> Motion:
    """A person who walks a curve, leans, swings and bends every joint; the body may change from frame to frame."""
    rng = np.random.default_rng(3)
    low, high = 0.1 + 0.2 * rng.random(18), 0.3 + 0.5 * rng.random(18)
    poses, rows = [], []
    for t in np.linspace(0.0, 4.0, frames):
        angles = T_POSE_ANGLES.copy()
        for slot, name in enumerate(ANGLE_NAMES):
            sign = -1.0 if "elbow" in name else 1.0
            swing = 0.5 * (1.0 + np.sin(t + slot)) if "elbow" in name or "knee" in name else np.sin(t + slot)
            angles[slot] += sign * (low[slot] + (high[slot] - low[slot]) * swing)
        R = rotation_matrix(np.array([0.1 * np.sin(t), 0.2 * np.cos(t), 0.6 * t]))
        poses.append(Pose.from_angles(np.array([0.3 * t, 0.1 * t * t, 1.1]), R, angles))
        rows.append(angles)
    each, kept = bodies or [BODY] * frames, np.delete(np.arange(frames), slice(*gap))
    columns = {
        "points_world": np.array([forward(body, pose) for body, pose in zip(each, poses, strict=True)]),
        "covariance": np.linspace(0.005, 0.02, frames)[:, None, None, None] ** 2 * np.ones((15, 1, 1)) * np.eye(3),
        "angles": np.array(rows),
        "torso_position_world": np.array([pose.position_world for pose in poses]),
        "R_world_torso": np.array([pose.R_world_torso for pose in poses]),
    }
    stamps_ns = START_NS + np.rint(kept * (1e9 / RATE_HZ)).astype(np.int64)
    columns = {name: values[kept] for name, values in columns.items()}
    return Motion.of_samples("take", stamps_ns, np.array(["tracking"] * len(kept)), columns, rate_hz)
