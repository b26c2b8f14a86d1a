"""What a fit of the stick figure to one cloud of centerline points returns."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from stick_figure.pose import Pose

# sticks that meet at each reference point: torso centre, head tip, neck, shoulders, hips, elbows, knees, hands, feet
SUPPORTING_STICKS = (
    (0,),
    (1,),
    (0, 1),
    (0, 2),
    (0, 3),
    (0, 4),
    (0, 5),
    (2, 6),
    (3, 7),
    (4, 8),
    (5, 9),
    (6,),
    (7,),
    (8,),
    (9,),
)
UNKNOWN_SD_M = 10.0
"""Standard deviation (m) given to a point about which nothing is known."""


@dataclass(frozen=True, eq=False)
class FitResult:
    """The stick figure fitted to a cloud of points, world frame.

    pose : the figure's pose; converged : the last step was below the tolerance within the iterations allowed.
    iterations : solver iterations; points, inliers : data points given, and those within the robust gate.
    rms_m : root mean square distance (m) of the inliers to their sticks; stick_inliers : (10,) inliers a stick.
    information : (24, 24) data information of the pose's tangent (Gauss-Newton H, 1/m^2 and 1/rad^2).
    reference_points_world : (15, 3) m; covariance : (15, 3, 3) m^2, from the solver's information.
    visible : (15,) bool, enough points support a stick that meets at the reference point.
    """

    pose: Pose
    converged: bool
    iterations: int
    points: int
    inliers: int
    rms_m: float
    stick_inliers: np.ndarray
    information: np.ndarray
    reference_points_world: np.ndarray
    covariance: np.ndarray
    visible: np.ndarray


def visible_points(stick_inliers: np.ndarray, needed: int) -> np.ndarray:
    """(15,) bool: at least ``needed`` inliers on one of the sticks that meet at the point."""
    return np.array([max(stick_inliers[j] for j in sticks) >= needed for sticks in SUPPORTING_STICKS])


def unknown_covariance() -> np.ndarray:
    """(15, 3, 3) covariance of points about which nothing is known."""
    return np.broadcast_to(np.eye(3) * UNKNOWN_SD_M**2, (15, 3, 3)).copy()
