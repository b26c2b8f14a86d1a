"""The first pose from whatever shows it first: a T-pose that is held, or somebody who moves as they like."""

from __future__ import annotations

from mocap_packets.hull import HullProducts

from .initial_pose import InitialPose
from .known_body_source import KnownBodySource
from .motion_source import NO_HULL, MotionSource
from .t_pose_source import TPoseSource

T_POSE_FIRST_S = 1.0  # a T-pose that is seen but not accepted (who moves, front and back alike) decides for so long
NS_PER_S = 1e9


class AnyPoseSource:
    """Looks for a T-pose, which measures the body at once, and for any other posture, which takes a body of average
    proportions and learns its sizes later. While a T-pose is being held it alone decides."""

    @property
    def needs_voxels(self) -> bool:
        return True

    def __init__(self, t_pose: TPoseSource | KnownBodySource, motion: MotionSource) -> None:
        self._t_pose, self._motion = t_pose, motion
        self._held_ns = 0

    def find_pose(self, seen: HullProducts) -> InitialPose:
        """Return the T-pose, or the pose that the motion shows, or what to do."""
        held = self._t_pose.find_pose(seen)
        if not self._t_pose.is_held:
            self._held_ns = seen.stamp_ns
        if held.pose is not None or (
            0 <= seen.stamp_ns - self._held_ns < T_POSE_FIRST_S * NS_PER_S and self._t_pose.is_held
        ):
            self._motion.reset()
            return held
        moving = self._motion.find_pose(seen)
        return held if moving.reason == NO_HULL else moving
