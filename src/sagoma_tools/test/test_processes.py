"""Which command starts a node, and what a child process leaves behind when it is killed."""

import os
import sys
import threading

import psutil
import pytest

from sagoma_tools.graph.processes import (
    LONGEST_START_S,
    STALLED_S,
    Child,
    Exit,
    StartDeadline,
    busy_machine,
    node_command,
    owned_shared_memory,
    shared_memory_files,
    stop_children,
)
from sagoma_tools.graph.ros_link import RosLink


def test_installed_executable_is_preferred_to_the_module(tmp_path, monkeypatch):
    first, second = tmp_path / "overlay", tmp_path / "underlay"
    for prefix in (first, second):
        executable = prefix / "lib" / "hull_server" / "hull_server"
        executable.parent.mkdir(parents=True)
        executable.write_text("#!/bin/sh\n")
        executable.chmod(0o755)
    monkeypatch.setenv("AMENT_PREFIX_PATH", os.pathsep.join(map(str, (first, second))))
    assert node_command("hull_server", "hull_server", "hull_server.hull_node") == [
        str(first / "lib" / "hull_server" / "hull_server")
    ]
    (first / "lib" / "hull_server" / "hull_server").chmod(0o644)  # cannot be run: the next prefix
    assert node_command("hull_server", "hull_server", "hull_server.hull_node")[0].startswith(str(second))
    monkeypatch.delenv("AMENT_PREFIX_PATH")
    assert node_command("hull_server", "hull_server", "m") == [sys.executable, "-m", "m"]


def start(tmp_path, name, script, on_exit=lambda child: None):
    return Child(name, [sys.executable, "-c", script], tmp_path / f"{name}.log", os.environ, on_exit)


def test_children_end_on_sigint_even_when_they_inherit_it_ignored(tmp_path):
    """Background jobs of a shell script ignore SIGINT, and hand that on to what they start."""
    script = "import time; print('ready', flush=True); time.sleep(600)"
    child = start(tmp_path, "sleeper", script)
    wait_for_text(child, "ready")
    (ended,) = stop_children([child], grace_s=30.0)
    assert ended.exit is Exit.CLEAN and not psutil.pid_exists(child.pid)


def test_killing_takes_the_whole_process_group(tmp_path):
    script = (
        "import signal, subprocess, sys, time; signal.signal(signal.SIGINT, signal.SIG_IGN);"
        "grandchild = subprocess.Popen([sys.executable, '-c', 'import time; time.sleep(600)']);"
        "print(grandchild.pid, 'ready', flush=True); time.sleep(600)"
    )
    child = start(tmp_path, "deaf", script)
    grandchild = psutil.Process(int(wait_for_text(child, "ready").split()[0]))
    (ended,) = stop_children([child], grace_s=0.2)
    assert (ended.exit, ended.returncode) == (Exit.KILLED, -9)
    assert grandchild.wait(timeout=30) is not None or not grandchild.is_running()


def test_child_that_fails_on_the_way_out_is_told_from_a_clean_one(tmp_path):
    script = (
        "import sys, time\nprint('ready', flush=True)\n"
        "try:\n    time.sleep(600)\nexcept KeyboardInterrupt:\n    sys.exit(4)"
    )
    child = start(tmp_path, "failing", script)
    wait_for_text(child, "ready")
    (ended,) = stop_children([child], grace_s=30.0)
    assert (ended.exit, ended.returncode) == (Exit.FAILED, 4)


def test_death_is_told_once_with_the_log_complete(tmp_path):
    told = threading.Event()
    child = start(tmp_path, "mortal", "print('first'); print('last'); raise SystemExit(5)", lambda child: told.set())
    assert told.wait(30)
    assert child.log_tail(1) == "last" and child.returncode == 5 and child.usage() is None
    (ended,) = stop_children([child], grace_s=1.0)
    assert (ended.exit, ended.returncode) == (Exit.ALREADY_DEAD, 5)


def test_shared_memory_is_that_of_one_process_and_never_a_port_which_another_may_take(link):
    """A port that is deleted while a process takes it makes this process deaf to the names of nodes."""
    with RosLink("beside") as beside:
        assert beside.context.ok() and link.context.ok()
        names = owned_shared_memory([os.getpid()])
        assert len(names) >= 2 and not any("port" in name for name in names)
        assert len(shared_memory_files(names)) == 2 * len(names)
    assert not shared_memory_files(names - owned_shared_memory([os.getpid()]))


def wait_for_text(child, text):
    """The child's log, once it holds ``text``."""
    for _ in range(600):
        log = child.log.read_text()
        if text in log:
            return log
        threading.Event().wait(0.05)
    raise AssertionError(f"{child.name} never said {text!r}")


def test_a_process_that_starts_slowly_is_waited_for_and_one_that_hangs_is_named():
    now_s, used_s = 0.0, 0.0
    deadline = StartDeadline(lambda: used_s, lambda: now_s)
    while now_s < 600.0:  # a hundredth of a processor, on a machine of load 200
        now_s, used_s = now_s + 10.0, used_s + 0.1
        assert deadline.exceeded() == ""
    now_s += STALLED_S + 1.0
    assert deadline.exceeded() == "it hangs after 661 s, 6.0 s of them on the processor"
    used_s, now_s = 7.0, LONGEST_START_S + 1.0
    assert "was not ready after 901 s" in deadline.exceeded()


def test_a_process_that_has_ended_is_waited_for_no_longer():
    assert StartDeadline(lambda: None).exceeded() == "it has ended"


@pytest.mark.parametrize(("load", "said"), [(0.5, ""), (12.0, "load 12.0 on 2 processors")])
def test_a_busy_machine_is_named_as_the_cause(monkeypatch, load, said):
    monkeypatch.setattr("os.getloadavg", lambda: (load, 0.0, 0.0))
    monkeypatch.setattr("os.cpu_count", lambda: 2)
    assert (said in busy_machine()) and bool(busy_machine()) == bool(said)
