"""Named slices of the filter's 48 error-state slots, and how far to trust an estimate.

The error state is 24 slots of the pose's tangent, then the same 24 of its velocity.
"""

from __future__ import annotations

import numpy as np

from mocap_packets.fit import PART_OF_POINT
from mocap_packets.state import Tracking
from stick_figure.kernels import HINGE_SLOT
from stick_figure.skeleton import POINT_NAMES

POSE = slice(0, 24)
VELOCITY = slice(24, 48)
DIMENSION = 48
_POINTS_OF_PART = np.bincount(PART_OF_POINT)


def per_slot(torso_position: float, torso_rotation: float, ball_joints: float, hinges: float) -> np.ndarray:
    """Return (24,) one number for every tangent slot, by the kind of its joint."""
    values = np.full(24, ball_joints)
    values[0:3] = torso_position
    values[3:6] = torso_rotation
    values[HINGE_SLOT] = hinges
    return values


def assess(accepted: np.ndarray, gated: np.ndarray, unmeasured_s: float, lost_after_s: float) -> tuple[Tracking, str]:
    """Trust in the estimate, from the points used and left out (15,) and the seconds since any was used."""
    used, left_out = np.count_nonzero(accepted), np.count_nonzero(gated)
    if unmeasured_s > lost_after_s:
        return Tracking.LOST, f"no usable point for {unmeasured_s:.2f} s"
    if used == 0 and left_out == 0:
        return Tracking.DOUBTFUL, f"no visible point for {unmeasured_s:.2f} s"
    names = ", ".join(POINT_NAMES[i] for i in np.flatnonzero(gated)) if left_out else ""
    if left_out >= used:
        return Tracking.DOUBTFUL, f"{left_out} of {used + left_out} visible points contradict the prediction: {names}"
    if left_out:
        return Tracking.TRACKING, f"{used} points used, left out: {names}"
    return Tracking.TRACKING, f"{used} points used"


def doubtful_points(doubtful: np.ndarray, left_out: np.ndarray) -> np.ndarray:
    """Return (15,) bool: every point of the parts of the body that somebody doubts.

    Points (15,) that were measured as doubtful make their part so, and points that were left out of a limb: the limb
    is either where they are or where the filter has it. Of the trunk's seven points, half of them do.
    """
    doubts, misses = (np.bincount(PART_OF_POINT, weights=points) for points in (doubtful, left_out))
    return ((doubts > 0) | (2 * misses >= _POINTS_OF_PART))[PART_OF_POINT]
