"""Which nodes share a process, and the arguments with which each process starts."""

from pathlib import Path

import pytest

from sagoma_bringup.graph import SERVER_NODES, THREE_PROCESSES, build_graph, processes_of, select

CONFIG = Path(__file__).resolve().parents[3] / "config"


@pytest.fixture()
def graph():
    return build_graph(rig=CONFIG / "rig" / "ring4.yaml", cameras=CONFIG / "camera")


def test_the_server_is_one_process_and_each_camera_another(graph):
    server, *cameras = processes_of(graph)
    assert [node.name for node in server.nodes] == list(SERVER_NODES)
    assert (server.executable, server.label, server.name_arguments) == (
        "mocap_server",
        "mocap_server",
        ["-r", "__ns:=/"],
    )
    assert server.parameter_document().keys() == {f"/{name}" for name in SERVER_NODES}
    assert [process.label for process in cameras] == [node.label for node in graph[3:]]
    assert cameras[0].name_arguments == ["-r", "__node:=camera_client", "-r", "__ns:=/cam01"]
    assert str(server) == "/hull_server, /icp_tracker, /ekf_tracker"


def test_three_processes_are_a_process_a_node(graph):
    processes = processes_of(graph, THREE_PROCESSES)
    assert [process.nodes for process in processes] == [(node,) for node in graph]
    assert [process.module for process in processes] == [node.module for node in graph]


def test_a_part_of_the_server_is_never_in_the_common_process(graph):
    (process,) = processes_of(select(graph, "hull_server"))
    assert process.executable == "hull_server"
