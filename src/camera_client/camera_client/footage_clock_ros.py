"""The topic ``footage/clock``: cameras that play footage agree on the clock by which they do.

From its activation to its deactivation each camera keeps there, for whoever comes later, the clock that it plays by:
``header.stamp`` is the instant of the system clock at which frame 0 leaves, ``time_ref`` that frame's stamp.
"""

from __future__ import annotations

from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.subscription import Subscription
from sensor_msgs.msg import TimeReference

from sagoma_ros.messages import to_ns, to_stamp
from sagoma_ros.names import graph_topic
from sagoma_ros.qos import LATCHED, LATCHED_BY_MANY

from .sources.footage_pace import FootageClock, SharedClock

TOPIC = "footage/clock"


class FootageClockTopic:
    """Tells the other cameras by which clock this one plays, and takes theirs; :attr:`shared` is the one that holds."""

    def __init__(self, node: Node, camera: str) -> None:
        self._node, self._camera, self._topic = node, camera, graph_topic(node, TOPIC)
        self.shared = SharedClock(self._announce)
        self._publisher: Publisher | None = None
        self._subscription: Subscription | None = None

    def open(self) -> None:
        """Take part: this camera is about to play."""
        self._publisher = self._node.create_publisher(TimeReference, self._topic, LATCHED)
        self._subscription = self._node.create_subscription(TimeReference, self._topic, self._hear, LATCHED_BY_MANY)

    def close(self) -> None:
        """Take part no longer, and take the announcement back."""
        publisher, subscription, self._publisher, self._subscription = self._publisher, self._subscription, None, None
        if publisher is not None and subscription is not None:
            self._node.destroy_subscription(subscription)
            self._node.destroy_publisher(publisher)

    @property
    def cameras(self) -> int:
        """How many cameras take part, this one among them."""
        return self._node.count_publishers(self._topic)

    def _announce(self, clock: FootageClock) -> None:
        publisher = self._publisher
        if publisher is not None:
            message = TimeReference(time_ref=to_stamp(clock.epoch_ns), source=self._camera)
            message.header.stamp = to_stamp(clock.begin_ns)
            publisher.publish(message)

    def _hear(self, message: TimeReference) -> None:
        self.shared.offer(FootageClock(to_ns(message.header.stamp), to_ns(message.time_ref)))
