"""A graph as users start it, by `sagoma up`: Ctrl-C ends it and everything that it started."""

import psutil
import pytest
from command_line import Graph
from heard import Heard
from sensor_msgs.msg import JointState

from sagoma_tools.graph.ros_link import RosLink
from sagoma_tools.graph.topics import LATENCY_TOPIC, camera_topics
from sagoma_tools.recording.reader import bag_topics, read_messages

PATIENCE_S = 120.0


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
    assert sum(1 for _ in read_messages(tmp_path / "bag", LATENCY_TOPIC.__eq__)) >= 10
    assert (tmp_path / "bag" / "rig.yaml").read_text() == (built_in_session / "rig.yaml").read_text()
