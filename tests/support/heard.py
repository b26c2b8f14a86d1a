"""Messages of a topic as they come, for tests that wait for them beside a running graph."""

from __future__ import annotations

import threading
from collections.abc import Callable
from typing import Any

from rclpy.node import Node

from sagoma_ros.qos import RESULT


class Heard:
    """Keeps the messages of a topic; any thread may wait for more.

    kept : what ``keep`` makes of each message, in order.
    """

    def __init__(
        self, node: Node, kind: type, topic: str, patience_s: float, keep: Callable[[Any], Any] = lambda message: None
    ) -> None:
        self._came, self._patience_s, self._keep, self.kept = threading.Condition(), patience_s, keep, list[Any]()
        self._subscription = node.create_subscription(kind, topic, self._on_message, RESULT)

    def wait_for(self, count: int, chosen: Callable[[Any], bool] = lambda kept: True) -> bool:
        """True as soon as there are so many that are ``chosen``, False after the patience."""
        with self._came:
            return self._came.wait_for(lambda: sum(map(chosen, self.kept)) >= count, self._patience_s)

    def wait_for_more(self, count: int) -> bool:
        """True as soon as so many more have come."""
        return self.wait_for(len(self.kept) + count)

    def _on_message(self, message: Any) -> None:
        kept = self._keep(message)
        with self._came:
            self.kept.append(kept)
            self._came.notify_all()
