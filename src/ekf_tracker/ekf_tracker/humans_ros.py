"""The tracked person for REP-155: joint states and URDF; the list of people and /tf where installed."""

from __future__ import annotations

import re
from typing import Protocol

import numpy as np
from geometry_msgs.msg import TransformStamped, Vector3
from rclpy.node import Node
from sensor_msgs.msg import JointState
from std_msgs.msg import String

from capture_rig.errors import InputError
from mocap_packets.state import BodyState
from sagoma_ros.exchange import HeardPublisher
from sagoma_ros.messages import to_stamp
from sagoma_ros.qos import LATCHED
from stick_figure.body import Body

from .rep155 import HRI_JOINT_NAMES, body_frame, hri_angles, human_urdf
from .state_ros import quaternion

try:  # not part of common_interfaces: REP-155 listeners have it, others do not need it
    from hri_msgs.msg import IdsList
except ImportError:
    IdsList = None
try:
    from tf2_msgs.msg import TFMessage
except ImportError:
    TFMessage = None

BODY_ID = re.compile(r"[A-Za-z][A-Za-z0-9_]*")


class Humans(Protocol):
    """Publishes what REP-155 says of a tracked body."""

    def present(self, state: BodyState, body: Body) -> None:
        """The body is tracked, in this state."""
        ...

    def absent(self, stamp_ns: int) -> None:
        """No body is tracked."""
        ...

    def close(self) -> None:
        """Destroy the publishers."""
        ...


class NoHumans:
    """Publishes nothing."""

    def present(self, state: BodyState, body: Body) -> None:
        """Nothing."""

    def absent(self, stamp_ns: int) -> None:
        """Nothing."""

    def close(self) -> None:
        """Nothing."""


class HumansPublisher:
    """/humans/bodies/ID/joint_states and urdf; with hri_msgs /humans/bodies/tracked; with tf2_msgs body_ID on /tf.

    Raises InputError when ``body_id`` is no REP-155 id: letters, digits and underscores, a letter first.
    """

    def __init__(self, node: Node, body_id: str, frame_id: str) -> None:
        if not BODY_ID.fullmatch(body_id):
            raise InputError(
                f"body_id = {body_id!r} is no REP-155 id",
                where=f"parameters of {node.get_name()}",
                remedy="Use letters, digits and underscores, a letter first, as in b0001.",
            )
        self._id, self._frame_id = body_id, frame_id
        self._names = [f"{name}_{body_id}" for name in HRI_JOINT_NAMES]
        self._angles: np.ndarray | None = None
        self._body: Body | None = None
        topic = f"/humans/bodies/{body_id}"
        self._joints = HeardPublisher(node, JointState, f"{topic}/joint_states")
        self._urdf = HeardPublisher(node, String, f"{topic}/urdf", LATCHED)
        self._tracked = HeardPublisher(node, IdsList, "/humans/bodies/tracked") if IdsList else None
        self._tf = HeardPublisher(node, TFMessage, "/tf") if TFMessage else None

    def present(self, state: BodyState, body: Body) -> None:
        """Publish joints, frame and presence; the URDF whenever the body changed."""
        if body is not self._body:
            self._body, self._angles = body, None
            self._urdf.publish(lambda: String(data=human_urdf(body, self._id)))
        self._angles = hri_angles(state.pose, self._angles)
        if self._tf is not None:
            self._tf.publish(lambda: TFMessage(transforms=[self._body_transform(state, body)]))
        self._list([self._id], state.stamp_ns)
        self._joints.publish(self._joint_states, self._angles, state.stamp_ns)

    def absent(self, stamp_ns: int) -> None:
        """Publish that nobody is tracked."""
        self._angles = None
        self._list([], stamp_ns)

    def close(self) -> None:
        """Destroy the publishers."""
        for publisher in (self._joints, self._urdf, self._tracked, self._tf):
            if publisher is not None:
                publisher.close()

    def _joint_states(self, angles: np.ndarray, stamp_ns: int) -> JointState:
        message = JointState(name=self._names, position=angles.tolist())
        message.header.stamp = to_stamp(stamp_ns)
        return message

    def _list(self, ids: list[str], stamp_ns: int) -> None:
        if self._tracked is not None:
            self._tracked.publish(_ids_message, ids, stamp_ns)

    def _body_transform(self, state: BodyState, body: Body) -> TransformStamped:
        origin, R = body_frame(state.pose, float(body.half_lengths[0]))
        message = TransformStamped(child_frame_id=f"body_{self._id}")
        message.header.stamp, message.header.frame_id = to_stamp(state.stamp_ns), self._frame_id
        x, y, z = origin.tolist()
        message.transform.translation = Vector3(x=x, y=y, z=z)
        message.transform.rotation = quaternion(R)
        return message


def _ids_message(ids: list[str], stamp_ns: int) -> IdsList:
    message = IdsList(ids=ids)
    message.header.stamp = to_stamp(stamp_ns)
    return message


def make_humans(node: Node, publish: bool, body_id: str, frame_id: str) -> Humans:
    """Return the publisher that the parameters ask for."""
    return HumansPublisher(node, body_id, frame_id) if publish else NoHumans()
