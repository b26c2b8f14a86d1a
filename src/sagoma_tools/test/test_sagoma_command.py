"""The subcommands that need no camera: start, suspend, stop, compare, recover, and what they refuse."""

import pytest
from rclpy.serialization import serialize_message
from sensor_msgs.msg import JointState
from test_supervisor_graph import camera, tiny
from tools_waiting import settled_at

from capture_rig.errors import InputError
from sagoma_tools.arguments import parse_settings
from sagoma_tools.cli import main
from sagoma_tools.recording.recorder import read_configuration
from sagoma_tools.recording.writer import BagWriter

TOPIC = "/mocap/joint_states"


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


def joint_states(bag, angles):
    with BagWriter(bag) as writer:
        writer.add_topic(TOPIC, "sensor_msgs/msg/JointState")
        for k, angle in enumerate(angles):
            message = JointState(name=["neck_x"], position=[angle], velocity=[0.0], effort=[0.0])
            writer.write(TOPIC, k, serialize_message(message))
    return str(bag)


def test_compare_tells_equal_from_different_bags_and_refuses_those_without_outputs(tmp_path, capsys):
    a, b = joint_states(tmp_path / "a", [0.1, 0.2]), joint_states(tmp_path / "b", [0.1, 0.2])
    c = joint_states(tmp_path / "c", [0.1, 0.3])
    assert main(["compare", a, b]) == 0
    assert "identical       2 messages" in capsys.readouterr().out
    assert main(["compare", a, c]) == 1
    assert f"{TOPIC}: message 1 differs first" in capsys.readouterr().out
    with BagWriter(tmp_path / "inputs") as writer:
        writer.add_topic("/cam01/camera_info", "sensor_msgs/msg/CameraInfo")
    assert main(["compare", str(tmp_path / "inputs"), str(tmp_path / "inputs")]) == 2
    assert "neither bag holds" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ("replay BAG --graph --lockstep", "--graph and --output belong together"),
        ("replay BAG --output out", "--graph and --output belong together"),
        ("replay BAG --graph --output out", "with --lockstep"),
    ],
)
def test_arguments_that_mean_nothing_are_refused(arguments, message, tmp_path, capsys):
    assert main(arguments.replace("BAG", str(tmp_path / "bag")).split()) == 2
    assert message in capsys.readouterr().err and not list(tmp_path.iterdir())


def test_settings_are_read_as_yaml_and_need_a_value():
    texts = ["hull_server.voxel_size_m=0.015", "cameras.publish_preview=true", "cam01.background=a=b.png"]
    assert parse_settings(texts) == {
        "hull_server.voxel_size_m": 0.015,
        "cameras.publish_preview": True,
        "cam01.background": "a=b.png",
    }
    with pytest.raises(InputError, match=r"'hull_server.voxel_size_m' has no value"):
        parse_settings(["hull_server.voxel_size_m"])
