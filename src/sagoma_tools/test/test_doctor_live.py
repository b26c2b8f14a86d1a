"""The doctor listens to real graphs with faults in them: a small one of fake nodes, and the product's own."""

import json
import os
import signal
from dataclasses import replace

import pytest
from doctor_fake_nodes import RIG, Camera, FakeGraph

from capture_rig.rig import Rig, load_rig, save_rig
from sagoma_bringup.graph import build_graph
from sagoma_tools.cli import main
from sagoma_tools.doctor.findings import Severity
from sagoma_tools.doctor.graph import examine_graph, graph_findings
from sagoma_tools.doctor.graph_listener import collect_graph
from sagoma_tools.evaluation.live_inputs import StudioProcess, free_first_address
from sagoma_tools.graph.background_training import learn_backgrounds
from sagoma_tools.graph.processes import ProcessSettings
from sagoma_tools.graph.supervisor import Supervisor
from stick_figure.body import Body
from virtual_studio.recording.session import write_session
from virtual_studio.rig import ring

SERVER = ("hull_server", "icp_tracker", "ekf_tracker")
DOMAIN, ELSEWHERE, PRODUCTS = 93, 94, 95  # of this file alone: nobody else's nodes are heard


@pytest.fixture(scope="module")
def heard():
    """cam01 is well, cam02 blank and its clock half a second ahead; cam03 is not there."""
    with FakeGraph([Camera("cam01"), Camera("cam02", blank=True, lead_s=0.5)], SERVER, DOMAIN):
        yield collect_graph(2.0, RIG.names, DOMAIN)


@pytest.fixture(scope="module")
def found(heard):
    by_subject = {}
    for finding in graph_findings(replace(heard, rig=RIG)):
        by_subject.setdefault(finding.subject, []).append(finding)
    return by_subject


def codes(findings):
    return {finding.code for finding in findings}


def test_every_node_is_heard_with_state_round_trip_machine_and_silhouettes(heard):
    clients = ("cam01/camera_client", "cam02/camera_client")
    assert {node.name for node in heard.nodes} == {f"/{name}" for name in (*SERVER, *clients)}
    for node in heard.nodes:
        assert node.state == "active" and node.copies == 1 and node.report.count >= 4
        assert 0 < node.round_trip_s < 1.0
        assert node.machines == (heard.machine,) != ("",)
    sent = {camera.camera: camera for camera in heard.cameras}
    assert sent["cam01"].masks > 10 and sent["cam01"].changes > 10 and sent["cam01"].lost == 0
    canvas = sent["cam01"].canvas  # of which 80 x 300 pixels are somebody
    assert sent["cam01"].shares[0] == pytest.approx(80 * 300 / (canvas.width * canvas.height))
    assert set(sent["cam02"].shares) == {0.0}
    assert sent["cam03"].publishers == 0 and sent["cam03"].masks == 0


def test_clock_half_a_second_ahead_is_measured_to_a_round_trip(heard, found):
    node = heard.node("/cam02/camera_client")
    assert node.report.lead_s <= 0.5 <= node.report.lead_s + node.round_trip_s + 0.02
    assert codes(found["camera cam02"]) >= {"clock.off", "stamps.ahead"}
    assert "clock.ok" in codes(found["camera cam01"])


def test_blank_and_absent_cameras_are_named(found):
    (blank,) = [finding for finding in found["camera cam02"] if finding.about == "silhouettes"]
    assert blank.code == "silhouettes.blank" and "while cam01" in blank.what
    assert "silhouettes.ok" in codes(found["camera cam01"]) and "node.missing" in codes(found["camera cam03"])


@pytest.mark.slow
def test_another_domain_is_empty_and_the_command_says_where_nodes_are(heard, tmp_path, capsys, monkeypatch):
    save_rig(RIG, tmp_path / "rig.yaml")
    monkeypatch.setenv("ROS_DOMAIN_ID", str(ELSEWHERE))
    arguments = ["doctor", "--no-machine", "--live", "--seconds", "0.1", "--json", "--rig", str(tmp_path / "rig.yaml")]
    assert main(arguments) == 2
    findings = json.loads(capsys.readouterr().out)["findings"]
    (nobody,) = [finding for finding in findings if finding["subject"] == "graph"]
    assert nobody["code"] == "nodes.none" and str(ELSEWHERE) in nobody["what"] and str(DOMAIN) in nobody["remedy"]


SECONDS, FPS = 4.0, 6.0
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
    with Supervisor(graph, folder, ProcessSettings(domain_id=PRODUCTS)) as run:
        run.configure(tolerate_cameras=False)
        run.activate(tolerate_cameras=False)
        learn_backgrounds(run)
        studio.ask("room", state="occupied")
        yield run


def troubles(studio):
    found = {}
    for finding in examine_graph(SECONDS, studio.rig, PRODUCTS):
        if finding.severity >= Severity.WARNING:
            assert finding.remedy
            found.setdefault(finding.subject, []).append(f"{finding.severity.name} {finding.code}: {finding.what}")
    return found


@pytest.mark.slow
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
