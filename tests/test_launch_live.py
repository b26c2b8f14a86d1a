"""What the launch files start, run: footage that is tracked below a pushed namespace, and a server that comes back."""

from __future__ import annotations

import threading
from pathlib import Path

import pytest
from launch_stand_in import LaunchRun, launched
from sensor_msgs.msg import JointState

from sagoma_ros.qos import RESULT
from sagoma_tools.graph.ros_link import RosLink

LAUNCH = Path(__file__).resolve().parents[1] / "src" / "sagoma_bringup" / "launch"
PATIENCE_S = 150.0

pytestmark = pytest.mark.slow


class JointStates:
    """Joint states as they come; any thread may wait for more."""

    def __init__(self, link: RosLink, topic: str) -> None:
        self._changed, self.stamps = threading.Condition(), []
        link.node.create_subscription(JointState, topic, self._take, RESULT)

    def wait_for(self, count: int) -> bool:
        with self._changed:
            return self._changed.wait_for(lambda: len(self.stamps) >= count, PATIENCE_S)

    def _take(self, message: JointState) -> None:
        assert len(message.name) == len(message.position) == 18
        with self._changed:
            self.stamps.append((message.header.stamp.sec, message.header.stamp.nanosec))
            self._changed.notify_all()


def test_launched_footage_is_tracked_below_a_pushed_namespace_and_goes_on_after_its_server_died(built_in_session):
    arguments = {"session": built_in_session, "namespace": "studio", "loop": "true"}
    nodes = launched(LAUNCH / "demo.launch.py", "/lab", **arguments, respawn_delay="0.1")
    with RosLink("listener") as link, LaunchRun(nodes) as run:
        states = JointStates(link, "/lab/studio/mocap/joint_states")
        assert states.wait_for(20)
        run.processes["/lab/studio/mocap_server"].kill()
        assert run.wait_for_starts(len(nodes) + 1)
        assert states.wait_for(len(states.stamps) + 20)
        assert not run.over.is_set()
    assert all(process.returncode == 0 for process in run.processes.values())


@pytest.mark.parametrize("server", ["one_process", "three_processes"])
def test_launched_real_footage_gives_joint_states(shared_data, server):
    nodes = launched(LAUNCH / "demo.launch.py", session=shared_data("real_4cam"), server=server)
    with RosLink("listener") as link, LaunchRun(nodes):
        assert JointStates(link, "/mocap/joint_states").wait_for(50)
