"""The supervisor with real processes: tiny lifecycle nodes that behave, refuse, die, or hang."""

import io
import threading
from pathlib import Path

import psutil
import pytest
from rich.console import Console
from tools_waiting import until

from sagoma_bringup.graph import NodeSpec, Role
from sagoma_tools.cli import main
from sagoma_tools.graph.processes import ALREADY_DEAD
from sagoma_tools.graph.ros_link import RosLink, node_names, settled
from sagoma_tools.graph.supervisor import GraphError, Supervisor

REFUSES = "refuses_to_configure"
RING4 = Path(__file__).resolve().parents[3] / "config" / "rig" / "ring4.yaml"


def tiny(name: str, behaviour: str = "good", role: Role = Role.SERVER) -> NodeSpec:
    namespace = f"/{name}" if role is Role.CAMERA else "/"
    node = "camera_client" if role is Role.CAMERA else name
    return NodeSpec("none", "none", "tiny_lifecycle_node", node, namespace, role, {"behaviour": behaviour})


def camera(name: str, behaviour: str = "good") -> NodeSpec:
    return tiny(name, behaviour, Role.CAMERA)


def segments_of(pid: int) -> list[Path]:
    """Return the Fast DDS segments that a process owns: it holds their locks open."""
    locks = {opened.path for opened in psutil.Process(pid).open_files() if opened.path.endswith("_el")}
    return [Path(lock.removesuffix("_el")) for lock in locks if "fastrtps_port" not in lock]


def test_whole_graph_reaches_active_tells_of_itself_and_ends_cleanly(supervise):
    run = supervise(tiny("hull_server"), camera("cam01"), camera("cam02"))
    configured = run.configure()
    assert next(iter(configured.reached)) == "/hull_server"  # the server's side first
    activated = run.activate()
    assert not activated.failures and set(activated.reached.values()) == {"active"} and len(activated.reached) == 3
    assert set(run.states().values()) == {"active"}
    usage = run.processes.usage()
    assert usage.keys() == {"hull_server", "cam01", "cam02"}
    assert all(used.peak_mib >= used.resident_mib > 10 and used.cpu_s > 0 for used in usage.values())
    assert run.diagnostics.wait_for(["/cam01/camera_client"], timeout_s=30)
    report = run.diagnostics.report("/cam01/camera_client")
    assert report.values["rate_hz"] == "60.0" and report.losses() == {"dropped": 7}
    names, states = {"/cam01/camera_client": "cam01", "/gone": "gone"}, {"/cam01/camera_client": "active"}
    heard_line = rendered(run.diagnostics.table(names, states, now_s=report.heard_s))[1]
    assert heard_line.split() == ["cam01", "active", "60.0", "7", "dropped", "tiny"]
    assert "silent for 10 s" in rendered(run.diagnostics.table(names, states, now_s=report.heard_s + 10))[1]
    pids = run.processes.pids().values()
    exit_statuses = run.stop()
    assert [ended.trouble for ended in exit_statuses] == [""] * 3
    assert not run.stop_outcome.failures
    assert not any(psutil.pid_exists(pid) for pid in pids)


def test_configure_names_the_node_and_its_log_when_a_server_node_refuses(supervise):
    run = supervise(tiny("hull_server", REFUSES), camera("cam01"))
    with pytest.raises(GraphError, match=r"(?s)/hull_server: configure refused.*cannot be opened as a video"):
        run.configure()
    assert run.states() == {"/hull_server": "unconfigured", "/cam01/camera_client": "inactive"}


def test_start_that_the_user_ends_is_an_interruption_and_no_failure(tmp_path):
    stop = threading.Event()
    with pytest.raises(KeyboardInterrupt), Supervisor([tiny("hull_server", REFUSES)], tmp_path, cancel=stop) as run:
        stop.set()
        run.configure()
    assert len(run.exit_statuses) == 1  # its process has ended


def test_graph_goes_on_when_a_camera_refuses_and_another_dies_with_its_last_words(supervise):
    deaths, told = [], threading.Event()

    def on_event(death):
        deaths.append(death)
        told.set()

    graph = tiny("hull_server"), camera("cam01", "dies_when_activated"), camera("cam02"), camera("cam03", REFUSES)
    run = supervise(*graph, on_event=on_event)
    outcome = run.configure()
    assert outcome.failures == {"/cam03/camera_client": "/cam03/camera_client: configure refused"}
    with pytest.raises(GraphError, match="cam03"):
        run.configure(tolerate_cameras=False)
    its_memory = segments_of(run.processes.pids()["/cam01/camera_client"])
    outcome = run.activate()
    assert told.wait(30)
    assert outcome.silent == {"/cam01/camera_client"}
    assert deaths[0].process.label == "cam01" and deaths[0].log_tail.endswith("the last words of a dying node")
    assert "died: exit status 3; no restart: nobody asked for restarts" in deaths[0].text
    assert run.states() == {
        "/hull_server": "active",
        "/cam01/camera_client": "dead",
        "/cam02/camera_client": "active",
        "/cam03/camera_client": "unconfigured",
    }
    exits = {ended.name: (ended.trouble, ended.returncode) for ended in run.stop()}
    assert exits["cam01"] == (ALREADY_DEAD, 3) and exits["cam02"] == ("", 0)
    assert its_memory
    until(lambda: not any(segment.exists() for segment in its_memory))  # another graph's end may hold its lock


def test_only_camera_lost_is_an_error(supervise):
    run = supervise(camera("cam01", REFUSES))
    with pytest.raises(GraphError, match="cam01"):
        run.configure()


def test_nodes_of_the_same_names_are_refused_before_a_second_graph_starts_and_before_one_is_configured(
    supervise, monkeypatch, tmp_path, request, capsys
):
    monkeypatch.setattr("sagoma_tools.graph.lifecycle_client.ANSWER_S", 0.0)
    run = supervise(tiny("hull_server"), camera("cam01"))
    request.getfixturevalue("somebody_is_found")
    assert main(["up", "--rig", str(RING4), "--run-folder", str(tmp_path / "second")]) == 1
    said = capsys.readouterr().err
    assert said.startswith("sagoma: /hull_server run already in this ROS domain. End that graph, or give")
    assert "another ROS_DOMAIN_ID" in said and not (tmp_path / "second").exists()
    with RosLink("hull_server") as late:
        assert settled(lambda: {"seen"} if node_names(run.node).count("/hull_server") > 1 else set(), 1, 60.0)
        with pytest.raises(GraphError, match=r"^/hull_server run already"):
            run.configure()
        assert late.context.ok()
    names = ["/hull_server", "/cam01/camera_client"]
    assert run.lifecycle.states(names) == dict.fromkeys(names, "unconfigured")


def rendered(table):
    console = Console(width=150, file=io.StringIO())
    console.print(table)
    return console.file.getvalue().splitlines()
