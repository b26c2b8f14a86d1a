"""The doctor listens to a real graph of fake nodes with faults in them."""

import json
from dataclasses import replace

import pytest
from doctor_fake_nodes import RIG, FakeCamera, fake_server

from capture_rig.rig import save_rig
from sagoma_tools.cli import main
from sagoma_tools.doctor.graph import graph_findings
from sagoma_tools.doctor.graph_listener import collect_graph

DOMAIN, ELSEWHERE = 93, 94  # of this file alone: nobody else's nodes are heard


@pytest.fixture(scope="module")
def heard():
    """cam01 is well, cam02 blank and its clock half a second ahead; cam03 is not there."""
    there = FakeCamera("cam01", domain_id=DOMAIN), FakeCamera("cam02", blank=True, lead_s=0.5, domain_id=DOMAIN)
    with fake_server(DOMAIN), there[0], there[1]:
        yield collect_graph(2.0, RIG.names, DOMAIN)


@pytest.fixture(scope="module")
def found(heard):
    by_subject = {}
    for finding in graph_findings(replace(heard, rig=RIG)):
        by_subject.setdefault(finding.subject, []).append(finding)
    return by_subject


def codes(findings):
    return {finding.code for finding in findings}


def test_every_node_is_heard_with_state_round_trip_and_silhouettes(heard):
    clients = {"/cam01/camera_client", "/cam02/camera_client"}
    assert {node.name for node in heard.nodes} == clients | {"/hull_server", "/icp_tracker", "/ekf_tracker"}
    for node in heard.nodes:
        assert node.state == "active" and node.copies == 1
        assert 0 < node.round_trip_s < 1.0
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
