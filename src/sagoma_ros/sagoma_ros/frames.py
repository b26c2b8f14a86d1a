"""Frames on /tf and /tf_static, where tf2_msgs is installed: it is in every ROS installation, not in the wheels."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

from geometry_msgs.msg import Quaternion, Transform, TransformStamped, Vector3
from rclpy.node import Node

from .intra_process import LazyPublisher
from .messages import to_stamp
from .qos import LATCHED, TF

try:
    from tf2_msgs.msg import TFMessage
except ImportError:
    TFMessage = None

Transforms = Sequence[TransformStamped]


class FramePublisher:
    """Publishes frames that move (/tf) or stay (``static``: /tf_static); nothing where there is no tf2_msgs."""

    def __init__(self, node: Node, static: bool = False) -> None:
        self._publisher: LazyPublisher | None = None
        if TFMessage is not None:
            topic, qos = ("/tf_static", LATCHED) if static else ("/tf", TF)
            self._publisher = LazyPublisher(node, TFMessage, topic, qos)

    def publish(self, make: Callable[[], Transforms]) -> None:
        """Publish what ``make`` returns, if somebody listens."""
        if self._publisher is not None:
            self._publisher.publish(lambda: TFMessage(transforms=list(make())))

    def close(self) -> None:
        """Take the topic back."""
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
