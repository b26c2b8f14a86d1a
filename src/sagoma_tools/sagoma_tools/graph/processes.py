"""Processes: started in groups of their own, watched, measured, stopped by pid; those of a graph, with their logs."""

from __future__ import annotations

import contextlib
import ctypes
import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Future
from dataclasses import dataclass
from pathlib import Path

import psutil

from capture_rig.yaml_file import save_mapping
from sagoma_bringup.graph import NodeSpec, ProcessSpec, processes_of

GRACE_S, REAP_S = 8.0, 5.0  # to end after SIGINT, and after SIGKILL
# idle BLAS and OpenMP threads that spin take the cores from the nodes that have work
THREADS_ENV = {"OPENBLAS_NUM_THREADS": "1", "OMP_WAIT_POLICY": "passive"}
LOG_ENV = {"PYTHONUNBUFFERED": "1", "PYTHONFAULTHANDLER": "1"}  # the log ends with the stack of a crash in native code
PR_SET_PDEATHSIG, MIB = 1, 1 << 20
_libc = ctypes.CDLL(None)


@dataclass(frozen=True)
class ExitStatus:
    """The end of one child: its fault, "" for none, and its exit status (negative: the signal's number)."""

    name: str
    trouble: str
    returncode: int


KILLED, FAILED, ALREADY_DEAD = "ignored SIGINT and was killed", "stopped with an error", "had died before"


@dataclass(frozen=True)
class Usage:
    """Resources of a process: memory resident now, MiB, and processor time since its start, seconds.

    own_mib : resident and not shared. Shared pages of libraries are counted as resident at the kernel's choice.
    """

    resident_mib: float
    own_mib: float
    cpu_s: float


class Child:
    """One running process and its log, which is continued where it exists. It gets SIGINT when this process ends.

    ``on_exit`` is called, on the child's own thread, when it ends by itself. Raises OSError when it cannot be started.
    """

    def __init__(
        self, name: str, command: Sequence[str], log: Path, env: Mapping[str, str], on_exit: Callable[[Child], object]
    ) -> None:
        self.name, self.log = name, log
        self._stopping, self._ended = False, threading.Event()
        started: Future[subprocess.Popen[bytes]] = Future()

        def run() -> None:
            """The kernel signals a child when the thread that started it ends: this one lives as long as the child."""
            try:
                with log.open("ab") as sink:
                    process = subprocess.Popen(
                        command,
                        stdin=subprocess.DEVNULL,
                        stdout=sink,
                        stderr=subprocess.STDOUT,
                        env=dict(env),
                        process_group=0,
                        preexec_fn=_prepare_child,
                    )
            except OSError as error:
                started.set_exception(error)
                return
            started.set_result(process)
            process.wait()
            self._ended.set()
            if not self._stopping:
                on_exit(self)

        threading.Thread(target=run, name=f"watch {name}", daemon=True).start()
        self._process = started.result()

    @property
    def pid(self) -> int:
        return self._process.pid

    @property
    def alive(self) -> bool:
        return not self._ended.is_set()

    @property
    def returncode(self) -> int:
        """Once it has ended."""
        return self._process.returncode

    def log_tail(self, lines: int = 15) -> str:
        """Return the last lines of its log."""
        return "\n".join(self.log.read_text(errors="replace").splitlines()[-lines:])

    def usage(self) -> Usage | None:
        """Return its resources; None once it has ended."""
        try:
            process = psutil.Process(self.pid)
            memory, cpu = process.memory_info(), process.cpu_times()
        except psutil.Error:
            return None
        return Usage(memory.rss / MIB, (memory.rss - memory.shared) / MIB, cpu.user + cpu.system)

    def interrupt(self) -> None:
        """Interrupt it (SIGINT)."""
        self._stopping = True
        if self.alive:
            self._process.send_signal(signal.SIGINT)

    def wait(self, timeout_s: float) -> bool:
        """True when it has ended within ``timeout_s``."""
        return self._ended.wait(timeout_s)

    def kill(self) -> None:
        """SIGKILL to its whole process group."""
        self._stopping = True
        with contextlib.suppress(ProcessLookupError):
            if self.alive:
                os.killpg(self.pid, signal.SIGKILL)
        self._ended.wait(REAP_S)


