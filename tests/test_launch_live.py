"""What the launch files start, run: footage that is tracked below a pushed namespace, and a server that comes back."""

from __future__ import annotations

from pathlib import Path

import pytest
from heard import Heard
from launch_stand_in import LaunchRun, launched
from sensor_msgs.msg import JointState

from sagoma_tools.graph.ros_link import RosLink

LAUNCH = Path(__file__).resolve().parents[1] / "src" / "sagoma_bringup" / "launch"
PATIENCE_S = 150.0

pytestmark = pytest.mark.slow


def joint_states(link: RosLink, topic: str) -> Heard:
    def all_eighteen(message: JointState) -> None:
        assert len(message.name) == len(message.position) == 18

    return Heard(link.node, JointState, topic, PATIENCE_S, all_eighteen)


def test_launched_footage_is_tracked_below_a_pushed_namespace_and_goes_on_after_its_server_died(built_in_session):
    arguments = {"session": built_in_session, "namespace": "studio", "loop": "true"}
    nodes = launched(LAUNCH / "demo.launch.py", "/lab", **arguments, respawn_delay="0.1")
    with RosLink("listener") as link, LaunchRun(nodes) as run:
        states = joint_states(link, "/lab/studio/mocap/joint_states")
        assert states.wait_for(20)
        run.processes["/lab/studio/mocap_server"].kill()
        assert run.wait_for_starts(len(nodes) + 1)
        assert states.wait_for_more(20)
        assert not run.over.is_set()
    assert all(process.returncode == 0 for process in run.processes.values())


@pytest.mark.parametrize("server", ["one_process", "three_processes"])
def test_launched_real_footage_gives_joint_states(shared_data, server):
    nodes = launched(LAUNCH / "demo.launch.py", session=shared_data("real_4cam"), server=server)
    with RosLink("listener") as link, LaunchRun(nodes):
        assert joint_states(link, "/mocap/joint_states").wait_for(50)
