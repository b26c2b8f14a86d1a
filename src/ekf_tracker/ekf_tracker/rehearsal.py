"""Running the filter once before it matters, so that compiling does not hold up the first frame set."""

from __future__ import annotations

import numpy as np

from stick_figure.body import Body
from stick_figure.kinematics import forward
from stick_figure.pose import T_POSE_ANGLES, Pose

from .filter import ArticulatedEkf

STATURE_M = 1.75
FRAME_NS = 10_000_000


def rehearse() -> None:
    """Two sets of a standing figure through a filter of its own."""
    body = Body.from_stature(STATURE_M)
    points = forward(body, Pose.from_angles(np.zeros(3), np.eye(3), T_POSE_ANGLES))
    covariance = np.tile(np.eye(3) * 1e-4, (15, 1, 1))
    rehearsed = ArticulatedEkf(body)
    for number in range(2):
        rehearsed.step(FRAME_NS * (1 + number), points, covariance, np.ones(15, bool))