def _prepare_child() -> None:
    """Set up the child before exec: SIGINT when its parent ends, and not ignored even if the shell ignores it."""
    _libc.prctl(PR_SET_PDEATHSIG, signal.SIGINT)
    signal.signal(signal.SIGINT, signal.SIG_DFL)


def stop_children(children: Sequence[Child], grace_s: float) -> tuple[ExitStatus, ...]:
    """Send SIGINT to all, and SIGKILL to those that still run ``grace_s`` later; returns how each one ended."""
    found = {child: "" if child.alive else ALREADY_DEAD for child in children}
    for child in children:
        child.interrupt()
    deadline_s = time.monotonic() + grace_s
    for child in children:
        if not child.wait(max(0.0, deadline_s - time.monotonic())):
            found[child] = KILLED
            child.kill()
        elif not found[child] and child.returncode not in (0, -signal.SIGINT):
            found[child] = FAILED
    return tuple(ExitStatus(child.name, how, child.returncode) for child, how in found.items())


def busy_machine() -> str:
    """Return the machine's load with a remedy when more threads are ready than it has processors; else ""."""
    load, processors = os.getloadavg()[0], os.cpu_count() or 1
    busy = f"the machine is busy (load {load:.1f} on {processors} processors): end other programs and try again"
    return busy if load > processors else ""


class ProcessGroup:
    """The processes of one graph, each with one log and one parameter file in the run folder."""

    def __init__(
        self, graph: Sequence[NodeSpec], run_folder: Path, server: str, on_exit: Callable[[ProcessSpec, Child], None]
    ) -> None:
        """``on_exit`` is called, from another thread, for every process that ends by itself."""
        self.specs = tuple(processes_of(graph, server))
        self._labels = {node.full_name: spec.label for spec in self.specs for node in spec.nodes}
        self._run_folder, self._on_exit = run_folder, on_exit
        self._children: dict[str, Child] = {}

    def start_all(self) -> None:
        """Start every process, with new logs."""
        self._run_folder.mkdir(parents=True, exist_ok=True)
        for spec in self.specs:
            self._path(spec, "log").unlink(missing_ok=True)
            self.start(spec)

    def start(self, spec: ProcessSpec) -> Child:
        """Start one process."""
        save_mapping(self._path(spec, "yaml"), spec.parameter_document())
        command = [sys.executable, "-m", spec.module, "--ros-args", *spec.name_arguments]
        command += ["--params-file", str(self._path(spec, "yaml"))]
        env = {**THREADS_ENV, **os.environ, **LOG_ENV}
        env["ROS_LOG_DIR"] = str(self._run_folder / "ros_log")
        log = self._path(spec, "log")
        child = Child(spec.label, command, log, env, lambda child: self._on_exit(spec, child))
        self._children[spec.label] = child
        return child

    def stop(self) -> tuple[ExitStatus, ...]:
        """SIGINT to all, and after the grace period SIGKILL; returns how each process ended."""
        return stop_children(list(self._children.values()), GRACE_S)

    def child_of(self, node: str) -> Child:
        """Return the process of the node with this full name, as last started."""
        return self._children[self._labels[node]]

    def alive(self, node: str) -> bool:
        """Whether the process of the node with this full name still runs."""
        child = self._children.get(self._labels.get(node, ""))
        return child is not None and child.alive

    def pids(self) -> dict[str, int]:
        """Full node name -> process id."""
        return {node: self._children[label].pid for node, label in self._labels.items() if label in self._children}

    def usage(self) -> dict[str, Usage]:
        """Label of each living process -> the memory and processor time that it uses."""
        found = {label: child.usage() for label, child in self._children.items()}
        return {label: usage for label, usage in found.items() if usage is not None}

    def _path(self, spec: ProcessSpec, suffix: str) -> Path:
        return self._run_folder / f"{spec.label}.{suffix}"
