"""One thread that serves many cameras: their sockets, their exposures, their timers."""

from __future__ import annotations

import heapq
import itertools
import logging
import selectors
import socket
import threading
import time
from collections.abc import Callable
from concurrent.futures import Future
from typing import Any, TypeVar

from capture_rig.stamps import UTC, CaptureClock

T = TypeVar("T")

_log = logging.getLogger(__name__)
_LONGEST_WAIT_NS = 1_000_000_000
_FINE_NS = 1_000_000  # epoll counts in milliseconds; what is left is slept


class Timer:
    """A callback that waits for its time; cancel() makes it never run."""

    __slots__ = ("_callback", "when_ns")

    def __init__(self, when_ns: int, callback: Callable[[], object]) -> None:
        self.when_ns, self._callback = when_ns, callback

    def cancel(self) -> None:
        self._callback = lambda: None

    def run(self) -> None:
        self._callback()


class EventLoop:
    """Callbacks for readable sockets and for instants of the cameras' clock (ns), one at a time, in one thread.

    clock : the time of everything that a camera does but for what goes by the network's pace (:meth:`call_later`);
        UTC, unless in slow motion.

    Everything that a camera does happens in here, so that its parts need no locks; other threads come in by
    :meth:`call`. An error in one callback is logged; the others go on.
    """

    def __init__(self, name: str = "gige", clock: CaptureClock = UTC) -> None:
        self.clock = clock
        self._selector = selectors.DefaultSelector()
        self._readers: dict[Any, Callable[[], object]] = {}
        self._timers: list[tuple[int, int, Timer]] = []
        self._order = itertools.count()
        self._calls: list[tuple[Callable[[], Any], Future]] = []
        self._lock = threading.Lock()
        self._running = False
        self._thread = threading.Thread(target=self._run, name=name, daemon=True)
        self._waker, self._woken = socket.socketpair()
        for end in (self._waker, self._woken):
            end.setblocking(False)
        self.add_reader(self._woken, self._take_calls)

    def start(self) -> None:
        self._running = True
        self._thread.start()

    def stop(self) -> None:
        """Ends the thread, and waits for it; what has not run yet never will."""
        if self._thread.is_alive():
            self.call(self._end)
            self._thread.join()
        with self._lock:
            waiting, self._calls = self._calls, []
        for _, future in waiting:
            future.cancel()
        self._selector.close()
        self._waker.close()
        self._woken.close()

    def add_reader(self, sock: socket.socket, callback: Callable[[], object]) -> None:
        """Calls back whenever ``sock`` can be read. Only from within the loop, or before it starts."""
        self._selector.register(sock, selectors.EVENT_READ)
        self._readers[sock] = callback

    def remove_reader(self, sock: socket.socket) -> None:
        """Ends the calls for it, even for data that was already noticed."""
        self._selector.unregister(sock)
        del self._readers[sock]

    def call_at(self, when_ns: int, callback: Callable[[], object]) -> Timer:
        """Calls back at an instant of the cameras' clock. Only from within the loop."""
        timer = Timer(when_ns, callback)
        heapq.heappush(self._timers, (when_ns, next(self._order), timer))
        return timer

    def call_later(self, delay_ns: int, callback: Callable[[], object]) -> Timer:
        """Calls back after so long, whatever the speed of the cameras' clock. Only from within the loop."""
        return self.call_at(self.clock.at_utc(time.time_ns() + delay_ns), callback)

    def call(self, callback: Callable[[], T]) -> T:
        """Runs in the loop's thread and returns what it returns (or raises); from any thread."""
        if threading.current_thread() is self._thread:
            return callback()
        if not self._running:
            raise RuntimeError("the loop is not running")
        future: Future = Future()
        with self._lock:
            self._calls.append((callback, future))
        self._waker.send(b"!")
        return future.result()

    def _end(self) -> None:
        self._running = False

    def _run(self) -> None:
        while self._running:
            wait_ns = self._wait_ns()
            for key, _ in self._selector.select(max(wait_ns - _FINE_NS, 0) // 1_000_000 / 1e3):
                if (callback := self._readers.get(key.fileobj)) is not None:  # an earlier one may have removed it
                    self._guarded(callback)
            if 0 < (left_ns := self._wait_ns()) < 2 * _FINE_NS:
                time.sleep(left_ns * 1e-9)
            self._run_due()

    def _wait_ns(self) -> int:
        if not self._timers:
            return _LONGEST_WAIT_NS
        return min(self.clock.wait_ns(self._timers[0][0]), _LONGEST_WAIT_NS)

    def _run_due(self) -> None:
        now_ns = self.clock.now_ns()
        while self._running and self._timers and self._timers[0][0] <= now_ns:
            self._guarded(heapq.heappop(self._timers)[2].run)

    def _take_calls(self) -> None:
        try:
            self._woken.recv(4096)
        except BlockingIOError:
            return
        with self._lock:
            calls, self._calls = self._calls, []
        for callback, future in calls:
            try:
                future.set_result(callback())
            except BaseException as error:
                future.set_exception(error)

    def _guarded(self, callback: Callable[[], object]) -> None:
        try:
            callback()
        except Exception:
            _log.exception("a simulated camera failed; it goes on")
