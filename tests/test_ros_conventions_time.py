"""Time as ROS people use it: a bag played twice and looped, simulated time, clocks that are set back."""

import argparse
import ast
import re
import threading
from collections import Counter
from pathlib import Path

import pytest
from diagnostic_msgs.msg import DiagnosticStatus
from heard import Heard
from silhouette_bag import write_silhouette_bag

from capture_rig.session import load_session
from mocap_pipeline.session_footage import exact_silhouettes
from sagoma_bringup.graph import LOSSLESS_SETTINGS, build_graph
from sagoma_tools.commands.recording import replay_timed
from sagoma_tools.graph.ros_link import RosLink
from sagoma_tools.graph.supervisor import Supervisor

SOURCES = Path(__file__).parents[1] / "src"
PATIENCE_S = 60.0  # only ever reached by a failing test
ROUNDS = 2
FPS = 30.0
SETTINGS = LOSSLESS_SETTINGS | {
    "hull_server.tolerance_s": 0.5 / FPS,
    "hull_server.backend": "cpu",
    "icp_tracker.initial_pose.source": "t_pose",
}


@pytest.fixture(scope="module")
def bag(three_cameras: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two seconds of silhouettes as the cameras send them: a T-pose, then movement."""
    session = load_session(three_cameras)
    folder = tmp_path_factory.mktemp("time") / "bag"
    return write_silhouette_bag(folder, session.rig, exact_silhouettes(session), FPS)


def arguments(bag: Path, **given: object) -> argparse.Namespace:
    usual = {"rate": 1.0, "topics": "inputs", "loop": False, "clock": None, "lockstep": False, "graph": False}
    return argparse.Namespace(bag=str(bag), output=None, **(usual | given))


def stamp_and_state(message: DiagnosticStatus) -> tuple[int, str]:
    values = {pair.key: pair.value for pair in message.values}
    return int(values.get("stamp_ns", 0)), message.message


def rounds_of(states: list[tuple[int, str]]) -> list[list[str]]:
    """The states of every playing of the bag: a new one begins where stamps go back."""
    found, last_ns = [[]], 0
    for stamp_ns, state in states:
        if stamp_ns:  # else it is of silence, not of a set
            if stamp_ns <= last_ns:
                found.append([])
            last_ns = stamp_ns
            found[-1].append(state)
    return found


@pytest.mark.slow
def test_bag_played_twice_and_looped_in_simulated_time_is_tracked_each_time(bag, tmp_path):
    graph = build_graph(rig=bag.with_suffix(".rig.yaml"), settings=SETTINGS)
    graph = [spec.with_parameters({"use_sim_time": True}) for spec in graph]
    with RosLink("sagoma_replayer") as link, Supervisor(graph, tmp_path / "run") as supervisor:
        heard = Heard(link.node, DiagnosticStatus, "/mocap/state", PATIENCE_S, stamp_and_state)
        table = supervisor.diagnostics
        supervisor.configure()
        supervisor.activate()

        def reported(key: str) -> dict[str, float]:
            reports = {spec.name: table.report(spec.full_name) for spec in graph}
            return {n: float(report.values[key]) for n, report in reports.items() if report and key in report.values}

        def said() -> Counter[str]:
            logs = "".join(log.read_text() for log in (tmp_path / "run").glob("*.log"))
            return Counter(re.findall(r"\[(\w+)\]: .*a new beginning", logs))

        assert replay_timed(arguments(bag, clock=50.0), link, threading.Event()) == 0
        stop = threading.Event()
        looped = threading.Thread(target=replay_timed, args=(arguments(bag, clock=50.0, loop=True), link, stop))
        looped.start()
        begun = table.wait_until(lambda: sum(n >= ROUNDS for n in reported("restarts").values()) == 3, PATIENCE_S)
        # the nodes' clocks are the bag's, and so ages are those of the sets
        assert table.wait_until(lambda: reported("latency_p50_ms"), PATIENCE_S)
        assert all(abs(age_ms) < 10e3 for age_ms in reported("latency_p50_ms").values())
        stop.set()
        looped.join()
        assert begun, reported("restarts")
        tracked = [states.count("tracking") for states in rounds_of(heard.kept)[:ROUNDS]]
        # a busy machine may lose silhouettes of a bag played in real time, never a whole round
        assert min(tracked) > 10, tracked
        assert table.wait_until(lambda: reported("restarts") == said(), PATIENCE_S), said()  # each says it once a jump


def test_timers_run_on_the_steady_clock():
    """Timers are for people and processes that wait; on simulated time a node would stand still, or hurry, with it."""
    texts = {path: path.read_text() for path in SOURCES.glob("*/*/**/*.py") if "/test/" not in str(path)}
    trees = {path: ast.parse(text) for path, text in texts.items() if ".create_timer(" in text}
    calls = [(path, node) for path, tree in trees.items() for node in ast.walk(tree) if isinstance(node, ast.Call)]
    timers = [(path, call) for path, call in calls if ast.unparse(call.func).endswith(".create_timer")]
    assert len(timers) > 5
    of_another_clock = [(path, call) for path, call in timers if "clock" not in {each.arg for each in call.keywords}]
    assert not [f"{path}:{call.lineno}" for path, call in of_another_clock]
