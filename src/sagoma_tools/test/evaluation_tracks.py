"""Tracks and truths whose errors are known by construction, for the tests of the evaluation."""

from pathlib import Path

import numpy as np
from poses import angles_with
from scipy.spatial.transform import Rotation

from capture_rig.session import Truth
from mocap_packets.fit import GOOD
from sagoma_tools.evaluation.track import Track
from stick_figure.body import Body
from stick_figure.kinematics import forward
from stick_figure.pose import Pose
from stick_figure.skeleton import ANGLE_NAMES

SLOT = {name: slot for slot, name in enumerate(ANGLE_NAMES)}


def turns(frames):
    """(F, 3, 3) rotations of somebody who turns left by 0.05 rad a frame."""
    return Rotation.from_euler("z", 0.05 * np.arange(frames)[:, None]).as_matrix()


def walker(frames=40, aside_m=0.0, **angles_rad):
    """Points (F, 15, 3) and angles (F, 18) of a figure that turns and moves on, with constant joint angles."""
    body, angles = Body.from_stature(1.75), angles_with(**angles_rad)
    poses = [Pose.from_angles([0.01 * k, aside_m, 1.0], R, angles) for k, R in enumerate(turns(frames))]
    return np.stack([forward(body, pose) for pose in poses]), np.tile(angles, (frames, 1))


def truth_of(points_world, angles=None, wrist_fraction=1.0):
    return Truth(np.arange(len(points_world)), points_world, angles, wrist_fraction, Path("truth.csv"))


def track_of(points_world, states="tracking", first=0, sd_m=0.01, angles=None, parts=None):
    """Of the frames from ``first`` on, with an isotropic covariance; ``states`` : one, or one a frame."""
    count = len(points_world)
    covariance = np.tile(sd_m**2 * np.eye(3), (count, 15, 1, 1))
    angles = np.zeros((count, 18)) if angles is None else angles
    parts = np.full((count, 5), GOOD, "<U8") if parts is None else parts
    return Track(first + np.arange(count), points_world, covariance, angles, np.full(count, states), parts)
