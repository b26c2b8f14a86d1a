"""The tracked persons for other nodes: their frames on /tf, and for REP-155 joint states, URDF and list of people.

On /tf shoulders, hips and neck are where the trunk's bend has them in this set; in the URDF, whose fixed joints cannot
move, they are where they are at rest.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping

import numpy as np
from geometry_msgs.msg import TransformStamped
from rclpy.node import Node
from sensor_msgs.msg import JointState
from std_msgs.msg import String

from capture_rig.rigid import quaternion_of
from mocap_packets.state import BodyState
from sagoma_ros.intra_process import LazyPublisher
from sagoma_ros.messages import to_stamp
from sagoma_ros.packets import joint_state_message
from sagoma_ros.poses import FramePublisher, about_axis, frame
from sagoma_ros.qos import LATCHED
from stick_figure.body import Body
from stick_figure.skeleton import ANGLE_NAMES, STICK_NAMES, TORSO

from .rep155 import HRI_JOINT_NAMES, body_frame, hri_angles, hri_rates, human_urdf
from .urdf import link_joints, link_name

try:  # not part of common_interfaces: REP-155 listeners have it, others do not need it
    from hri_msgs.msg import IdsList
except ImportError:
    IdsList = None

Tracked = Mapping[str, tuple[BodyState, Body]]
"""The bodies that are tracked, by REP-155 id."""


UNTURNED = (0.0, 0.0, 0.0, 1.0)


class BodyFrames:
    """Publishes the frames of tracked persons, once a frame set: of the torso, and of the ``links``."""

    def __init__(self, node: Node, links: bool, frame_id: str) -> None:
        self._frame_id, self._links, self._publisher = frame_id, links, FramePublisher(node)

    def update(self, tracked: Tracked, stamp_ns: int) -> None:
        """Publish the frames of these bodies, by their id."""
        if tracked:
            self._publisher.publish(lambda: [one for i, body in tracked.items() for one in self._frames(i, *body)])

    def forget(self, body_id: str) -> None:
        """A body has left: nothing of it is kept."""

    def close(self) -> None:
        """Close the topic."""
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


class HumansPublisher:
    """/humans/bodies/ID/joint_states and urdf; with hri_msgs /humans/bodies/tracked; with tf2_msgs body_ID on /tf.

    The topics of ``first_id`` are there from the start, those of others from when they are tracked first.
    """

    def __init__(self, node: Node, first_id: str, frame_id: str) -> None:
        self._node, self._frame_id = node, frame_id
        self._bodies = {first_id: _BodyTopics(node, first_id)}
        self._tracked = LazyPublisher(node, IdsList, "/humans/bodies/tracked") if IdsList else None
        self._frames = FramePublisher(node)

    def update(self, tracked: Tracked, stamp_ns: int) -> None:
        """Publish frames, presence, and each body's joints; its URDF whenever its sizes changed."""
        if tracked:
            self._frames.publish(lambda: [self._transform(i, *body) for i, body in tracked.items()])
        if self._tracked is not None:
            self._tracked.publish(_ids_message, list(tracked), stamp_ns)
        for body_id, (state, body) in tracked.items():
            if body_id not in self._bodies:
                self._bodies[body_id] = _BodyTopics(self._node, body_id)
            self._bodies[body_id].present(state, body)

    def forget(self, body_id: str) -> None:
        """Close the topics of a body that has left."""
        if (topics := self._bodies.pop(body_id, None)) is not None:
            topics.close()

    def close(self) -> None:
        """Destroy the publishers."""
        for publisher in (*self._bodies.values(), self._tracked, self._frames):
            if publisher is not None:
                publisher.close()

    def _transform(self, body_id: str, state: BodyState, body: Body) -> TransformStamped:
        origin, R = body_frame(state.pose, float(body.half_lengths[0]))
        turned = quaternion_of(R).tolist()
        return frame(self._frame_id, f"body_{body_id}", state.stamp_ns, origin.tolist(), turned)


class _BodyTopics:
    """One body's joint states and URDF."""

    def __init__(self, node: Node, body_id: str) -> None:
        self._id = body_id
        self._names = [f"{name}_{body_id}" for name in HRI_JOINT_NAMES]
        self._angles: np.ndarray | None = None
        self._body: Body | None = None
        self._joints = LazyPublisher(node, JointState, f"/humans/bodies/{body_id}/joint_states")
        self._urdf = LazyPublisher(node, String, f"/humans/bodies/{body_id}/urdf", LATCHED)

    def present(self, state: BodyState, body: Body) -> None:
        if body is not self._body:
            self._body, self._angles = body, None
            self._urdf.publish(lambda: String(data=human_urdf(body, self._id)))
        self._angles = hri_angles(state.pose, self._angles)
        self._joints.publish(self._joint_states, self._angles, state)

    def close(self) -> None:
        self._joints.close()
        self._urdf.close()

    def _joint_states(self, angles: np.ndarray, state: BodyState) -> JointState:
        rates = hri_rates(state.pose, state.velocity, angles)
        return joint_state_message(self._names, angles, rates, state.stamp_ns)


def _ids_message(ids: list[str], stamp_ns: int) -> IdsList:
    message = IdsList(ids=ids)
    message.header.stamp = to_stamp(stamp_ns)
    return message
