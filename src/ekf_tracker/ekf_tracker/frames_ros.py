"""Everybody on /tf: map -> the torso, and from there the links of the body's URDF (`urdf`).

Shoulders, hips and neck are where the trunk's bend has them in this set; in the URDF, whose fixed joints cannot move,
they are where they are at rest.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping

from geometry_msgs.msg import TransformStamped
from rclpy.node import Node

from capture_rig.rigid import quaternion_of
from mocap_packets.state import BodyState
from sagoma_ros.frames import FramePublisher, about_axis, frame
from stick_figure.body import Body
from stick_figure.skeleton import ANGLE_NAMES, STICK_NAMES, TORSO

from .settings import LINK_FRAMES, NO_FRAMES
from .urdf import link_joints, link_name

UNTURNED = (0.0, 0.0, 0.0, 1.0)


class BodyFrames:
    """Publishes the frames of those who are tracked, once a frame set."""

    def __init__(self, node: Node, which: str, frame_id: str) -> None:
        """``which`` : of TF_CHOICES; with `TORSO_FRAME` a robot_state_publisher adds the links."""
        self._frame_id, self._links = frame_id, which == LINK_FRAMES
        self._publisher = None if which == NO_FRAMES else FramePublisher(node)

    def update(self, tracked: Mapping[str, tuple[BodyState, Body]]) -> None:
        """Publish the frames of these bodies, by their id."""
        if self._publisher is not None and tracked:
            self._publisher.publish(lambda: [one for i, body in tracked.items() for one in self._frames(i, *body)])

    def close(self) -> None:
        """Take the topic back."""
        if self._publisher is not None:
            self._publisher.close()

    def _frames(self, body_id: str, state: BodyState, body: Body) -> Iterator[TransformStamped]:
        torso, stamp_ns = link_name(body_id, STICK_NAMES[TORSO]), state.stamp_ns
        place, turn = state.pose.position_world.tolist(), quaternion_of(state.pose.R_world_torso).tolist()
        yield frame(self._frame_id, torso, stamp_ns, place, turn)
        if self._links:
            angles = dict(zip(ANGLE_NAMES, state.angles.tolist(), strict=True))
            for joint in link_joints(body.bent(state.bend)):
                turned = UNTURNED if joint.axis is None else about_axis(joint.axis, angles[joint.name])
                parent, child = link_name(body_id, joint.parent), link_name(body_id, joint.child)
                yield frame(parent, child, stamp_ns, joint.origin, turned)
