"""What a node reports on /diagnostics."""

from __future__ import annotations

import socket
import threading
from types import SimpleNamespace
from typing import TYPE_CHECKING

import pytest
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from rclpy.node import Node
from rclpy.parameter import Parameter

from sagoma_ros import health
from sagoma_ros.health import ERROR, WARN, NodeHealth
from sagoma_ros.messages import to_ns
from sagoma_ros.qos import RESULT

if TYPE_CHECKING:
    from node_probe import Spinner


class Listener:
    """A node with health, and the diagnostics that arrive from it at another node."""

    def __init__(self, ros: Spinner, **options: object) -> None:
        self.ros, self.received = ros, []
        listener = ros.add(Node("listener", context=ros.context))
        listener.create_subscription(DiagnosticArray, "/diagnostics", self._receive, RESULT)
        self.node = ros.add(Node("hull_server", context=ros.context, **options))
        self.health = NodeHealth(self.node)

    def _receive(self, message: DiagnosticArray) -> None:
        self.received += [message] * (message.status[0].name == "/hull_server")

    def next_status(self) -> DiagnosticStatus:
        before = len(self.received)
        self.ros.until(lambda: len(self.received) > before, "diagnostics")
        return self.received[-1].status[0]


def values(status: DiagnosticStatus) -> dict[str, str]:
    return {item.key: item.value for item in status.values}


def test_health_arrives_once_a_second_without_being_asked(ros: Spinner) -> None:
    listener = Listener(ros)
    listener.next_status()
    listener.next_status()
    first, second = (to_ns(message.header.stamp) for message in listener.received[:2])
    assert health.PERIOD_S == 1.0 and (second - first) * 1e-9 > 0.9 * health.PERIOD_S


def test_health_carries_counters_values_state_and_memory(ros: Spinner, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(health, "PERIOD_S", 0.1)
    listener = Listener(ros)
    listener.health.count("late")
    listener.health.count("late", 2)
    listener.health.set("backend", "cpu")
    listener.health.set("spread_ms", 0.123456)
    listener.health.status(WARN, "camera cam02 is silent")
    status = listener.next_status()
    assert (status.level, status.message, status.hardware_id) == (WARN, "camera cam02 is silent", socket.gethostname())
    found = values(status)
    assert (found["late"], found["backend"], found["spread_ms"]) == ("3", "cpu", "0.1235")
    assert found["host"] == socket.gethostname()
    assert 5 < float(found["rss_mb"]) < 5000
    assert listener.health.counter("late") == 3 and listener.health.counter("never_counted") == 0


def test_health_asks_for_further_values_at_every_report_and_keeps_its_status(ros: Spinner) -> None:
    node_health, counts = Listener(ros).health, iter(range(10))
    node_health.status(ERROR, "no rig")
    node_health.describe(lambda: {"asked": next(counts), "share": 0.123456})
    first, second = node_health.snapshot(), node_health.snapshot()
    assert (values(first)["asked"], values(second)["asked"], values(second)["share"]) == ("0", "1", "0.1235")
    assert first.level == second.level == ERROR  # a status stays until the next one


def test_health_arrives_while_simulated_time_stands_still(ros: Spinner, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(health, "PERIOD_S", 0.1)
    listener = Listener(ros, parameter_overrides=[Parameter("use_sim_time", value=True)])
    assert listener.next_status().name == "/hull_server"


def test_rate_and_cpu_are_those_since_the_last_report(ros: Spinner, monkeypatch: pytest.MonkeyPatch) -> None:
    clock = SimpleNamespace(wall=100.0, cpu=10.0)
    monkeypatch.setattr(health, "time", SimpleNamespace(monotonic=lambda: clock.wall, process_time=lambda: clock.cpu))
    node_health = Listener(ros).health
    for _ in range(90):
        node_health.tick()
    clock.wall, clock.cpu = 101.5, 10.3
    first = values(node_health.snapshot())
    clock.wall = 102.5
    second = values(node_health.snapshot())
    assert (first["rate_hz"], first["cpu_percent"], first["results"]) == ("60.0", "20", "90")
    assert (second["rate_hz"], second["cpu_percent"], second["results"]) == ("0.0", "0", "90")


def test_latency_percentiles_are_the_ages_of_the_results(ros: Spinner, monkeypatch: pytest.MonkeyPatch) -> None:
    listener = Listener(ros)
    node_health = listener.health
    now = SimpleNamespace(now=lambda: SimpleNamespace(nanoseconds=1_000_000_000))
    monkeypatch.setattr(listener.node, "get_clock", lambda: now)
    for milliseconds in range(101):
        node_health.tick(1_000_000_000 - milliseconds * 1_000_000)
    found = values(node_health.snapshot())
    assert [found[f"latency_p{p}_ms"] for p in (50, 95, 99)] == ["50.00", "95.00", "99.00"]
    assert "latency_p50_ms" not in values(node_health.snapshot())  # nothing since


def test_counters_lose_nothing_between_threads(ros: Spinner) -> None:
    node_health = Listener(ros).health
    threads = [threading.Thread(target=lambda: [node_health.count("frames") for _ in range(2000)]) for _ in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert node_health.counter("frames") == 8000
