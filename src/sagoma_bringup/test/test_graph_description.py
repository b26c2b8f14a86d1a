"""The graph as data: nodes for a session, a rig, a machine, the processes that they run in, and what does not fit."""

from pathlib import Path

import pytest
import yaml

from capture_rig.errors import InputError
from sagoma_bringup.graph import SERVER_NODES, THREE_PROCESSES, Role, build_graph, processes_of, select

CONFIG = Path(__file__).resolve().parents[3] / "config"
RING4 = CONFIG / "rig" / "ring4.yaml"
SERVER = ["/hull_server", "/icp_tracker", "/ekf_tracker"]


def camera_files(folder, count, **parameters):
    for name in (f"cam{number:02d}" for number in range(1, count + 1)):
        document = {f"/{name}/camera_client": {"ros__parameters": {"camera_name": name, **parameters}}}
        (folder / f"{name}.yaml").write_text(yaml.safe_dump(document))


def test_session_gives_the_server_and_one_camera_node_a_video(session):
    graph = build_graph(session=session, rate=0.5, loop=True)
    assert [node.full_name for node in graph] == [*SERVER, "/cam01/camera_client", "/cam02/camera_client"]
    assert [node.role for node in graph] == [Role.SERVER] * 3 + [Role.CAMERA] * 2
    cameras = graph[3:]
    assert {node.parameters["rig_file"] for node in [graph[0], *cameras]} == {str((session / "rig.yaml").resolve())}
    for node in cameras:
        given = dict(node.parameters)
        assert given["footage.path"] == str((session / f"{node.label}.mp4").resolve())
        assert given["background"] == str((session / f"{node.label}_background.png").resolve())
        assert (given["footage.fps"], given["footage.rate"]) == (25.0, 0.5)
        assert (given["footage.epoch_ns"], given["footage.loop"]) == (0, True)
        assert given["footage.wait_for_cameras"] is True


def test_footage_played_by_no_clock_is_stamped_from_one_epoch_or_the_one_that_was_given(session):
    def epochs(**given):
        return {node.parameters["footage.epoch_ns"] for node in build_graph(session=session, **given)[3:]}

    assert len(epochs(rate=0)) == 1 and min(epochs(rate=0)) > 0
    assert epochs(rate=0, settings={"cameras.footage.epoch_ns": 7}) == {7} and epochs(rate=1) == {0}


@pytest.mark.parametrize(
    ("missing", "given", "message"),
    [
        ("cam02.mp4", {}, "the rig has 2 cameras, but there is no video for cam02"),
        ("cam01_background.png", {}, "no background for cam01.*Add cam01_background"),
        ("", {"only": "cam07"}, "no part 'cam07'.*cam01, cam02"),
        ("", {"settings": {"hul_server.voxel_size_m": 0.015}}, "'hul_server.voxel_size_m' names no node.*hull_server"),
    ],
    ids=["no video", "no background", "unknown camera", "unknown node"],
)
def test_session_that_does_not_fit_is_an_error_that_says_what_does(session, missing, given, message):
    if missing:
        (session / missing).unlink()
    with pytest.raises(InputError, match=message):
        build_graph(session=session, **given)


def test_a_part_of_the_graph_is_picked_by_its_name_and_a_rig_alone_is_the_server(session):
    parts = {
        part: [n.label for n in build_graph(session=session, only=part)] for part in ("cam02", "cameras", "server")
    }
    assert parts == {"cam02": ["cam02"], "cameras": ["cam01", "cam02"], "server": list(SERVER_NODES)}
    assert [node.full_name for node in build_graph(rig=RING4)] == SERVER
    assert [node.label for node in build_graph(cameras=CONFIG / "camera" / "footage" / "cam01.yaml")] == ["cam01"]


@pytest.mark.parametrize(("clock_speed", "lossless"), [(1.0, False), (0.25, True)])
def test_server_leaves_nothing_out_for_cameras_in_slow_motion(tmp_path, clock_speed, lossless):
    camera_files(tmp_path, 4, aravis={"clock_speed": clock_speed})
    hull = build_graph(rig=RING4, cameras=tmp_path)[0]
    assert hull.parameters.get("reliable", False) == lossless


