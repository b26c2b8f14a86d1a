"""Graphs as users start them, by `sagoma up` and by ROS 2's launch: Ctrl-C ends them and everything they started."""

from pathlib import Path

import psutil
import pytest
from command_line import Graph
from heard import Heard
from launch_stand_in import launched, running
from sensor_msgs.msg import JointState

from sagoma_tools.graph.ros_link import RosLink
from sagoma_tools.graph.topics import PREDICTION_TOPIC, camera_topics
from sagoma_tools.recording.reader import bag_topics, read_messages

PATIENCE_S = 120.0
LAUNCH = Path(__file__).resolve().parents[1] / "src" / "sagoma_bringup" / "launch"


@pytest.mark.slow
def test_ctrl_c_ends_every_node_and_leaves_a_readable_bag(built_in_session, tmp_path):
    words = ("--rate", "0", "--loop", "--set", "icp_tracker.initial_pose.source=t_pose", "--record", tmp_path / "bag")
    with RosLink("listener") as link, Graph(tmp_path / "up.log", built_in_session, *words) as graph:
        poses = Heard(link.node, JointState, "/mocap/joint_states", PATIENCE_S)
        assert poses.wait_for_more(10), graph.log.read_text()
        processes = psutil.Process(graph.process.pid).children()
    said = graph.log.read_text()
    assert graph.process.returncode == 0, said
    assert "8 of 8 nodes are active" in said and "all 8 nodes stopped" in said
    assert len(processes) == 6 and not any(process.is_running() for process in processes)  # the server is one
    topics = bag_topics(tmp_path / "bag")
    assert {topic.name for k in range(1, 6) for topic in camera_topics(f"cam{k:02d}")} <= set(topics)
    assert sum(1 for _ in read_messages(tmp_path / "bag", PREDICTION_TOPIC.__eq__)) >= 10
    assert (tmp_path / "bag" / "rig.yaml").read_text() == (built_in_session / "rig.yaml").read_text()


@pytest.mark.slow
def test_launched_footage_is_tracked_below_a_pushed_namespace(built_in_session):
    given = {"session": built_in_session, "namespace": "studio", "loop": "true"}
    topic, nodes = "/lab/studio/mocap/joint_states", launched(LAUNCH / "demo.launch.py", "/lab", **given)
    with RosLink("listener") as link, running(nodes) as processes:
        angles = Heard(link.node, JointState, topic, PATIENCE_S, lambda message: len(message.position))
        assert angles.wait_for(20) and set(angles.kept) == {18}
    assert [process.returncode for process in processes] == [0] * len(nodes)
