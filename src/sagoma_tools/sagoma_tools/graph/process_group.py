"""The processes of one graph: command line, environment, parameter file and log of each; started, measured, stopped."""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path

from capture_rig.yaml_file import save_mapping
from sagoma_bringup.graph import NodeSpec
from sagoma_bringup.processes import ONE_PROCESS, ProcessSpec, processes_of

from .processes import Child, ExitStatus, Usage, node_command, remove_abandoned, stop_children

GRACE_S = 8.0
# idle BLAS and OpenMP threads that spin take the cores from the nodes that have work
THREADS_ENV = {"OPENBLAS_NUM_THREADS": "1", "OMP_WAIT_POLICY": "passive"}
LOG_ENV = {"PYTHONUNBUFFERED": "1", "PYTHONFAULTHANDLER": "1"}  # the log ends with the stack of a crash in native code


@dataclass(frozen=True)
class ProcessSettings:
    """How the processes of a graph run.

    server : ONE_PROCESS or THREE_PROCESSES, for the server's nodes; each camera has a process of its own.
    domain_id : ROS_DOMAIN_ID of the graph, the environment's by default.
    env : variables besides those of the environment; these win.
    grace_s : how long a process may take to end after SIGINT before it is killed.
    """

    server: str = ONE_PROCESS
    domain_id: int | None = None
    env: Mapping[str, str] = field(default_factory=dict)
    grace_s: float = GRACE_S


class ProcessGroup:
    """The processes of one graph, found by the full names of their nodes.

    Each has one log and one parameter file in the run folder, and lives no longer than the thread that started it.
    """

    def __init__(
        self,
        graph: Sequence[NodeSpec],
        run_folder: Path,
        settings: ProcessSettings,
        on_exit: Callable[[ProcessSpec, Child], None],
    ) -> None:
        """``on_exit`` is called, from another thread, for every process that ends by itself."""
        self.specs = tuple(processes_of(graph, settings.server))
        self._run_folder, self._settings, self._on_exit = run_folder, settings, on_exit
        self._children: dict[str, Child] = {}
        self._abandoned: set[str] = set()  # shared memory of processes that have ended

    def start_all(self) -> None:
        """Start every process, with new logs."""
        self._run_folder.mkdir(parents=True, exist_ok=True)
        for process in self.specs:
            self._log(process).unlink(missing_ok=True)
            self.start(process)

    def start(self, process: ProcessSpec) -> int:
        """Start one process, whose log is continued when it exists; returns its process id."""
        parameters = self._run_folder / f"{process.label}.yaml"
        save_mapping(parameters, process.parameter_document())
        executable = node_command(process.package, process.executable, process.module)
        command = [*executable, "--ros-args", *process.name_arguments]
        command += ["--params-file", str(parameters)]
        child = Child(
            process.label, command, self._log(process), self._environment(), partial(self._note_exit, process)
        )
        self._children |= dict.fromkeys((node.full_name for node in process.nodes), child)
        return child.pid

    def stop(self) -> tuple[ExitStatus, ...]:
        """SIGINT to all, and after the grace period SIGKILL; returns how each process ended."""
        return stop_children(list(dict.fromkeys(self._children.values())), self._settings.grace_s)

    def by_node(self) -> dict[str, Child]:
        """Full node name -> its process as last started."""
        return dict(self._children)

    def child_of(self, process: ProcessSpec) -> Child:
        """Return a process as last started."""
        return self._children[process.nodes[0].full_name]

    def alive(self, name: str) -> bool:
        """Whether the process of the node with this full name still runs."""
        child = self._children.get(name)
        return child is not None and child.alive

    def pids(self) -> dict[str, int]:
        """Full node name -> process id."""
        return {name: child.pid for name, child in self._children.items()}

    def usage(self) -> dict[str, Usage]:
        """Label of each living process -> the memory and processor time that it uses."""
        found = {process.label: self.child_of(process).usage() for process in self.specs}
        return {label: usage for label, usage in found.items() if usage is not None}

    def log_tail(self, name: str, lines: int = 15) -> str:
        """Return the last lines of the log of a node's process."""
        return self._children[name].log_tail(lines)

    def note_shared_memory(self) -> None:
        """Record which Fast DDS shared memory each process owns: one that is killed or crashes leaves it behind."""
        for child in set(self._children.values()):
            child.note_shared_memory()

    def remove_shared_memory(self) -> None:
        """Delete what processes that have ended left in /dev/shm: megabytes with each crash."""
        remove_abandoned(self._abandoned.union(*(child.shared_memory for child in self._children.values())))

    def _note_exit(self, process: ProcessSpec, child: Child) -> None:
        self._abandoned |= child.shared_memory
        self._on_exit(process, child)

    def _log(self, process: ProcessSpec) -> Path:
        return self._run_folder / f"{process.label}.log"

    def _environment(self) -> dict[str, str]:
        env = {**THREADS_ENV, **os.environ, **self._settings.env, **LOG_ENV}
        env["ROS_LOG_DIR"] = str(self._run_folder / "ros_log")
        if self._settings.domain_id is not None:
            env["ROS_DOMAIN_ID"] = str(self._settings.domain_id)
        return env
