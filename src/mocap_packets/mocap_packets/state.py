"""The filter's results of each frame set: the body's state, and the prediction from which the next fit starts."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum
from functools import cached_property

import numpy as np

from stick_figure.pose import JointMotion, Pose

from .fit import DOUBTFUL, GOOD, LOST, PART_POINTS, ReferencePoints


class Tracking(StrEnum):
    """How far the estimate can be trusted."""

    ACQUIRING = "acquiring"
    """no pose yet"""
    TRACKING = "tracking"
    DOUBTFUL = "doubtful"
    """a pose, but the last set did not confirm it"""
    LOST = "lost"
    """too long without a measurement: the pose is only extrapolated"""


@dataclass(frozen=True, eq=False)
class Prediction:
    """The filter's state after the frame set of ``stamp_ns``; motion is None while the filter has no state.

    It is kept as quaternions and twists, the numbers of its message, so that pose and velocity are the same bytes on
    both sides of a wire.
    """

    stamp_ns: int
    motion: JointMotion | None = None

    @classmethod
    def of(cls, stamp_ns: int, pose: Pose, velocity: np.ndarray) -> Prediction:
        """Return the prediction of a pose and the rates (24,) of its tangent, m/s and rad/s."""
        return cls(stamp_ns, JointMotion.of(pose, velocity))

    @cached_property
    def pose(self) -> Pose | None:
        """The pose; that dt later is ``pose.retract(velocity * dt)``."""
        return None if self.motion is None else self.motion.pose

    @cached_property
    def velocity(self) -> np.ndarray:
        """(24,) rates of the pose's tangent; zero without a pose."""
        return np.zeros(24) if self.motion is None else self.motion.velocity


@dataclass(frozen=True, eq=False)
class BodyState:
    """The filtered state at a frame set's stamp; world frame, metres, radians, seconds.

    pose : the pose, hinges bent the right way
    velocity : (24,) rates of the pose's tangent
    predicted_velocity : (24,) rate with which the motion model moves the pose until the next set, zero for the identity
        model
    covariance : (48, 48) of the errors of pose and velocity
    bend : (7,) the trunk's bend: `Body.bent` of the body at rest, in this pose, has the points
    angles, rates : (18,) rad and rad/s in the order of `stick_figure.skeleton.ANGLE_NAMES`, continuous with the
        previous set's; the rates are damped near gimbal lock
    points_world, point_covariance : (15, 3) m and (15, 3, 3) m^2, the filtered reference points
    accepted : (15,) bool, measured points, which were used
    distances : (15,) squared Mahalanobis distance of each measured point from its prediction, 0 where not visible
    doubtful : (15,) bool, points of a part of the body that may be elsewhere
    tracking, reason : quality of the whole, and why
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
        return Prediction.of(self.stamp_ns, self.pose, self.predicted_velocity)

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
        return Prediction(self.stamp_ns)
