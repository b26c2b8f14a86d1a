"""The newest message of each topic that somebody looks at; while nobody does, the graph is left alone."""

from __future__ import annotations

import threading
from collections.abc import Iterable
from functools import partial
from typing import Any

from rclpy.node import Node
from rclpy.qos import QoSProfile, ReliabilityPolicy
from rclpy.serialization import deserialize_message

from ..graph.namespace import in_graph
from ..graph.topics import message_class

NEWEST = QoSProfile(depth=1, reliability=ReliabilityPolicy.BEST_EFFORT)
"""A page that is late drops what it missed, and no publisher waits for it."""


class Feed:
    """Keeps serialized messages as they come, and reads one only when the page draws it; safe from any thread."""

    def __init__(self, node: Node) -> None:
        self._node = node
        self._lock = threading.Lock()
        self._subscriptions: dict[str, Any] = {}
        self._kinds: dict[str, Any] = {}
        self._newest: dict[str, bytes] = {}

    def watch(self, wanted: Iterable[tuple[str, str]]) -> None:
        """Subscribe to these topics (name, type), and to no others any more."""
        kinds = dict(wanted)
        for name in [name for name in self._subscriptions if name not in kinds]:
            self._node.destroy_subscription(self._subscriptions.pop(name))
            with self._lock:
                self._newest.pop(name, None)
        for name, msgtype in kinds.items():
            if name not in self._subscriptions:
                self._kinds[name] = message_class(msgtype)
                keep = partial(self._keep, name)
                self._subscriptions[name] = self._node.create_subscription(
                    self._kinds[name], in_graph(self._node, name), keep, NEWEST, raw=True
                )

    @property
    def watched(self) -> frozenset[str]:
        """The topics that are subscribed to."""
        return frozenset(self._subscriptions)

    def take(self, name: str) -> Any | None:
        """Return the newest message of a topic, once; None while there is no newer one."""
        with self._lock:
            data = self._newest.pop(name, None)
        return None if data is None else deserialize_message(data, self._kinds[name])

    def _keep(self, name: str, data: bytes) -> None:
        with self._lock:
            if name in self._kinds:
                self._newest[name] = data
