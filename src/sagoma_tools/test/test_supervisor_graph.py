"""The supervisor with real processes, tiny lifecycle nodes that behave, refuse, die, or hang; processes that end: how
they are ended, what they leave behind, and which are started again."""

import io
import os
import queue
import signal
import sys
import threading
from concurrent.futures import Future
from pathlib import Path
from types import SimpleNamespace

import psutil
import pytest
from rich.console import Console
from tools_waiting import settled_at, until

from sagoma_bringup.graph import NodeSpec, Role, processes_of
from sagoma_tools.cli import main
from sagoma_tools.graph import ros_link
from sagoma_tools.graph.processes import ALREADY_DEAD, FAILED, KILLED, Child, busy_machine, stop_children
from sagoma_tools.graph.supervisor import GraphError, Supervisor, restarted, with_kept_backgrounds

REFUSES = "refuses_to_configure"
RING4 = Path(__file__).resolve().parents[3] / "config" / "rig" / "ring4.yaml"


def tiny(name: str, behaviour: str = "good", role: Role = Role.SERVER) -> NodeSpec:
    namespace = f"/{name}" if role is Role.CAMERA else "/"
    node = "camera_client" if role is Role.CAMERA else name
    return NodeSpec("tiny_lifecycle_node", node, namespace, role, {"behaviour": behaviour})


def camera(name: str, behaviour: str = "good") -> NodeSpec:
    return tiny(name, behaviour, Role.CAMERA)


def test_whole_graph_reaches_active_tells_of_itself_and_ends_cleanly(supervise):
    run = supervise(tiny("hull_server"), camera("cam01"), camera("cam02"))
    configured = run.configure()
    assert next(iter(configured.reached)) == "/hull_server"  # the server's side first
    activated = run.activate()
    assert not activated.failures and set(activated.reached.values()) == {"active"} and len(activated.reached) == 3
    assert set(run.states().values()) == {"active"}
    usage = run.processes.usage()
    assert usage.keys() == {"hull_server", "cam01", "cam02"}
    assert all(used.resident_mib > used.own_mib > 10 and used.cpu_s > 0 for used in usage.values())
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


def test_lost_reply_is_replaced_by_what_is_known_otherwise(monkeypatch):
    monkeypatch.setattr(ros_link, "ROUND_S", 0.0)
    answered, lost, destroyed = Future(), Future(), []
    answered.set_result("replied")
    futures = {"cam01/change_state": answered, "cam02/change_state": lost}
    node = SimpleNamespace(
        create_client=lambda _, name: SimpleNamespace(
            service_is_ready=lambda: True, call_async=lambda request: futures[name]
        ),
        destroy_client=destroyed.append,
    )
    calls = ros_link.ServiceCalls(node, object, dict.fromkeys(["cam01", "cam02"]), "/change_state")
    for silent in calls.rounds(60.0, lambda name: True):
        assert silent == {"cam02"}
        calls.add("cam02", "known")
    assert calls.replies == {"cam01": "replied", "cam02": "known"} and len(destroyed) == 2


@pytest.mark.parametrize(
    ("graph", "refuses"),
    [
        ([tiny("hull_server", REFUSES), camera("cam01")], "/hull_server"),
        ([tiny("hull_server"), camera("cam01", REFUSES)], "/cam01/camera_client"),
    ],
)
def test_configure_names_a_node_of_the_server_or_the_only_camera_that_refuses_and_its_log(supervise, graph, refuses):
    run = supervise(*graph)
    with pytest.raises(GraphError, match=rf"(?s){refuses}: configure refused.*cannot be opened as a video"):
        run.configure()
    assert run.states() == {node.full_name: "inactive" for node in graph} | {refuses: "unconfigured"}


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
    outcome = run.activate()
    assert told.wait(30)
    assert outcome.failures == {"/cam01/camera_client": "/cam01/camera_client: activate did not answer"}
    assert deaths[0].process.label == "cam01" and deaths[0].log_tail.endswith("the last words of a dying node")
    assert deaths[0].text.endswith("died: exit status 3; no restart")
    assert run.states() == {
        "/hull_server": "active",
        "/cam01/camera_client": "dead",
        "/cam02/camera_client": "active",
        "/cam03/camera_client": "unconfigured",
    }
    exits = {ended.name: (ended.trouble, ended.returncode) for ended in run.stop()}
    assert exits["cam01"] == (ALREADY_DEAD, 3) and exits["cam02"] == ("", 0)


def test_nodes_of_the_same_names_are_refused_before_a_second_graph_starts(supervise, monkeypatch, tmp_path, capsys):
    run = supervise(tiny("hull_server"), camera("cam01"))
    monkeypatch.setattr("sagoma_tools.graph.lifecycle_client.settled", settled_at(1))
    assert main(["up", "--rig", str(RING4), "--run-folder", str(tmp_path / "second")]) == 1
    said = capsys.readouterr().err
    assert said.startswith("sagoma: /hull_server run already in this ROS domain. End that graph, or give")
    assert "another ROS_DOMAIN_ID" in said and not (tmp_path / "second").exists()
    names = ["/hull_server", "/cam01/camera_client"]
    assert run.lifecycle.states(names) == dict.fromkeys(names, "unconfigured")


def rendered(table):
    console = Console(width=150, file=io.StringIO())
    console.print(table)
    return console.file.getvalue().splitlines()


# --- processes that end


ENDS = {
    "": ("time.sleep(600)", 30.0, {0, -signal.SIGINT}),
    FAILED: ("try:\n    time.sleep(600)\nexcept KeyboardInterrupt:\n    sys.exit(4)", 30.0, {4}),
    KILLED: ("signal.signal(signal.SIGINT, signal.SIG_IGN)\ntime.sleep(600)", 0.2, {-signal.SIGKILL}),
}


