"""Packets from node to node: handed over in memory within a process, as messages to everybody else.

A topic whose publisher lives in this process is not subscribed to over the wire: its packets come on the publisher's
own thread, in order, and are rounded as in a message, so that the results are the same bytes either way. A message is
made only when somebody outside listens.
"""

from __future__ import annotations

import threading
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any, Generic, TypeVar
from weakref import WeakKeyDictionary

from rclpy.context import Context
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.qos import DurabilityPolicy, QoSProfile
from rclpy.subscription import Subscription

from .limits import oversize
from .messages import to_ns
from .qos import RESULT

P = TypeVar("P")


class LazyPublisher:
    """Makes and publishes a message only when somebody subscribes to it."""

    def __init__(self, node: Node, kind: type, topic: str, qos: QoSProfile = RESULT) -> None:
        self._node, self.topic = node, topic
        self._publisher: Publisher = node.create_publisher(kind, topic, qos)
        self._kept = qos.durability == DurabilityPolicy.TRANSIENT_LOCAL  # later listeners get the last message

    @property
    def is_wanted(self) -> bool:
        """Whether there is a subscriber, or may come one that the last message is kept for."""
        return self._kept or self._publisher.get_subscription_count() > 0

    def publish(self, make: Callable[..., Any], *arguments: Any) -> None:
        """Publish ``make(*arguments)`` if :attr:`is_wanted`."""
        if self.is_wanted:
            self._publisher.publish(make(*arguments))

    def close(self) -> None:
        """Take the topic back."""
        self._node.destroy_publisher(self._publisher)


@dataclass(frozen=True, eq=False)
class Delivery(Generic[P]):
    """One packet that has arrived: from this process as ``packet``, as exact as its sender has it; else as ``message``.

    Its taker rounds the one as a message would (``as_sent``), or converts the other, on the thread where it is used.
    """

    stamp_ns: int
    frame_id: str
    packet: P | None = None
    message: Any = None


@dataclass(eq=False)
class _Channel:
    """A topic within one process."""

    publishers: int = 0
    subscriptions: list[PacketSubscription] = field(default_factory=list)
    kept: Delivery | None = None

    def joined(self, change: int) -> None:
        self.publishers += change
        for subscription in self.subscriptions:
            subscription.follow(self.publishers > 0)


_CHANNELS: WeakKeyDictionary[Context, dict[str, _Channel]] = WeakKeyDictionary()
_CHANGING = threading.RLock()  # nodes of several contexts may open topics at once


def _channel(node: Node, topic: str) -> _Channel:
    with _CHANGING:
        return _CHANNELS.setdefault(node.context, {}).setdefault(node.resolve_topic_name(topic), _Channel())


class PacketPublisher(Generic[P]):
    """The sending end of a topic of packets."""

    def __init__(
        self, node: Node, kind: type, topic: str, to_message: Callable[[P, int, str], Any], qos: QoSProfile = RESULT
    ) -> None:
        """``to_message(packet, stamp_ns, frame_id)`` makes a message of type ``kind``."""
        self._outside, self._to_message = LazyPublisher(node, kind, topic, qos), to_message
        self._keeps = qos.durability == DurabilityPolicy.TRANSIENT_LOCAL
        self._channel = _channel(node, topic)
        with _CHANGING:
            self._channel.joined(+1)

    @property
    def is_wanted(self) -> bool:
        """Whether there is a subscriber outside this process."""
        return self._outside.is_wanted

    def publish(self, packet: P, stamp_ns: int, frame_id: str) -> None:
        """Send a packet to everybody: first to this process's own, on this thread."""
        delivery = Delivery(stamp_ns, frame_id, packet)
        if self._keeps:
            self._channel.kept = delivery
        for subscription in tuple(self._channel.subscriptions):
            subscription.deliver(delivery)
        self._outside.publish(self._to_message, packet, stamp_ns, frame_id)

    def close(self) -> None:
        """Take the topic back; who follows it here listens to the wire from now on."""
        self._outside.close()
        with _CHANGING:
            self._channel.kept = None
            self._channel.joined(-1)


class PacketSubscription(Generic[P]):
    """The receiving end of a topic of packets.

    ``callback`` is called with every delivery: by the executor with what comes over the wire, on the publisher's thread
    with what comes from this process.
    """

    def __init__(
        self, node: Node, kind: type, topic: str, callback: Callable[[Delivery[P]], None], qos: QoSProfile = RESULT
    ) -> None:
        self._node, self._kind, self._topic, self._qos = node, kind, topic, qos
        self._callback = callback
        self._wire: Subscription | None = None
        self._channel = _channel(node, topic)
        with _CHANGING:
            self._channel.subscriptions.append(self)
            self.follow(self._channel.publishers > 0)
            kept = self._channel.kept
        if kept is not None:
            self.deliver(kept)

    def follow(self, in_memory: bool) -> None:
        """Listen to this process, or to the wire."""
        if in_memory and self._wire is not None:
            self._node.destroy_subscription(self._wire)
            self._wire = None
        elif not in_memory and self._wire is None:
            self._wire = self._node.create_subscription(self._kind, self._topic, self._on_message, self._qos)

    def deliver(self, delivery: Delivery[P]) -> None:
        """Take a packet from this process."""
        self._callback(delivery)

    def close(self) -> None:
        """Listen no longer."""
        with _CHANGING:
            self._channel.subscriptions.remove(self)
            self.follow(in_memory=True)

    def _on_message(self, message: Any) -> None:
        excess = oversize(message)
        if excess:
            self._refuse(excess)
            return
        header = getattr(message, "header", None)
        stamp_ns, frame_id = (to_ns(header.stamp), header.frame_id) if header is not None else (0, "")
        self._callback(Delivery(stamp_ns, frame_id, message=message))

    def _refuse(self, excess: str) -> None:
        """Count and tell what was too large to be taken."""
        health = getattr(self._node, "health", None)
        if health is not None:
            health.count("large_messages")
        text = f"{self._topic}: a message is refused: {excess}"
        self._node.get_logger().warning(text, throttle_duration_sec=5.0)
