"""Collects the nodes' last diagnostics and shows them as a live table, one line a node."""

from __future__ import annotations

import math
import re
import threading
import time
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from typing import Any, cast

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from rclpy.node import Node
from rich.table import Table
from rich.text import Text

from sagoma_ros.health import PERIOD_S
from sagoma_ros.messages import to_ns, values_of

from ..console import plain_table
from .ros_link import is_camera
from .topics import DIAGNOSTICS_TOPIC, LOSSLESS

STALE_S = 3 * PERIOD_S
LATENCY = "latency_p50_ms"
_LOSSES = "ahead unexpected dropped late missing refused timeout backwards duplicate bad lost incomplete stalls"
LOSS_WORDS = (*_LOSSES.split(), "control_losses")
COUNT = re.compile(r"[0-9]{1,18}")
LEVEL_STYLE = {DiagnosticStatus.OK: "green", DiagnosticStatus.WARN: "yellow", DiagnosticStatus.ERROR: "red"}


@dataclass(frozen=True)
class NodeReport:
    """One node's last diagnostics, and the most by which a stamp was ahead of its arrival, seconds."""

    level: bytes
    message: str
    values: Mapping[str, str] = field(default_factory=dict)
    heard_s: float = 0.0
    lead_s: float = -math.inf

    def losses(self) -> dict[str, int]:
        """Return the counters above zero of input or work that was lost."""
        counters = {key: int(text) for key, text in self.values.items() if COUNT.fullmatch(text)}
        return {k: n for k, n in counters.items() if n and any(word in k for word in LOSS_WORDS)}


class DiagnosticsTable:
    """Collects the diagnostics of the nodes of one graph; safe to read from any thread."""

    def __init__(self, node: Node) -> None:
        self._heard = threading.Condition()
        self._reports: dict[str, NodeReport] = {}
        on_message = cast(Callable[[Any], None], self._on_message)  # rclpy's annotation has the message alone
        self._subscription = node.create_subscription(DiagnosticArray, DIAGNOSTICS_TOPIC, on_message, LOSSLESS)

    def report(self, name: str) -> NodeReport | None:
        """Return the last report of the node with this fully qualified name."""
        with self._heard:
            return self._reports.get(name)

    def names(self) -> tuple[str, ...]:
        """Return every node that has reported so far."""
        with self._heard:
            return tuple(sorted(self._reports))

    def wait_for(self, names: Iterable[str], timeout_s: float) -> bool:
        """Return True as soon as every one of these nodes has reported, False after ``timeout_s``."""
        wanted = set(names)
        return self.wait_until(lambda: wanted <= self._reports.keys(), timeout_s)

    def wait_until(self, done: Callable[[], bool], timeout_s: float) -> bool:
        """Return True as soon as ``done``, called at every report, is true, False after ``timeout_s``."""
        with self._heard:
            return self._heard.wait_for(done, timeout_s)

    def table(self, names: Mapping[str, str], states: Mapping[str, str], *, now_s: float | None = None) -> Table:
        """Return one line a node (full name -> label): state, rate, latency, losses, memory, message."""
        now_s = time.monotonic() if now_s is None else now_s
        table = plain_table("", ("node", "state"), ("rate Hz", "latency p50 ms", "rss MB"), ("lost", "says"))
        for name, label in names.items():
            table.add_row(label, *_row(states.get(name, "?"), self.report(name), now_s))
        return table

    def _on_message(self, message: DiagnosticArray, info: Mapping[str, int]) -> None:
        heard_s = time.monotonic()
        lead_s = 1e-9 * (to_ns(message.header.stamp) - info["received_timestamp"])
        with self._heard:
            for status in message.status:
                values = values_of(status)
                if not is_camera(status.name) and not self._ages_are_latencies():
                    values = {key: value for key, value in values.items() if not key.startswith("latency")}
                before = self._reports.get(status.name)
                most_s = lead_s if before is None else max(before.lead_s, lead_s)
                self._reports[status.name] = NodeReport(status.level, status.message, values, heard_s, most_s)
            self._heard.notify_all()

    def _ages_are_latencies(self) -> bool:
        """Return whether a camera reports a latency: those that play footage slower than its stamps do not."""
        cameras = [report.values for name, report in self._reports.items() if is_camera(name)]
        return not cameras or any(LATENCY in values for values in cameras)


def _row(state: str, report: NodeReport | None, now_s: float) -> tuple[str | Text, ...]:
    if report is None:
        return state, "", "", "", "", ""
    values = report.values
    losses = ", ".join(f"{count} {key}" for key, count in report.losses().items())
    silence_s = now_s - report.heard_s
    says = Text(report.message, style=LEVEL_STYLE.get(report.level, "red"))
    if silence_s > STALE_S:
        says = Text(f"silent for {silence_s:.0f} s", style="red")
    return state, values.get("rate_hz", ""), values.get(LATENCY, ""), values.get("rss_mb", ""), losses, says
