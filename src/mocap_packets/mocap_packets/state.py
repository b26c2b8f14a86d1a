"""What the filter says after each frame set: the body's state, and the prediction from which the next fit starts."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum

import numpy as np

from stick_figure.joint_motion import JointMotion
from stick_figure.pose import Pose

from .fit import DOUBTFUL, GOOD, LOST, PART_POINTS, ReferencePoints


class Tracking(StrEnum):
    """How far the estimate can be trusted."""

    ACQUIRING = "acquiring"
    """no pose yet"""
    TRACKING = "tracking"
    DOUBTFUL = "doubtful"
    """a pose, but the last set did not confirm it"""
    LOST = "lost"
    """no measurement for so long that the pose is only extrapolated"""


@dataclass(frozen=True, eq=False)
class Prediction:
    """The filter's state after the frame set of ``stamp_ns``; pose is None while the filter has no state.

    velocity : (24,) rate of the pose's tangent, m/s and rad/s: the pose dt later is ``pose.retract(velocity * dt)``.
    """

    stamp_ns: int
    pose: Pose | None
    velocity: np.ndarray

    def as_sent(self) -> Prediction:
        """Return the same, its rotations as quaternions gave them back, as they do between the nodes."""
        if self.pose is None:
            return self
        motion = JointMotion.of(self.pose, self.velocity)
        return Prediction(self.stamp_ns, motion.pose, motion.velocity)


@dataclass(frozen=True, eq=False)
class BodyState:
    """The filtered state at a frame set's stamp; world frame, metres, radians, seconds.

    pose : the pose, hinges bent the right way
    velocity : (24,) rates of the pose's tangent
    predicted_velocity : (24,) rate with which the motion model moves the pose until the next set, zero for the identity
        model
    covariance : (48, 48) of the errors of pose and velocity
    bend : (7,) how the trunk is bent, of `Body.bent`: the body at rest so bent, in this pose, has the points
    angles, rates : (18,) rad and rad/s in the order of `stick_figure.skeleton.ANGLE_NAMES`, continuous with the
        previous set's; the rates are damped near gimbal lock
    points_world, point_covariance : (15, 3) m and (15, 3, 3) m^2, the filtered reference points
    accepted, gated : (15,) bool, measured points that were used, and that were left out as outliers
    distances : (15,) squared Mahalanobis distance of each measured point from its prediction, 0 where not visible
    doubtful : (15,) bool, points of a part of the body that may be elsewhere
    tracking, reason : how far to trust the whole, and why
    """

    stamp_ns: int
    pose: Pose
    velocity: np.ndarray
    predicted_velocity: np.ndarray
    covariance: np.ndarray
    bend: np.ndarray
    angles: np.ndarray
    rates: np.ndarray
    points_world: np.ndarray
    point_covariance: np.ndarray
    accepted: np.ndarray
    gated: np.ndarray
    distances: np.ndarray
    doubtful: np.ndarray
    tracking: Tracking
    reason: str

    @property
    def reference_points(self) -> ReferencePoints:
        """The filtered points; visible are those whose own measurement was used, doubtful those of a doubtful part."""
        return ReferencePoints(self.points_world, self.point_covariance, self.accepted, self.doubtful)

    @property
    def parts(self) -> tuple[str, ...]:
        """How far to trust each part of the body, in the order of `fit.PART_NAMES`: good, doubtful or lost."""
        if self.tracking == Tracking.LOST:
            return (LOST,) * len(PART_POINTS)
        return tuple(DOUBTFUL if self.doubtful[list(points)].any() else GOOD for points in PART_POINTS)

    @property
    def prediction(self) -> Prediction:
        """Where the next fit starts."""
        return Prediction(self.stamp_ns, self.pose, self.predicted_velocity)

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

    @property
    def prediction(self) -> Prediction:
        """A prediction without a pose."""
        return Prediction(self.stamp_ns, None, np.zeros(24))
