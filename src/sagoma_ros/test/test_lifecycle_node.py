"""What a node reports on /diagnostics, and its lifecycle: failing transitions say why and release what they took."""

from __future__ import annotations

import socket
from dataclasses import dataclass
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any

import pytest
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from lifecycle_msgs.msg import Transition
from lifecycle_msgs.srv import ChangeState
from node_probe import FAILURE, SUCCESS
from rcl_interfaces.msg import SetParametersResult
from rcl_interfaces.srv import SetParameters
from rclpy.node import Node
from rclpy.parameter import Parameter
from std_msgs.msg import String

from capture_rig.errors import InputError
from capture_rig.settings import setting
from sagoma_ros import health
from sagoma_ros.health import ERROR, OK, WARN, NodeHealth
from sagoma_ros.node import SagomaNode
from sagoma_ros.process import autostart
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


# --- the lifecycle ----------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Settings:
    rig_file: str = setting("", "the rig")
    cameras: int = setting(4, "how many", low=1)


class Example(SagomaNode):
    """Fails to configure without a rig file; writes down which hooks were called."""

    Settings = Settings

    def __init__(self, **options: Any) -> None:
        super().__init__("example", **options)
        self.hooks: list[str] = []
        self.failing: dict[str, Exception] = {}
        self.results = self.create_lifecycle_publisher(String, "result", 10)

    def configure(self) -> None:
        self._called("configure")
        if not self.settings.rig_file:
            raise InputError("rig_file = '' is not a file", where="parameters of /example", remedy="Name a rig file.")

    def activate(self) -> None:
        self._called("activate")

    def deactivate(self) -> None:
        self._called("deactivate")

    def cleanup(self) -> None:
        self._called("cleanup")

    def _called(self, hook: str) -> None:
        self.hooks.append(hook)
        if hook in self.failing:
            raise self.failing[hook]

    @property
    def state(self) -> str:
        return self._state_machine.current_state[1]

    @property
    def shown(self) -> tuple[bytes, str]:
        status = self.health.snapshot()
        return status.level, status.message


def make_node(ros: Spinner, **overrides: Any) -> Example:
    parameters = [Parameter(key, value=value) for key, value in overrides.items()]
    return ros.add(Example(context=ros.context, parameter_overrides=parameters))


def test_hooks_are_called_in_the_order_of_the_lifecycle_and_each_state_is_shown(ros: Spinner) -> None:
    node = make_node(ros, rig_file="rig.yaml")
    shown = [(node.state, *node.shown)]
    for step in (node.trigger_configure, node.trigger_activate, node.trigger_deactivate, node.trigger_cleanup):
        assert step() == SUCCESS
        shown.append((node.state, *node.shown))
    assert node.hooks == ["configure", "activate", "deactivate", "cleanup"]
    assert shown == [
        ("unconfigured", OK, "unconfigured"),
        ("inactive", OK, "configured, inactive"),
        ("active", OK, "active"),
        ("inactive", OK, "suspended"),
        ("unconfigured", OK, "unconfigured"),
    ]
    assert node.settings == Settings("rig.yaml", 4)


def test_failing_configure_says_why_cleans_up_and_works_once_the_parameter_was_mended(ros: Spinner) -> None:
    node = make_node(ros)
    assert node.trigger_configure() == FAILURE
    assert (node.state, node.hooks) == ("unconfigured", ["configure", "cleanup"])
    assert node.shown == (ERROR, "parameters of /example: rig_file = '' is not a file. Name a rig file.")
    node.failing["cleanup"] = OSError("stuck")
    assert node.trigger_configure() == FAILURE and node.state == "unconfigured"
    (result,) = node.set_parameters([Parameter("rig_file", value="rig.yaml")])
    assert result.successful
    assert node.trigger_configure() == SUCCESS
    assert (node.state, node.shown) == ("inactive", (OK, "configured, inactive"))
    assert node.settings.rig_file == "rig.yaml"


def test_unexpected_error_in_a_hook_fails_the_transition_and_not_the_process(ros: Spinner) -> None:
    node = make_node(ros, rig_file="rig.yaml")
    node.failing["configure"] = ZeroDivisionError("a defect")
    assert node.trigger_configure() == FAILURE
    assert node.state == "unconfigured"
    assert node.shown == (ERROR, "ZeroDivisionError('a defect')")
    assert node.health.counter("unexpected_errors") == 1
    node.failing.clear()
    assert node.trigger_configure() == SUCCESS


