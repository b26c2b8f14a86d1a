"""The doctor on the product's own graph and simulated GigE cameras, with faults brought in one after the other."""

import os
import signal
from dataclasses import replace

import pytest

from capture_rig.rig import Rig, load_rig, save_rig
from sagoma_bringup.graph import build_graph
from sagoma_tools.doctor.findings import Severity
from sagoma_tools.doctor.graph import examine_graph
from sagoma_tools.evaluation.live_inputs import StudioProcess, free_first_address
from sagoma_tools.graph.background_training import learn_backgrounds
from sagoma_tools.graph.processes import ProcessSettings
from sagoma_tools.graph.supervisor import Supervisor
from stick_figure.body import Body
from virtual_studio.recording.session import write_session
from virtual_studio.rig import ring

pytestmark = pytest.mark.slow
DOMAIN, SECONDS, FPS = 95, 4.0, 6.0
SETTINGS = {"cameras.background_frames": 30, "hull_server.deadline_s": 1.0, "hull_server.tolerance_s": 0.5 / FPS}


@pytest.fixture(scope="module")
def studio(tmp_path_factory):
    folder = tmp_path_factory.mktemp("doctor_graph")
    session = write_session(folder / "session", ring(3, False), Body.from_stature(1.75), fps=FPS, seconds=3.0)
    arguments = ("--session", str(session), "--fps", f"{FPS:g}", "--empty", "--address", free_first_address(3))
    with StudioProcess(folder / "studio", *arguments) as studio:
        yield studio


@pytest.fixture(scope="module")
def run(studio, tmp_path_factory):
    """Three cameras with the right rig; the hull server with one in which cam01 has another focal length."""
    folder = tmp_path_factory.mktemp("doctor_run")
    rig = load_rig(studio.rig)
    first = rig.cameras[0]
    K = first.K.copy()
    K[:2, :2] *= 1.02
    save_rig(Rig((replace(first, K=K), *rig.cameras[1:]), rig.volume), folder / "old_rig.yaml")
    settings = {**SETTINGS, "hull_server.rig_file": str(folder / "old_rig.yaml")}
    graph = build_graph(rig=studio.rig, cameras=studio.cameras, settings=settings)
    with Supervisor(graph, folder, ProcessSettings(domain_id=DOMAIN)) as run:
        run.configure(tolerate_cameras=False)
        run.activate(tolerate_cameras=False)
        learn_backgrounds(run)
        studio.ask("room", state="occupied")
        yield run


def troubles(studio):
    found = {}
    for finding in examine_graph(SECONDS, studio.rig, DOMAIN):
        if finding.severity >= Severity.WARNING:
            assert finding.remedy
            found.setdefault(finding.subject, []).append(f"{finding.severity.name} {finding.code}: {finding.what}")
    return found


def test_faults_of_a_running_graph_are_named_one_by_one(studio, run):
    found = troubles(studio)
    # 1. the server has another rig file than the cameras
    assert any("rig.refused" in text and "cam01" in text for text in found["hull_server"])
    # otherwise the cameras are well, as far as a busy machine allows
    assert not any("ERROR" in text for name, texts in found.items() if name.startswith("camera") for text in texts)

    # 2. a lens cap, 3. a client that hangs: who is stopped does not even say that he is there
    studio.ask("set", cameras=["cam02"], faults={"lens_cap": True})
    hangs = run.processes.pids()["/cam03/camera_client"]
    os.kill(hangs, signal.SIGSTOP)
    try:
        found = troubles(studio)
    finally:
        os.kill(hangs, signal.SIGCONT)
    assert any("says.warning: dark" in text or "says.error: dark" in text for text in found["camera cam02"])
    assert any("node.missing" in text for text in found["camera cam03"])
    assert not any("node.missing" in text for text in found.get("camera cam01", []))
