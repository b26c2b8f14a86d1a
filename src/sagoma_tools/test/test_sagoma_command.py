"""The subcommands that need no camera: start, suspend, stop, and what they refuse."""

import pytest
from test_supervisor_graph import camera, tiny
from tools_waiting import settled_at

from sagoma_tools.arguments import parse_settings
from sagoma_tools.cli import main
from sagoma_tools.recording.recorder import read_configuration


def test_start_suspend_and_stop_drive_every_node_and_report_its_state(supervise, capsys, link):
    supervise(tiny("hull_server"), camera("cam01"))  # unconfigured, as some launch file may start them
    for verb, state in (("start", "active"), ("suspend", "inactive"), ("start", "active"), ("stop", "unconfigured")):
        assert main([verb, "--expect", "2", "--wait", "30"]) == 0
        assert capsys.readouterr().out == f"/cam01/camera_client: {state}\n/hull_server: {state}\n"
    names = ["/hull_server", "/cam01/camera_client"]
    found = read_configuration(link.node, names, timeout_s=60)
    assert {name: parameters["behaviour"] for name, parameters in found.items()} == dict.fromkeys(names, "good")


@pytest.mark.slow
def test_start_names_the_nodes_that_refuse_or_do_not_answer_and_starts_the_others(supervise, capsys):
    supervise(tiny("hull_server"), camera("cam01", "refuses_to_configure"), camera("cam02", "never_answers"))
    assert main(["start", "--expect", "3", "--wait", "30", "--timeout", "2"]) == 1
    said = capsys.readouterr().out
    assert "/hull_server: active" in said
    assert "failed: /cam01/camera_client: configure refused" in said
    assert "failed: /cam02/camera_client: configure did not answer" in said


def test_start_of_half_a_graph_is_an_input_error_and_starts_nothing(supervise, capsys, monkeypatch):
    run = supervise(tiny("hull_server"))
    monkeypatch.setattr("sagoma_tools.graph.ros_link.settled", settled_at(1))
    assert main(["start", "--expect", "7"]) == 2
    said = capsys.readouterr().err
    assert "/hull_server" in said and "expected 7" in said
    assert run.lifecycle.states(["/hull_server"]) == {"/hull_server": "unconfigured"}


def test_settings_are_read_as_yaml():
    texts = ["hull_server.voxel_size_m=0.015", "cameras.publish_preview=true", "cam01.background=a=b.png"]
    assert parse_settings(texts) == {
        "hull_server.voxel_size_m": 0.015,
        "cameras.publish_preview": True,
        "cam01.background": "a=b.png",
    }
