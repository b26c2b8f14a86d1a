"""Finds the rate that a running graph holds: the hull server's own answer under load, once it no longer falls."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable

import psutil
from diagnostic_msgs.msg import DiagnosticArray
from rclpy.node import Node

from mocap_packets.thinning import EVERY_FRAME, FrameDecimation
from sagoma_ros.qos import LATCHED
from sagoma_ros.thinning import TOPIC, read_thinning

SETTLED_S = 3.0  # without a fall of the rate: a queue that grows by 5 % stands by then
LONGEST_S = 12.0  # a machine whose load changes all the time never settles
POLL_S = 0.1


class RuleHistory:
    """The rules of thinning that were published, each with its time and the reason; any thread may read."""

    def __init__(self) -> None:
        self._rules: list[tuple[float, FrameDecimation, str]] = []

    def add(self, now_s: float, rule: FrameDecimation, text: str) -> None:
        """Add a rule that was published."""
        self._rules.append((now_s, rule, text))

    @property
    def newest(self) -> tuple[FrameDecimation, str]:
        """The rule in force, and why; every frame before there was any."""
        return self._rules[-1][1:] if self._rules else (EVERY_FRAME, "")

    def last_fall_s(self, since_s: float) -> float | None:
        """Return when the rate fell last since then; None when it did not."""
        falls = [
            now_s
            for (_, before, _), (now_s, rule, _) in zip(self._rules, self._rules[1:], strict=False)
            if now_s >= since_s and rule.fraction < before.fraction
        ]
        return falls[-1] if falls else None


class HeldRate:
    """Subscribes to the rules of a running graph; its node must be spun by another thread."""

    def __init__(self, node: Node, now_s: Callable[[], float] = time.monotonic) -> None:
        self._node, self._now_s, self.history = node, now_s, RuleHistory()
        self._subscription = node.create_subscription(DiagnosticArray, TOPIC, self._on_rule, LATCHED)

    def close(self) -> None:
        """End the subscription."""
        self._node.destroy_subscription(self._subscription)

    def settle(self, cancel: threading.Event) -> None:
        """Return once the rate has not fallen for SETTLED_S, at the latest after LONGEST_S."""
        began_s = self._now_s()
        while not self.is_settled(began_s) and not cancel.wait(POLL_S):
            pass

    def is_settled(self, began_s: float) -> bool:
        """Return whether the rate has not fallen for SETTLED_S since ``began_s``, or LONGEST_S have passed."""
        now_s = self._now_s()
        return now_s - (self.history.last_fall_s(began_s) or began_s) >= SETTLED_S or now_s - began_s >= LONGEST_S

    def _on_rule(self, message: DiagnosticArray) -> None:
        self.history.add(self._now_s(), read_thinning(message, TOPIC), message.status[0].message)


class OtherPrograms:
    """Measures what programs other than this process and its children take of the machine's processors."""

    def __init__(self) -> None:
        self._before = self._times()

    def share(self) -> float:
        """Return their share (0 to 1) of all processors since construction."""
        busy, total, own = (now - then for now, then in zip(self._times(), self._before, strict=True))
        return min(max((busy - own) / total, 0.0), 1.0) if total > 0 else 0.0

    @staticmethod
    def _times() -> tuple[float, float, float]:
        machine = psutil.cpu_times()
        idle = machine.idle + getattr(machine, "iowait", 0.0)
        own = 0.0
        for process in (psutil.Process(), *psutil.Process().children(recursive=True)):
            try:
                times = process.cpu_times()
            except psutil.Error:  # it has ended meanwhile
                continue
            own += times.user + times.system
        return sum(machine[:8]) - idle, sum(machine[:8]), own
