"""The frame sets that come to a node: whether they come at all, and in the order of their stamps."""

from __future__ import annotations

import time
from collections.abc import Callable

from rclpy.clock import Clock, ClockType

from mocap_packets.frame_set import TIME_JUMP_NS

from .health import PERIOD_S
from .node import SagomaNode

CHECK_S = 0.2  # with the default of `stale_after_s` silence is reported within a second


class InputWatchdog:
    """Calls ``on_silence(seconds)`` when nothing has come for ``stale_after_s``, and each second from then on.

    It counts from its construction; by the steady clock: a person waits, whatever time the input is of. Never while
    ``stale_after_s`` is 0. The call comes on the executor's thread.
    """

    def __init__(self, node: SagomaNode, stale_after_s: float, on_silence: Callable[[float], None]) -> None:
        self._node, self._stale_after_s, self._on_silence = node, stale_after_s, on_silence
        self._timer = None
        self.reset()
        if stale_after_s > 0.0:
            self._timer = node.create_timer(CHECK_S, self._check, clock=Clock(clock_type=ClockType.STEADY_TIME))

    def reset(self) -> None:
        """Count from now on: input has come; any thread."""
        self._heard_s = time.monotonic()
        self._due_s = self._heard_s + self._stale_after_s

    def close(self) -> None:
        """Watch no longer."""
        if self._timer is not None:
            self._node.destroy_timer(self._timer)
            self._timer = None

    def _check(self) -> None:
        now_s = time.monotonic()
        if now_s >= self._due_s:
            self._due_s = now_s + PERIOD_S
            self._on_silence(now_s - self._heard_s)


class StampOrder:
    """Admits frame sets in the order of their stamps; a jump back of `TIME_JUMP_NS` or more is a new beginning.

    A bag played again, footage that starts again, a clock that was set back: the hull server has decided it by the
    majority of its cameras, so one set is enough here. A shorter step back is a set that came twice or too late.
    """

    def __init__(self, node: SagomaNode, on_restart: Callable[[], None]) -> None:
        """``on_restart`` is called before the first set of a new beginning is admitted."""
        self._node, self._on_restart = node, on_restart
        self._last_ns: int | None = None

    def reset(self) -> None:
        """Admit any stamp next."""
        self._last_ns = None

    def admits(self, stamp_ns: int) -> bool:
        """Return whether a set is to be processed; the others are counted as ``backward_stamps``."""
        back_ns = -1 if self._last_ns is None else self._last_ns - stamp_ns
        if 0 <= back_ns < TIME_JUMP_NS:
            self._node.health.count("backward_stamps")
            return False
        self._last_ns = stamp_ns
        if back_ns > 0:
            self._node.health.count("restarts")
            text = f"stamps went back by {1e-9 * back_ns:.3f} s: a new beginning, for everybody"
            self._node.get_logger().warning(text)
            self._on_restart()
        return True