def test_cameras_without_a_rig_are_driven_by_whoever_starts_them(tmp_path):
    camera_files(tmp_path, 2, autostart=True, source="aravis")
    graph = build_graph(cameras=tmp_path)
    assert [node.full_name for node in graph] == ["/cam01/camera_client", "/cam02/camera_client"]
    assert all(node.parameters["autostart"] is False and "rig_file" not in node.parameters for node in graph)


@pytest.mark.parametrize("count", [2, 5])
def test_cameras_that_are_not_those_of_the_rig_are_an_error(tmp_path, count):
    camera_files(tmp_path, count)
    with pytest.raises(InputError, match=r"cam01, cam02.*; the cameras of .* are cam01, cam02, cam03, cam04"):
        build_graph(rig=RING4, cameras=tmp_path)


OF_ONE = {"cameras": "cam01.yaml"}


@pytest.mark.parametrize(
    ("text", "given", "message"),
    [
        ("", OF_ONE, "no key"),
        ("- a", OF_ONE, "is not a mapping"),
        ("a: [", OF_ONE, "is not valid YAML"),
        ("/cam01/hull_server: {ros__parameters: {}}", OF_ONE, "/CAMERA/camera_client"),
        ("/cam01/camera_client: {parameters: {}}", OF_ONE, "ros__parameters"),
        (None, {"rig": "nowhere.yaml"}, r"nowhere\.yaml: cannot be read"),
        (None, {"rig": RING4, "cameras": "."}, "no camera parameter file"),
        (None, {"rig": RING4, "body": "body.yaml"}, r"body\.yaml: there is no such file"),
        (None, {}, "neither a session nor a rig"),
    ],
)
def test_missing_files_and_those_of_another_shape_are_errors_that_name_them(
    tmp_path, monkeypatch, text, given, message
):
    monkeypatch.chdir(tmp_path)
    if text is not None:
        Path("cam01.yaml").write_text(text)
    with pytest.raises(InputError, match=message):
        build_graph(**given)


def test_settings_reach_the_nodes_they_name(session):
    settings = {"hull_server.voxel_size_m": 0.015, "cameras.publish_preview": True, "cam02.publish_preview": False}
    graph = {node.label: node.parameters for node in build_graph(session=session, settings=settings)}
    assert graph["hull_server"]["voxel_size_m"] == 0.015
    assert "voxel_size_m" not in graph["icp_tracker"]
    assert (graph["cam01"]["publish_preview"], graph["cam02"]["publish_preview"]) == (True, False)
    assert "publish_preview" not in graph["hull_server"]


# --- processes


@pytest.fixture()
def graph():
    return build_graph(rig=RING4, cameras=CONFIG / "camera")


def test_the_server_is_one_process_and_each_camera_another(graph):
    server, *cameras = processes_of(graph)
    assert [node.name for node in server.nodes] == list(SERVER_NODES)
    assert (server.executable, server.label) == ("mocap_server", "mocap_server")
    assert server.name_arguments == ["-r", "__ns:=/"]
    assert server.parameter_document().keys() == {f"/{name}" for name in SERVER_NODES}
    assert [process.label for process in cameras] == [node.label for node in graph[3:]]
    assert cameras[0].name_arguments == ["-r", "__node:=camera_client", "-r", "__ns:=/cam01"]
    assert cameras[0].parameter_document()["/cam01/camera_client"]["ros__parameters"]["source"] == "aravis"
    assert str(server) == "/hull_server, /icp_tracker, /ekf_tracker"


def test_three_processes_are_a_process_a_node_and_so_is_a_part_of_the_server(graph):
    processes = processes_of(graph, THREE_PROCESSES)
    assert [(process.module, process.nodes) for process in processes] == [(node.module, (node,)) for node in graph]
    (process,) = processes_of(select(graph, "hull_server"))
    assert process.executable == "hull_server"
