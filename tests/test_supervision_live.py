"""Crashes in a running graph: every kind of process comes back, under `sagoma up` and under ROS 2's launch, and the
person is tracked again, without anybody's help."""

import os
import queue
import signal
import threading
import time
from pathlib import Path

import pytest
from heard import Heard
from launch_stand_in import LaunchRun, launched
from sensor_msgs.msg import JointState

from sagoma_bringup.graph import ONE_PROCESS, THREE_PROCESSES
from sagoma_tools.evaluation.live_inputs import StudioInput
from sagoma_tools.graph.diagnostics_table import DiagnosticsTable
from sagoma_tools.graph.processes import ProcessSettings
from sagoma_tools.graph.restarts import ProcessExited, ProcessRecovered, RestartPolicy
from sagoma_tools.graph.ros_link import RosLink
from sagoma_tools.graph.supervisor import Supervisor

pytestmark = pytest.mark.slow

LAUNCH = Path(__file__).resolve().parents[1] / "src" / "sagoma_bringup" / "launch"
CAMERA_FPS = 5.0
PATIENCE_S = 300.0
CRASHES = {
    ONE_PROCESS: {"/cam02/camera_client": signal.SIGKILL, "/hull_server": signal.SIGSEGV},
    THREE_PROCESSES: {
        "/hull_server": signal.SIGKILL,
        "/icp_tracker": signal.SIGSEGV,
        "/ekf_tracker": signal.SIGABRT,
        "/cam01/camera_client": signal.SIGSEGV,
    },
}


@pytest.mark.parametrize("server", [ONE_PROCESS, THREE_PROCESSES])
def test_person_is_tracked_again_after_the_crash_of_any_process(server, built_in_session: Path, tmp_path: Path):
    told: queue.Queue[ProcessExited | ProcessRecovered] = queue.Queue()
    cancel = threading.Event()
    with StudioInput(built_in_session, tmp_path / "studio", CAMERA_FPS) as studio:
        studio.open(cancel)
        graph = studio.graph({"hull_server.deadline_s": 2.0, "hull_server.thin_out": False})
        with Supervisor(
            graph, tmp_path / "run", ProcessSettings(server), on_event=told.put, restart=RestartPolicy(first_s=0.1)
        ) as supervisor:
            supervisor.configure(tolerate_cameras=False)
            supervisor.activate(tolerate_cameras=False)
            studio.prepare(supervisor, cancel)
            studio.studio.ask("room", state="occupied")
            studio.studio.ask("hold")  # whoever moves at 5 Hz is too fast to be followed
            joints = Heard(supervisor.node, JointState, "/mocap/joint_states", PATIENCE_S)
            assert joints.wait_for_more(1)
            for name, number in CRASHES[server].items():
                os.kill(supervisor.processes.pids()[name], number)
                death, back = told.get(timeout=PATIENCE_S), told.get(timeout=PATIENCE_S)
                assert f"killed by {signal.Signals(number).name}" in death.reason
                assert name in str(back)
                assert joints.wait_for_more(5), f"nobody is tracked after {name} crashed"
                assert_every_camera_is_seen(supervisor.diagnostics)


def assert_every_camera_is_seen(diagnostics: DiagnosticsTable) -> None:
    """The hull server comes to form whole frame sets: the camera's background was found again."""
    began_s = time.monotonic()
    before = whole_sets(diagnostics)

    def more_are_whole() -> bool:
        report = diagnostics.report("/hull_server")
        return report is not None and report.heard_s > began_s and whole_sets(diagnostics) > before

    assert diagnostics.wait_until(more_are_whole, PATIENCE_S)


def whole_sets(diagnostics: DiagnosticsTable) -> int:
    report = diagnostics.report("/hull_server")
    return 0 if report is None else int(report.values.get("sets_complete", 0))


def test_launched_footage_is_tracked_below_a_pushed_namespace_and_goes_on_after_its_server_died(built_in_session):
    arguments = {"session": built_in_session, "namespace": "studio", "loop": "true"}
    nodes = launched(LAUNCH / "demo.launch.py", "/lab", **arguments, respawn_delay="0.1")
    with RosLink("listener") as link, LaunchRun(nodes) as run:
        topic = "/lab/studio/mocap/joint_states"
        joints = Heard(link.node, JointState, topic, PATIENCE_S, lambda message: len(message.name))
        assert joints.wait_for(20)
        run.processes["/lab/studio/mocap_server"].kill()
        assert run.wait_for_starts(len(nodes) + 1)
        assert joints.wait_for_more(20)
        assert set(joints.kept) == {18} and not run.over.is_set()
    assert all(process.returncode == 0 for process in run.processes.values())
