"""What the filter says after each frame set."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum

import numpy as np

from stick_figure.kernels import HINGE_SLOT
from stick_figure.pose import Pose
from stick_figure.skeleton import POINT_NAMES


class Tracking(StrEnum):
    """How far the estimate can be trusted."""

    ACQUIRING = "acquiring"
    """no pose yet"""
    TRACKING = "tracking"
    DOUBTFUL = "doubtful"
    """a pose, but the last set did not bear it out"""
    LOST = "lost"
    """no measurement for so long that the pose is no more than a memory"""


@dataclass(frozen=True, eq=False)
class EkfState:
    """The filtered state at a frame set's stamp; world frame, metres, radians, seconds.

    pose : the pose, hinges bent the right way
    velocity : (24,) rates of the pose's tangent
    predicted_velocity : (24,) rate with which the motion model moves the pose until the next set, zero for the identity model
    covariance : (48, 48) of the errors of pose and velocity
    angles, rates : (18,) rad and rad/s in the order of `stick_figure.skeleton.ANGLE_NAMES`, continuous with the
        previous set's; the rates are damped near gimbal lock
    points_world, point_covariance : (15, 3) m and (15, 3, 3) m^2, the filtered reference points
    accepted, gated : (15,) bool, measured points that were used, and that were left out as outliers
    distances : (15,) squared Mahalanobis distance of each measured point from its prediction, 0 where not visible
    tracking, reason : how far to trust it, and why
    """

    stamp_ns: int
    pose: Pose
    velocity: np.ndarray
    predicted_velocity: np.ndarray
    covariance: np.ndarray
    angles: np.ndarray
    rates: np.ndarray
    points_world: np.ndarray
    point_covariance: np.ndarray
    accepted: np.ndarray
    gated: np.ndarray
    distances: np.ndarray
    tracking: Tracking
    reason: str

    @property
    def normalised_innovation(self) -> float:
        """Mean of distance / 3 over the accepted points: 1 when covariances are right; NaN without points."""
        if not self.accepted.any():
            return float("nan")
        return float(self.distances[self.accepted].mean() / 3.0)


@dataclass(frozen=True, eq=False)
class NoState:
    """The filter has no pose, and why."""

    stamp_ns: int
    reason: str
    tracking: Tracking = Tracking.ACQUIRING


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


# --- Named slices of the filter's 48 error-state slots: 24 of the pose's tangent, then the same 24 of its velocity.

POSE = slice(0, 24)
VELOCITY = slice(24, 48)
DIMENSION = 48

HINGES = HINGE_SLOT
"""(4,) tangent slots of left and right elbow, left and right knee."""


def per_slot(torso_position: float, torso_rotation: float, ball_joints: float, hinges: float) -> np.ndarray:
    """(24,) one number for every tangent slot, by the kind of its joint."""
    values = np.full(24, ball_joints)
    values[0:3] = torso_position
    values[3:6] = torso_rotation
    values[HINGES] = hinges
    return values