def test_failing_activate_leaves_the_node_inactive_and_failing_deactivate_active(ros: Spinner) -> None:
    node = make_node(ros, rig_file="rig.yaml")
    node.failing["activate"] = InputError("the camera is busy")
    node.trigger_configure()
    assert node.trigger_activate() == FAILURE
    assert node.state == "inactive" and not node.results.is_activated
    assert node.hooks == ["configure", "activate", "deactivate"]
    node.failing = {"deactivate": OSError("stuck")}
    assert node.trigger_activate() == SUCCESS
    assert node.trigger_deactivate() == FAILURE
    assert node.state == "active" and node.results.is_activated


def test_shutdown_and_close_release_everything_from_any_state(ros: Spinner) -> None:
    node, unused = make_node(ros, rig_file="rig.yaml"), make_node(ros)
    node.trigger_configure()
    node.trigger_activate()
    assert node.trigger_shutdown() == SUCCESS and node.state == "finalized"
    assert node.hooks[-2:] == ["deactivate", "cleanup"]
    unused.close()
    assert unused.hooks == ["deactivate", "cleanup"]


@pytest.mark.parametrize(
    ("given", "succeeds", "state", "hooks"),
    [
        ({"rig_file": "rig.yaml"}, True, "unconfigured", []),
        ({"rig_file": "rig.yaml", "autostart": True}, True, "active", ["configure", "activate"]),
        ({"autostart": True}, False, "unconfigured", ["configure", "cleanup"]),
    ],
    ids=["not asked for", "asked for", "cannot configure"],
)
def test_autostart_configures_and_activates_where_asked_for(ros: Spinner, given, succeeds, state, hooks) -> None:
    node = make_node(ros, **given)
    assert autostart([node]) == succeeds
    assert (node.state, node.hooks) == (state, hooks)


def test_impossible_and_failed_transitions_are_answered_with_no_and_kill_nothing(ros: Spinner) -> None:
    node = make_node(ros)
    client = node.create_client(ChangeState, "example/change_state")
    ros.until(client.service_is_ready, "the lifecycle service")

    def change_state(transition: int) -> bool:
        future = client.call_async(ChangeState.Request(transition=Transition(id=transition)))
        ros.until(future.done, "the answer of the lifecycle service")
        return future.result().success

    assert not change_state(Transition.TRANSITION_ACTIVATE)
    assert not change_state(Transition.TRANSITION_CONFIGURE)  # no rig file
    assert node.state == "unconfigured"
    node.set_parameters([Parameter("rig_file", value="rig.yaml")])
    assert change_state(Transition.TRANSITION_CONFIGURE) and node.state == "inactive"


def test_change_of_a_configured_node_says_when_it_takes_effect(ros: Spinner, capfd) -> None:
    """Over the service, as ``ros2 param set`` asks: it prints the reason of a success, too."""
    node = make_node(ros, rig_file="rig.yaml")
    client_node = ros.add(Node("param_set", context=ros.context))
    client = client_node.create_client(SetParameters, f"{node.get_fully_qualified_name()}/set_parameters")
    ros.until(client.service_is_ready)

    def set_cameras(value: int) -> SetParametersResult:
        change = Parameter("cameras", value=value).to_parameter_msg()
        answer = client.call_async(SetParameters.Request(parameters=[change]))
        ros.until(answer.done)
        return answer.result().results[0]

    assert (set_cameras(2).successful, set_cameras(3).reason) == (True, "")
    assert node.trigger_configure() == SUCCESS and node.trigger_activate() == SUCCESS
    late = set_cameras(5)
    assert late.successful and late.reason.startswith("takes effect at the next configure")
    assert node.settings.cameras == 3 and "cameras: takes effect at the next configure" in capfd.readouterr().err
    assert node.trigger_deactivate() == SUCCESS and node.trigger_cleanup() == SUCCESS
    assert set_cameras(6).reason == "" and node.trigger_configure() == SUCCESS
    assert node.settings.cameras == 6
