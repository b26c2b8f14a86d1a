"""Crashes in the running graph, on simulated cameras: every kind of process comes back and the person is tracked again,
without anybody's help; with the server in one process: the soak."""

import os
import queue
import signal
import threading
import time
from pathlib import Path

import pytest
from heard import Heard
from sensor_msgs.msg import JointState

from sagoma_bringup.graph import THREE_PROCESSES
from sagoma_tools.evaluation.live_inputs import StudioInput
from sagoma_tools.graph.diagnostics_table import DiagnosticsTable
from sagoma_tools.graph.supervisor import ProcessEvent, Supervisor

pytestmark = pytest.mark.slow

CAMERA_FPS = 5.0
PATIENCE_S = 300.0
CRASHES = {
    "/hull_server": signal.SIGKILL,
    "/icp_tracker": signal.SIGSEGV,
    "/ekf_tracker": signal.SIGABRT,
    "/cam01/camera_client": signal.SIGSEGV,
}


def test_person_is_tracked_again_after_the_crash_of_any_process(built_in_session: Path, tmp_path: Path):
    told: queue.Queue[ProcessEvent] = queue.Queue()
    cancel = threading.Event()
    with StudioInput(built_in_session, tmp_path / "studio", CAMERA_FPS, cancel=cancel) as studio:
        graph = studio.graph({"hull_server.deadline_s": 2.0, "hull_server.thin_out": False})
        with Supervisor(graph, tmp_path / "run", THREE_PROCESSES, on_event=told.put, restart_delay_s=0.1) as supervisor:
            supervisor.configure(tolerate_cameras=False)
            supervisor.activate(tolerate_cameras=False)
            studio.prepare(supervisor, cancel)  # the person stands: whoever moves at 5 Hz is too fast to be followed
            joints = Heard(supervisor.node, JointState, "/mocap/joint_states", PATIENCE_S)
            assert joints.wait_for_more(1)
            for name, number in CRASHES.items():
                os.kill(supervisor.processes.pids()[name], number)
                death, back = told.get(timeout=PATIENCE_S), told.get(timeout=PATIENCE_S)
                assert f"killed by {signal.Signals(number).name}" in death.text
                assert name in back.text
                assert joints.wait_for_more(5), f"nobody is tracked after {name} crashed"
                assert_every_camera_is_seen(supervisor.diagnostics)


def whole_sets(diagnostics: DiagnosticsTable) -> tuple[float, int]:
    """When the hull server last reported, and of how many whole frame sets: of every camera, its background found."""
    report = diagnostics.report("/hull_server")
    return (0.0, 0) if report is None else (report.heard_s, int(report.values.get("sets_complete", 0)))


def assert_every_camera_is_seen(diagnostics: DiagnosticsTable) -> None:
    """The hull server comes to form more whole frame sets, and says so after this moment."""
    began_s, (_, before) = time.monotonic(), whole_sets(diagnostics)

    def more_are_whole() -> bool:
        heard_s, now = whole_sets(diagnostics)
        return heard_s > began_s and now > before

    assert diagnostics.wait_until(more_are_whole, PATIENCE_S)
