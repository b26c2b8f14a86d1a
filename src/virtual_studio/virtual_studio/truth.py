"""The truth of a session as truth.csv: points of the stick figure, its 18 angles, and the torso's pose.

Points carry the names rendered sessions use (left is the person's left), metres; angles are in radians.
"""

from __future__ import annotations

import csv
from pathlib import Path

import numpy as np

from stick_figure.body import Body
from stick_figure.kinematics import forward
from stick_figure.rotations import rotation_vector
from stick_figure.skeleton import ANGLE_NAMES

from .motion import Motion

POINT_COLUMNS = {
    "neck": 2,
    "head_top": 1,
    "l_shoulder": 3,
    "r_shoulder": 4,
    "l_elbow": 7,
    "r_elbow": 8,
    "l_hand_tip": 11,
    "r_hand_tip": 12,
    "l_hip": 5,
    "r_hip": 6,
    "l_knee": 9,
    "r_knee": 10,
    "l_ankle": 13,
    "r_ankle": 14,
}
"""Column name of each reference point; the pelvis (mid-hips) comes before them, p1 is the torso's position."""
TORSO_COLUMNS = ("torso_x", "torso_y", "torso_z", "torso_rx_rad", "torso_ry_rad", "torso_rz_rad")
"""p1 (m) and the rotation vector of R_world_torso (rad)."""


def write_truth(path: Path, body: Body, motion: Motion) -> None:
    """Writes one row a frame."""
    names = ["pelvis", *POINT_COLUMNS]
    header = ["frame", *(f"{name}_{axis}" for name in names for axis in "xyz"), *TORSO_COLUMNS]
    header += [f"{name}_rad" for name in ANGLE_NAMES]
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(header)
        for frame, (pose, angles) in enumerate(zip(motion.poses, motion.angles, strict=True)):
            points = forward(body, pose)
            pelvis = 0.5 * (points[5] + points[6])
            rows = np.vstack([pelvis, points[list(POINT_COLUMNS.values())], pose.position_world])
            numbers = np.concatenate([rows.ravel(), rotation_vector(pose.R_world_torso), angles])
            writer.writerow([frame, *(f"{value:.7f}" for value in numbers)])
