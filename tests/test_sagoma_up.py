"""`sagoma up` as the process a user starts: it runs the graph, and Ctrl-C ends it and everything it started."""

import signal
import subprocess
import sys
import threading
from pathlib import Path

import psutil
import pytest

from sagoma_tools.graph.ros_link import RosLink
from sagoma_tools.graph.topics import PREDICTION_TOPIC, camera_topics
from sagoma_tools.recording.reader import bag_topics, read_messages
from sagoma_tools.recording.replayer import Answers

PATIENCE_S = 120.0


@pytest.fixture()
def up(built_in_session: Path, tmp_path: Path):
    """The running command, playing the session over and over into a bag."""
    command = [
        sys.executable,
        "-m",
        "sagoma_tools.cli",
        "up",
        str(built_in_session),
        "--rate",
        "0",
        "--loop",
        "--record",
        str(tmp_path / "bag"),
        "--run-folder",
        str(tmp_path / "run"),
        "--set",
        "icp_tracker.initial_pose.source=t_pose",
    ]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)
    watchdog = threading.Timer(2 * PATIENCE_S, process.kill)
    watchdog.start()
    yield process
    watchdog.cancel()
    process.kill()
    process.communicate()


@pytest.mark.slow
def test_ctrl_c_ends_every_node_and_leaves_a_readable_bag(up, built_in_session, tmp_path):
    with RosLink("listener") as link:
        answers = Answers(link.node)
        assert answers.wait_for_total(10, PATIENCE_S), up.stdout.read()
        processes = psutil.Process(up.pid).children()
        up.send_signal(signal.SIGINT)
        said, _ = up.communicate(timeout=PATIENCE_S)
    assert up.returncode == 0, said
    assert "all 8 nodes stopped" in said
    assert len(processes) == 6 and not any(process.is_running() for process in processes)  # the server is one
    topics = bag_topics(tmp_path / "bag")
    assert {topic.name for k in range(1, 6) for topic in camera_topics(f"cam{k:02d}")} <= set(topics)
    assert sum(1 for _ in read_messages(tmp_path / "bag", PREDICTION_TOPIC.__eq__)) >= 10
    assert (tmp_path / "bag" / "rig.yaml").read_text() == (built_in_session / "rig.yaml").read_text()
