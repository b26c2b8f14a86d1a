"""Poses in messages: with velocities as sensor_msgs/MultiDOFJointState (predictions, joints' rotations), frames on /tf.

tf2_msgs is in every ROS installation, not in the wheels: without it no frames are published.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

import numpy as np
from geometry_msgs.msg import Quaternion, Transform, TransformStamped, Twist, Vector3
from rclpy.node import Node
from sensor_msgs.msg import MultiDOFJointState

from capture_rig.errors import InputError
from capture_rig.rigid import WRITTEN_TOLERANCE
from mocap_packets.fit import FIRST_PERSON
from mocap_packets.people import Predictions
from mocap_packets.state import Prediction
from stick_figure.pose import JOINT_NAMES, JointMotion

from .intra_process import LazyPublisher
from .messages import to_ns, to_stamp
from .qos import LATCHED, TF

try:
    from tf2_msgs.msg import TFMessage
except ImportError:
    TFMessage = None

Transforms = Sequence[TransformStamped]


def motion_message(motions: dict[int, JointMotion], stamp_ns: int, frame_id: str) -> MultiDOFJointState:
    """Return the joints of every person, of `stick_figure.pose.JOINT_NAMES`; of others than the first one with
    ``person_N/`` before each name.

    transforms : the torso's in ``frame_id``; of the other joints the rotation of the stick in the frame of its carrier,
    without translation. twist : in the same axes.
    """
    message = MultiDOFJointState()
    message.header.stamp, message.header.frame_id = to_stamp(stamp_ns), frame_id
    for person, motion in motions.items():
        message.joint_names.extend(_names_of(person))
        rows = zip(motion.quaternions.tolist(), motion.angular.tolist(), strict=True)
        for (x, y, z, w), (p, q, r) in rows:
            message.transforms.append(Transform(rotation=Quaternion(x=x, y=y, z=z, w=w)))
            message.twist.append(Twist(angular=Vector3(x=p, y=q, z=r)))
        torso = -len(JOINT_NAMES)
        message.transforms[torso].translation = _vector(motion.position_world)
        message.twist[torso].linear = _vector(motion.linear_world)
    return message


def read_motions(message: MultiDOFJointState, where: str) -> dict[int, JointMotion]:
    """Return the inverse of :func:`motion_message`; InputError for other joints, numbers that are not finite, or
    quaternions that are no rotation."""
    size = len(JOINT_NAMES)
    names = list(message.joint_names)
    if not (len(names) == len(message.transforms) == len(message.twist)) or len(names) % size:
        raise _not_ours(where)
    turns = np.array([[r.x, r.y, r.z, r.w] for r in (t.rotation for t in message.transforms)]).reshape(-1, 4)
    angular = np.array([[a.x, a.y, a.z] for a in (t.angular for t in message.twist)]).reshape(-1, 3)
    places = np.array([[p.x, p.y, p.z] for p in (t.translation for t in message.transforms[::size])])
    linear = np.array([[v.x, v.y, v.z] for v in (t.linear for t in message.twist[::size])])
    if not all(np.isfinite(numbers).all() for numbers in (turns, angular, places, linear)):
        raise InputError("the joints hold numbers that are not finite", where=where, remedy="Check the publisher.")
    if np.abs(np.linalg.norm(turns, axis=1) - 1.0).max(initial=0.0) > WRITTEN_TOLERANCE:
        raise InputError("a quaternion has not the length 1", where=where, remedy="Normalise it before publishing.")
    motions = {}
    for number, start in enumerate(range(0, len(names), size)):
        own, person = slice(start, start + size), _person_of(names[start])
        if tuple(names[own]) != _names_of(person) or person in motions:
            raise _not_ours(where)
        motions[person] = JointMotion(places[number], turns[own], linear[number], angular[own])
    return motions


def predictions_message(predictions: Predictions, frame_id: str = "map") -> MultiDOFJointState:
    """Return everybody's predictions as :func:`motion_message`; persons without a pose have no joints."""
    motions = {person: one.motion for person, one in predictions.of.items() if one.motion is not None}
    return motion_message(motions, predictions.stamp_ns, frame_id)


def read_predictions(message: MultiDOFJointState, where: str) -> Predictions:
    """Return the inverse of :func:`predictions_message`; InputError as :func:`read_motions`."""
    stamp_ns = to_ns(message.header.stamp)
    motions = {FIRST_PERSON: None, **read_motions(message, where)}
    return Predictions(stamp_ns, {person: Prediction(stamp_ns, motion) for person, motion in motions.items()})


def _not_ours(where: str) -> InputError:
    what = "names or lengths are not those of a body's joints"
    return InputError(what, where=where, remedy=f"Give transforms and twist of {', '.join(JOINT_NAMES)}.")


def _names_of(person: int) -> tuple[str, ...]:
    return JOINT_NAMES if person == FIRST_PERSON else tuple(f"person_{person}/{name}" for name in JOINT_NAMES)


def _person_of(name: str) -> int:
    head, _, number = name.partition("/")[0].partition("_")
    return int(number) if head == "person" and number.isdigit() else FIRST_PERSON


def _vector(xyz: np.ndarray) -> Vector3:
    x, y, z = xyz.tolist()
    return Vector3(x=x, y=y, z=z)


# --- frames


class FramePublisher:
    """Publishes frames that move (/tf) or stay (``static``: /tf_static); nothing where there is no tf2_msgs."""

    def __init__(self, node: Node, static: bool = False) -> None:
        self._publisher: LazyPublisher | None = None
        if TFMessage is not None:
            topic, qos = ("/tf_static", LATCHED) if static else ("/tf", TF)
            self._publisher = LazyPublisher(node, TFMessage, topic, qos)

    def publish(self, make: Callable[[], Transforms]) -> None:
        """Publish the message that ``make`` returns, if there is a subscriber."""
        if self._publisher is not None:
            self._publisher.publish(lambda: TFMessage(transforms=list(make())))

    def close(self) -> None:
        """Close the topic."""
        if self._publisher is not None:
            self._publisher.close()


def frame(
    parent: str, child: str, stamp_ns: int, place: Sequence[float], quaternion: Sequence[float]
) -> TransformStamped:
    """Return the frame ``child`` at ``place`` (3,) m of ``parent``, turned by a quaternion (4,) x y z w."""
    (x, y, z), (qx, qy, qz, qw) = place, quaternion
    transform = Transform(translation=Vector3(x=x, y=y, z=z), rotation=Quaternion(x=qx, y=qy, z=qz, w=qw))
    message = TransformStamped(child_frame_id=child, transform=transform)
    message.header.stamp, message.header.frame_id = to_stamp(stamp_ns), parent
    return message


def about_axis(axis: Sequence[float], angle: float) -> tuple[float, float, float, float]:
    """Return the quaternion x y z w of a turn about a unit axis (3,) by an angle, rad."""
    (x, y, z), sine = axis, math.sin(0.5 * angle)
    return sine * x, sine * y, sine * z, math.cos(0.5 * angle)
