"""Packets from node to node: passed in memory within a process, as messages to other processes.

A topic whose publisher lives in this process is not subscribed to over the wire: its packets come on the publisher's
own thread, in order. Messages hold every number of a packet exactly, so that the results are the same bytes either way.
A message is made only for subscribers in other processes.
"""

from __future__ import annotations

import threading
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, Generic, Protocol, TypeVar
from weakref import WeakKeyDictionary

from rclpy.context import Context
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.qos import DurabilityPolicy, QoSProfile
from rclpy.subscription import Subscription

from capture_rig.errors import InputError

from .health import LOG_EVERY_S
from .messages import oversize
from .qos import RESULT


class Packet(Protocol):
    """What travels: of one frame set, by whose capture stamp it is known."""

    @property
    def stamp_ns(self) -> int: ...


P = TypeVar("P", bound=Packet)


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
        """Close the topic."""
        self._node.destroy_publisher(self._publisher)


@dataclass(frozen=True)
class PacketTopic(Generic[P]):
    """A topic between two of our nodes.

    to_message : of a packet and its frame id, a message of type ``kind``. header_of : stamp, ns, and frame id of a
    message. from_message : the packet of a message, whose origin an InputError names.
    """

    name: str
    kind: type
    to_message: Callable[[P, str], Any]
    header_of: Callable[[Any], tuple[int, str]]
    from_message: Callable[[Any, str], P]


class Delivery(Generic[P]):
    """One packet that has arrived, with its stamp and frame id."""

    def __init__(self, stamp_ns: int, frame_id: str, read: Callable[[], P]) -> None:
        self.stamp_ns, self.frame_id, self._read = stamp_ns, frame_id, read

    @cached_property
    def packet(self) -> P:
        """The packet; a message is decoded at the first access. Raises InputError for a damaged one."""
        return self._read()


@dataclass(eq=False)
class _Channel:
    """A topic within one process."""

    publishers: int = 0
    subscriptions: list[PacketSubscription] = field(default_factory=list)

    def joined(self, change: int) -> None:
        self.publishers += change
        for subscription in self.subscriptions:
            subscription.use_memory(self.publishers > 0)


_CHANNELS: WeakKeyDictionary[Context, dict[str, _Channel]] = WeakKeyDictionary()
_CHANGING = threading.RLock()  # nodes of several contexts may open topics at once


def _channel(node: Node, topic: str) -> _Channel:
    with _CHANGING:
        return _CHANNELS.setdefault(node.context, {}).setdefault(node.resolve_topic_name(topic), _Channel())


class PacketPublisher(Generic[P]):
    """The sending end of a topic of packets."""

    def __init__(self, node: Node, topic: PacketTopic[P]) -> None:
        self._outside, self._to_message = LazyPublisher(node, topic.kind, topic.name), topic.to_message
        self._channel = _channel(node, topic.name)
        with _CHANGING:
            self._channel.joined(+1)

    @property
    def is_wanted(self) -> bool:
        """Whether there is a subscriber outside this process."""
        return self._outside.is_wanted

    def publish(self, packet: P, frame_id: str) -> None:
        """Send a packet to everybody: first to this process's own, on this thread."""
        delivery = Delivery(packet.stamp_ns, frame_id, lambda: packet)
        for subscription in tuple(self._channel.subscriptions):
            subscription.deliver(delivery)
        self._outside.publish(self._to_message, packet, frame_id)

    def close(self) -> None:
        """Close the topic; subscribers in this process subscribe over the wire from now on."""
        self._outside.close()
        with _CHANGING:
            self._channel.joined(-1)


class PacketSubscription(Generic[P]):
    """The receiving end of a topic of packets.

    ``callback`` is called with every delivery: by the executor over the wire, on the publisher's thread within the
    process.
    """

    def __init__(self, node: Node, topic: PacketTopic[P], callback: Callable[[Delivery[P]], None]) -> None:
        self._node, self._topic, self.deliver = node, topic, callback
        self._where = node.resolve_topic_name(topic.name)
        self._wire: Subscription | None = None
        self._channel = _channel(node, topic.name)
        with _CHANGING:
            self._channel.subscriptions.append(self)
            self.use_memory(self._channel.publishers > 0)

    def use_memory(self, in_memory: bool) -> None:
        """Listen to this process, or to the wire."""
        if in_memory and self._wire is not None:
            self._node.destroy_subscription(self._wire)
            self._wire = None
        elif not in_memory and self._wire is None:
            topic = self._topic
            self._wire = self._node.create_subscription(topic.kind, topic.name, self._on_message, RESULT)

    def close(self) -> None:
        """Listen no longer."""
        with _CHANGING:
            self._channel.subscriptions.remove(self)
            self.use_memory(True)

    def _on_message(self, message: Any) -> None:
        try:
            if excess := oversize(message):
                raise InputError(f"a message is refused: {excess}")
            stamp_ns, frame_id = self._topic.header_of(message)
        except InputError as error:  # it is too large, or no message of ours
            if (health := getattr(self._node, "health", None)) is not None:
                health.count("large_messages")
            self._node.get_logger().warning(f"{self._topic.name}: {error}", throttle_duration_sec=LOG_EVERY_S)
            return
        self.deliver(Delivery(stamp_ns, frame_id, lambda: self._topic.from_message(message, self._where)))