@pytest.mark.parametrize("trouble", ENDS)
def test_children_end_on_sigint_or_are_killed_with_what_they_started(tmp_path, trouble):
    """They end even when they inherit that SIGINT is ignored, as background jobs of a shell script do."""
    script, grace_s, codes = ENDS[trouble]
    grandchild = "subprocess.Popen([sys.executable, '-c', 'import time; time.sleep(600)'])"
    script = f"import signal, subprocess, sys, time\nprint({grandchild}.pid, 'ready', flush=True)\n{script}"
    child = Child("child", [sys.executable, "-c", script], tmp_path / "child.log", os.environ, lambda child: None)
    until(lambda: "ready" in child.log.read_text())
    started = psutil.Process(int(child.log.read_text().split()[0]))
    (ended,) = stop_children([child], grace_s=grace_s)
    assert ended.trouble == trouble and ended.returncode in codes and not psutil.pid_exists(child.pid)
    if trouble == KILLED:
        assert started.wait(timeout=30) is not None or not started.is_running()
    else:
        started.kill()


@pytest.mark.parametrize(("load", "said"), [(0.5, ""), (12.0, "load 12.0 on 2 processors")])
def test_a_busy_machine_is_named_as_the_cause(monkeypatch, load, said):
    monkeypatch.setattr("os.getloadavg", lambda: (load, 0.0, 0.0))
    monkeypatch.setattr("os.cpu_count", lambda: 2)
    assert (said in busy_machine()) and bool(busy_machine()) == bool(said)


# --- restarts

SOON_S = 0.1
PATIENCE_S = 60.0


def test_live_cameras_keep_their_background_in_the_run_folder_unless_they_have_a_place_for_it(tmp_path):
    given = camera("cam02").with_parameters({"background_file": "/somewhere/cam02.npz"})
    footage = camera("cam03").with_parameters({"source": "footage"})
    graph = with_kept_backgrounds([tiny("hull_server"), camera("cam01"), given, footage], tmp_path)
    files = [spec.parameters.get("background_file") for spec in graph]
    assert files == [None, str(tmp_path / "cam01_background.npz"), "/somewhere/cam02.npz", None]


def test_a_restarted_tracker_finds_the_person_in_any_pose_and_every_node_becomes_active_by_itself():
    nodes = [tiny("hull_server"), tiny("icp_tracker").with_parameters({"initial_pose.source": "t_pose"})]
    given = [node.parameters for process in processes_of(nodes) for node in restarted(process).nodes]
    assert all(parameters["autostart"] for parameters in given)
    assert [parameters.get("initial_pose.source") for parameters in given] == [None, "auto"]


@pytest.fixture()
def watched(supervise):
    """Start a graph with restarts; returns the supervisor, active, and the queue of what it tells."""

    def start(*graph, delay_s=SOON_S):
        told = queue.Queue()
        supervisor = supervise(*graph, on_event=told.put, restart_delay_s=delay_s)
        supervisor.configure()
        supervisor.activate()
        return supervisor, told

    return start


def test_killed_node_is_active_again_without_a_person(watched):
    run, told = watched(tiny("hull_server"), camera("cam01"))
    name = "/cam01/camera_client"
    child, before = run.processes.child_of(name), run.processes.pids()[name]
    os.kill(before, signal.SIGKILL)
    death, back = told.get(timeout=PATIENCE_S), told.get(timeout=PATIENCE_S)
    assert not death.back and death.process.label == "cam01" and death.pid == before
    assert "killed by SIGKILL (by hand, or by the kernel" in death.text and "restart in 0.1 s" in death.text
    assert back.back and back.pid == run.processes.pids()[name] != before
    assert run.states() == {"/hull_server": "active", name: "active"}
    log = run.processes.child_of(name).log_tail(100)
    assert "I am good" in death.log_tail and log.count("I am good") == 2  # the log goes on
    run._on_exit(death.process, child)  # told twice, as of a process that dies just when the graph becomes active
    assert run.processes.pids()[name] == back.pid
    assert [status.returncode for status in run.stop()] == [0, 0]


def test_process_that_crashes_at_every_start_is_started_again_each_time_and_the_others_go_on(watched):
    run, told = watched(tiny("hull_server"), camera("cam01", "dies_when_activated"), camera("cam02"))
    # it died once while the graph started, or just after, and dies at each restart
    deaths = [told.get(timeout=PATIENCE_S) for _ in range(3)]
    assert all("restart in 0.1 s" in death.text for death in deaths[1:])
    assert all(death.log_tail.endswith("the last words of a dying node") for death in deaths)
    states = run.states()
    assert states["/hull_server"] == states["/cam02/camera_client"] == "active"


@pytest.mark.slow
def test_who_was_asked_to_end_or_reads_footage_stays_ended_and_stop_starts_nothing(watched):
    footage = camera("cam02").with_parameters({"source": "footage"})
    run, told = watched(tiny("hull_server"), camera("cam01"), footage, camera("cam03"), delay_s=3600.0)
    ends = {"cam01": signal.SIGINT, "cam02": signal.SIGKILL, "cam03": signal.SIGKILL}
    for label, number in ends.items():
        os.kill(run.processes.pids()[f"/{label}/camera_client"], number)
    deaths = {death.process.label: death for death in (told.get(timeout=PATIENCE_S) for _ in ends)}
    assert deaths["cam01"].text.endswith("no restart") and deaths["cam02"].text.endswith("no restart")
    assert "restart in 3600 s" in deaths["cam03"].text
    states = run.states()
    assert [states[f"/{label}/camera_client"] for label in ends] == ["dead", "dead", "restarting"]
    run.stop()
    assert told.empty()
