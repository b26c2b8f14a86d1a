"""Notices that a node's input has stopped, whatever the middleware still believes."""

from __future__ import annotations

import time
from collections.abc import Callable

from rclpy.clock import Clock, ClockType
from rclpy.node import Node

LOOK_S = 0.2  # with the default of `stale_after_s` silence is reported within a second
REPEAT_S = 1.0


class SilenceWatch:
    """Calls ``on_silence(seconds)`` when nothing has been heard for ``stale_after_s``, and each second from then on.

    It counts from its construction; by the steady clock: a person waits, whatever time the input is of. Never while
    ``stale_after_s`` is 0. The call comes on the executor's thread.
    """

    def __init__(self, node: Node, stale_after_s: float, on_silence: Callable[[float], None]) -> None:
        self._node, self._stale_after_s, self._on_silence = node, stale_after_s, on_silence
        self._timer = None
        self.heard()
        if stale_after_s > 0.0:
            self._timer = node.create_timer(LOOK_S, self._look, clock=Clock(clock_type=ClockType.STEADY_TIME))

    def heard(self) -> None:
        """Take note that input has come; any thread."""
        self._heard_s = time.monotonic()
        self._due_s = self._heard_s + self._stale_after_s

    def close(self) -> None:
        """Watch no longer."""
        if self._timer is not None:
            self._node.destroy_timer(self._timer)
            self._timer = None

    def _look(self) -> None:
        now_s = time.monotonic()
        if now_s >= self._due_s:
            self._due_s = now_s + REPEAT_S
            self._on_silence(now_s - self._heard_s)
