"""Time as ROS people use it: a bag played twice and looped, simulated time, clocks that are set back."""

import argparse
import ast
import threading
from pathlib import Path

import pytest
import rclpy
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from rclpy.parameter import Parameter
from rclpy.qos import QoSProfile
from silhouette_bag import EPOCH_NS, write_silhouette_bag

from capture_rig.errors import InputError
from capture_rig.session import load_session
from ekf_tracker.ekf_node import EkfNode
from hull_server.hull_node import HullNode
from icp_tracker.icp_node import IcpNode
from mocap_pipeline.session_footage import exact_silhouettes
from sagoma_bringup.graph import LOSSLESS_SETTINGS, server_graph
from sagoma_ros.process import autostart, make_executor
from sagoma_tools.commands.recording import check_replay, replay_timed
from sagoma_tools.graph.ros_link import RosLink

SOURCES = Path(__file__).parents[1] / "src"
PATIENCE_S = 60.0  # only ever reached by a failing test
ROUNDS = 2
FPS = 30.0
EVERYTHING = QoSProfile(depth=1000)  # reliable; this thread also does the nodes' work


@pytest.fixture(scope="module")
def bag(three_cameras: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two seconds of silhouettes as the cameras send them: a T-pose, then movement."""
    session = load_session(three_cameras)
    folder = tmp_path_factory.mktemp("time") / "bag"
    return write_silhouette_bag(folder, session.rig, exact_silhouettes(session), FPS)


class Server:
    """The server's three nodes in simulated time, spun by a thread, and what they say."""

    def __init__(self, context: rclpy.Context, rig_file: Path) -> None:
        self.states: list[tuple[int, str]] = []  # stamp, state of every set
        self.latency_ms: dict[str, float] = {}
        self._changed = threading.Condition()
        common = {"autostart": True, "use_sim_time": True}
        chosen = LOSSLESS_SETTINGS | {
            "hull_server.tolerance_s": 0.5 / FPS,
            "hull_server.backend": "cpu",
            "icp_tracker.initial_pose.source": "t_pose",
        }
        self.nodes = []
        for spec, kind in zip(server_graph(rig_file), (HullNode, IcpNode, EkfNode), strict=True):
            own = {k.partition(".")[2]: v for k, v in chosen.items() if k.startswith(f"{spec.name}.")}
            given = {**spec.parameters, **own, **common}
            overrides = [Parameter(key, value=value) for key, value in given.items()]
            self.nodes.append(kind(context=context, parameter_overrides=overrides))
        self.ear = rclpy.create_node("ear", context=context)
        for topic, message, take in (
            ("mocap/state", DiagnosticStatus, self._on_state),
            ("/diagnostics", DiagnosticArray, self._on_diagnostics),
        ):
            self.ear.create_subscription(message, topic, take, EVERYTHING)
        self.executor = make_executor(context)
        for node in (*self.nodes, self.ear):
            self.executor.add_node(node)
            node.executor = self.executor
        self._ended = False
        self._thread = threading.Thread(target=self._spin, daemon=True)
        self._thread.start()
        assert autostart(self.nodes)

    @property
    def rounds(self) -> list[list[str]]:
        """The states of every playing of the bag: a new one begins where stamps go back."""
        found, last_ns = [[]], 0
        for stamp_ns, state in list(self.states):
            if stamp_ns <= last_ns:
                found.append([])
            last_ns = stamp_ns
            found[-1].append(state)
        return found

    @staticmethod
    def beginnings_counted(node) -> int:
        if isinstance(node, HullNode):
            return node.silhouettes.counters()["restarts"]
        return node.health.counter("restarts")

    def wait_for(self, happened, what: str) -> None:
        with self._changed:
            assert self._changed.wait_for(happened, PATIENCE_S), what

    def stop(self) -> None:
        self._ended = True
        self._thread.join()

    def close(self) -> None:
        self.stop()
        for node in self.nodes:
            node.close()
        for node in (*self.nodes, self.ear):
            self.executor.remove_node(node)
            node.destroy_node()
        self.executor.shutdown()

    def _spin(self) -> None:
        while not self._ended:
            self.executor.spin_once(timeout_sec=0.05)

    def _on_state(self, message: DiagnosticStatus) -> None:
        values = {pair.key: pair.value for pair in message.values}
        with self._changed:
            if "stamp_ns" in values:  # else it is of silence, not of a set
                self.states.append((int(values["stamp_ns"]), message.message))
            self._changed.notify_all()

    def _on_diagnostics(self, message: DiagnosticArray) -> None:
        for status in message.status:
            for pair in status.values:
                if pair.key == "latency_p50_ms":
                    self.latency_ms[status.name] = float(pair.value)


def arguments(bag: Path, **given: object) -> argparse.Namespace:
    usual = {"rate": 1.0, "topics": "inputs", "loop": False, "clock": None, "lockstep": False, "graph": False}
    return argparse.Namespace(bag=str(bag), output=None, **(usual | given))


@pytest.mark.slow
def test_bag_played_twice_and_looped_in_simulated_time_is_tracked_each_time(bag, ros_context, capfd):
    server = Server(ros_context, bag.with_suffix(".rig.yaml"))
    try:
        with RosLink("sagoma_replayer") as link:
            assert replay_timed(arguments(bag, clock=50.0), link, threading.Event()) == 0
            stop = threading.Event()
            looped = threading.Thread(target=replay_timed, args=(arguments(bag, clock=50.0, loop=True), link, stop))
            looped.start()
            server.wait_for(lambda: len(server.rounds) > ROUNDS, "the bag from the start for the third time")
            stop.set()
            looped.join()
        bag_now_ns = [node.get_clock().now().nanoseconds for node in server.nodes]
        rounds = server.rounds[:ROUNDS]
        tracked = [states.count("tracking") for states in rounds]
        # a busy machine may lose silhouettes of a bag played in real time, never a whole round
        assert min(tracked) > 10, f"sets tracked of {[len(states) for states in rounds]}: {tracked}"
        for node in server.nodes:  # a busy server is rounds behind the player
            server.wait_for(lambda node=node: server.beginnings_counted(node) >= ROUNDS, node.get_name())
        server.stop()
        lines = [line for line in capfd.readouterr().err.splitlines() if "a new beginning" in line]
        for node in server.nodes:  # each says it once a jump
            said = sum(f"[{node.get_name()}]" in line for line in lines)
            assert said == server.beginnings_counted(node), lines
        # the nodes' clocks are the bag's, and so ages are those of the sets
        assert all(EPOCH_NS <= now_ns < EPOCH_NS + 3 * 10**9 for now_ns in bag_now_ns)
        assert server.latency_ms and all(abs(age_ms) < 10e3 for age_ms in server.latency_ms.values())
    finally:
        server.close()


@pytest.mark.parametrize(
    ("given", "text"),
    [({"lockstep": True, "clock": 100.0}, "keeps no time"), ({"lockstep": True, "loop": True}, "keeps no time")],
)
def test_replay_refuses_a_clock_that_means_nothing(given, text):
    with pytest.raises(InputError, match=text):
        check_replay(arguments(Path("bag"), **given))


def node_files() -> list[Path]:
    """Every module of ours that makes a timer."""
    return [p for p in SOURCES.glob("*/*/**/*.py") if "/test/" not in str(p) and ".create_timer(" in p.read_text()]


@pytest.mark.parametrize("path", node_files(), ids=lambda path: path.stem)
def test_timers_run_on_the_steady_clock(path):
    """Timers are for people and processes that wait; on simulated time a node would stand still, or hurry, with it."""
    calls = [node for node in ast.walk(ast.parse(path.read_text())) if isinstance(node, ast.Call)]
    timers = [call for call in calls if isinstance(call.func, ast.Attribute) and call.func.attr == "create_timer"]
    assert timers
    for call in timers:
        assert "clock" in {keyword.arg for keyword in call.keywords}, f"{path}:{call.lineno}"
