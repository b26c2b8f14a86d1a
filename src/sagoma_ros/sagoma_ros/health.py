"""A node's diagnostics on /diagnostics, once a second."""

from __future__ import annotations

import os
import threading
import time
from collections import Counter, deque
from collections.abc import Callable, Mapping

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from rclpy.clock import Clock, ClockType, ROSClock
from rclpy.node import Node

from .messages import HOST, key_values
from .qos import RESULT

PERIOD_S = 1.0
LOG_EVERY_S = 5.0  # an error that recurs with every message
LATENCY_SAMPLES = 1000
_PAGE_BYTES = os.sysconf("SC_PAGE_SIZE")

OK, WARN, ERROR = DiagnosticStatus.OK, DiagnosticStatus.WARN, DiagnosticStatus.ERROR


class NodeHealth:
    """Counters, rate, latency, memory and state of one node, published at 1 Hz whatever its lifecycle state.

    Safe to call from any thread. ``count`` accumulates since the start; ``tick`` marks one result delivered, with its
    age; ``status`` sets level and message until the next call.
    """

    def __init__(self, node: Node) -> None:
        self._node = node
        self.hardware_id = HOST
        """What the node's results depend on, as diagnostics have it: its computer, or a camera's serial number."""
        self._lock = threading.Lock()
        self._counters: Counter[str] = Counter()
        self._values: dict[str, str] = {"host": HOST}
        self._latencies_ns: deque[int] = deque(maxlen=LATENCY_SAMPLES)
        self._level, self._message = OK, "starting"
        self._source: Callable[[], Mapping[str, object]] = dict
        self._ticks = 0
        self._last = (time.monotonic(), 0, time.process_time())
        self._publisher = node.create_publisher(DiagnosticArray, "/diagnostics", RESULT)
        # on the steady clock: a node that follows simulated time reports even while that stands still
        self._timer = node.create_timer(PERIOD_S, self.publish, clock=Clock(clock_type=ClockType.STEADY_TIME))

    def count(self, name: str, amount: int = 1) -> None:
        """Add to a counter."""
        with self._lock:
            self._counters[name] += amount

    def counter(self, name: str) -> int:
        """Return the counter's value."""
        with self._lock:
            return self._counters[name]

    def set(self, key: str, value: object) -> None:
        """Set a key that is published as text."""
        with self._lock:
            self._values[key] = _text(value)

    def describe(self, source: Callable[[], Mapping[str, object]]) -> None:
        """Call ``source`` for further values at every report, which would cost too much at every result."""
        self._source = source

    def tick(self, stamp_ns: int | None = None) -> None:
        """Count one result as delivered; with its capture stamp, its age is taken as latency."""
        age_ns = None if stamp_ns is None else self._now_ns() - stamp_ns
        with self._lock:
            self._ticks += 1
            if age_ns is not None:
                self._latencies_ns.append(age_ns)

    def _now_ns(self) -> int:
        """Return the node's time; system time is read without rclpy's objects, as every result needs it."""
        clock = self._node.get_clock()
        of_system = isinstance(clock, ROSClock) and not clock.ros_time_is_active
        return time.time_ns() if of_system else clock.now().nanoseconds

    def status(self, level: bytes, message: str) -> None:
        """Level (OK, WARN, ERROR) and one line of text."""
        with self._lock:
            self._level, self._message = level, message

    def publish(self) -> None:
        """Publish now; the timer does so once a second."""
        message = DiagnosticArray(status=[self.snapshot()])
        message.header.stamp = self._node.get_clock().now().to_msg()
        self._publisher.publish(message)

    def snapshot(self) -> DiagnosticStatus:
        """Return the status as published; rates, processor time and latencies are those since the last call."""
        now, cpu = time.monotonic(), time.process_time()
        described = {key: _text(value) for key, value in self._source().items()}
        with self._lock:
            self._values |= described
            then, ticks_then, cpu_then = self._last
            elapsed = max(now - then, 1e-6)
            values = {
                "rate_hz": f"{(self._ticks - ticks_then) / elapsed:.1f}",
                "results": str(self._ticks),
                **_percentiles_ms(sorted(self._latencies_ns)),
                "cpu_percent": f"{100 * (cpu - cpu_then) / elapsed:.0f}",
                "rss_mb": f"{resident_bytes() / 1e6:.1f}",
                **{name: str(count) for name, count in sorted(self._counters.items())},
                **self._values,
            }
            self._last = (now, self._ticks, cpu)
            self._latencies_ns.clear()
            level, text = self._level, self._message
        return DiagnosticStatus(
            level=level,
            name=self._node.get_fully_qualified_name(),
            message=text,
            hardware_id=self.hardware_id,
            values=key_values(values),
        )


def _text(value: object) -> str:
    return f"{value:.4g}" if isinstance(value, float) else str(value)


def resident_bytes() -> int:
    """Resident memory of this process."""
    with open("/proc/self/statm") as file:
        return int(file.read().split()[1]) * _PAGE_BYTES


def _percentiles_ms(ordered_ns: list[int]) -> dict[str, str]:
    if not ordered_ns:
        return {}
    last = len(ordered_ns) - 1
    return {f"latency_p{p}_ms": f"{ordered_ns[round(p / 100 * last)] / 1e6:.2f}" for p in (50, 95, 99)}
