"""What a child process leaves behind when it is killed."""

import fcntl
import os
import sys
import threading

import psutil
import pytest
from test_supervisor_graph import segments_of

from sagoma_tools.graph.processes import Child, Exit, busy_machine, remove_abandoned_memory, stop_children


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


def test_shared_memory_of_a_dead_owner_is_removed_and_never_that_of_a_living_one_or_a_port(monkeypatch, tmp_path):
    monkeypatch.setattr("sagoma_tools.graph.processes.SHARED_MEMORY", tmp_path)
    for name in ("fastrtps_dead", "fastrtps_alive", "fastrtps_port7413"):
        for file in (name, f"{name}_el"):
            (tmp_path / file).touch()
            os.utime(tmp_path / file, (0.0, 0.0))
    (tmp_path / "fastrtps_new_el").touch()  # its owner is about to lock it
    with (tmp_path / "fastrtps_alive_el").open("rb") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        remove_abandoned_memory()
    left = ["fastrtps_alive", "fastrtps_alive_el", "fastrtps_new_el", "fastrtps_port7413", "fastrtps_port7413_el"]
    assert sorted(os.listdir(tmp_path)) == left


def test_segments_of_a_living_node_stay(link):
    before = segments_of(os.getpid())
    for segment in before:
        os.utime(segment.with_name(f"{segment.name}_el"), (0.0, 0.0))
    remove_abandoned_memory()
    assert before and all(segment.exists() for segment in before)


def wait_for_text(child, text):
    """The child's log, once it holds ``text``."""
    for _ in range(600):
        log = child.log.read_text()
        if text in log:
            return log
        threading.Event().wait(0.05)
    raise AssertionError(f"{child.name} never said {text!r}")


@pytest.mark.parametrize(("load", "said"), [(0.5, ""), (12.0, "load 12.0 on 2 processors")])
def test_a_busy_machine_is_named_as_the_cause(monkeypatch, load, said):
    monkeypatch.setattr("os.getloadavg", lambda: (load, 0.0, 0.0))
    monkeypatch.setattr("os.cpu_count", lambda: 2)
    assert (said in busy_machine()) and bool(busy_machine()) == bool(said)
