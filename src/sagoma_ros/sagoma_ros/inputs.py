"""What comes to a node: whether it comes at all, in the order of its stamps, and the thread that works on it."""

from __future__ import annotations

import threading
import time
from collections import deque
from collections.abc import Callable
from typing import Generic, TypeVar

from rclpy.clock import Clock, ClockType

from mocap_packets.frame_set import TIME_JUMP_NS

from .health import PERIOD_S
from .node import SagomaNode

T = TypeVar("T")

CHECK_S = PERIOD_S / 5  # with the default of `stale_after_s` silence is reported within a second


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


class Worker(Generic[T]):
    """Calls ``function(item)`` for every item put, in order, on a thread of its own.

    depth : at most this many items wait; one more drops the oldest and calls ``on_drop``, once for each item that
    will never be worked on (those that :meth:`close` leaves, too).
    on_error : gets every exception that ``function`` raises; the worker goes on with the next item.
    """

    def __init__(
        self,
        name: str,
        function: Callable[[T], None],
        depth: int,
        *,
        on_drop: Callable[[], None],
        on_error: Callable[[Exception], None],
    ) -> None:
        self._function, self._on_drop, self._on_error = function, on_drop, on_error
        self._depth = depth
        self._items: deque[T] = deque()
        self._changed = threading.Condition()
        self._open = True
        self._thread = threading.Thread(target=self._run, name=name, daemon=True)
        self._thread.start()

    @property
    def waiting(self) -> int:
        """Items that wait, without the one being worked on."""
        return len(self._items)

    def put(self, item: T) -> None:
        """Queue an item; never blocks. After :meth:`close` it is dropped."""
        with self._changed:
            if self._open:
                self._items.append(item)
            dropping = not self._open or len(self._items) > self._depth
            if self._open and dropping:
                self._items.popleft()
            self._changed.notify_all()
        if dropping:
            self._on_drop()

    def put_blocking(self, item: T) -> None:
        """Queue an item; wait while ``depth`` items wait already: for a stage that must not overtake the next one."""
        with self._changed:
            self._changed.wait_for(lambda: len(self._items) < self._depth or not self._open)
        self.put(item)

    def close(self, *, finish: bool = False, timeout_s: float = 5.0) -> bool:
        """Stop the thread, after the waiting items when ``finish``; True when it ended within ``timeout_s``."""
        with self._changed:
            self._open = False
            left = 0 if finish else len(self._items)
            if not finish:
                self._items.clear()
            self._changed.notify_all()
        for _ in range(left):
            self._on_drop()
        if threading.current_thread() is self._thread:
            return True
        self._thread.join(timeout_s)
        return not self._thread.is_alive()

    def _run(self) -> None:
        while True:
            with self._changed:
                self._changed.wait_for(lambda: self._items or not self._open)
                if not self._items:
                    return
                item = self._items.popleft()
                self._changed.notify_all()
            try:
                self._function(item)
            except Exception as error:
                self._on_error(error)
