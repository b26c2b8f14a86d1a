"""Runs the node graph as processes, without the ros2 command line.

Starts every process (the server's nodes share one, unless told otherwise), drives the nodes' lifecycle with
acknowledgements (the server's first, the cameras' last), watches the processes, starts crashed ones again (`restarts`),
and stops them cleanly. A camera may die; the graph goes on.
"""

from __future__ import annotations

import os
import threading
import time
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path

from rclpy.node import Node

from camera_client.sources.footage_source import EPOCH_STEP_NS
from capture_rig.yaml_file import save_mapping
from sagoma_bringup.graph import NodeSpec, Role
from sagoma_bringup.processes import ONE_PROCESS, SERVER_EXECUTABLE, ProcessSpec, processes_of

from .diagnostics_table import DiagnosticsTable
from .errors import GraphError
from .foreign_nodes import foreign_names, machines_of, own_machine
from .lifecycle_client import REACHED, LifecycleClient, Outcome, State, Verdict
from .processes import Child, ExitStatus, Usage, busy_machine, node_command, remove_abandoned, stop_children
from .restarts import Death, Restarter, RestartPolicy, Return, exit_reason
from .restored_state import LastBody, reads_file, with_kept_backgrounds
from .ros_link import RosLink, node_names

GRACE_S = 8.0
FRESH = State.UNCONFIGURED.value
STOP_TIMEOUT_S = 5.0
START_TIMEOUT_S = 300.0  # from a process's start to its first answer: seconds of imports, times the machine's load
ACTIVATION_NS = 2_500_000_000  # within this every camera's activation is acknowledged, even on a busy machine
# idle BLAS and OpenMP threads that spin take the cores from the nodes that have work
THREADS_ENV = {"OPENBLAS_NUM_THREADS": "1", "OMP_WAIT_POLICY": "passive"}
LOG_ENV = {"PYTHONUNBUFFERED": "1", "PYTHONFAULTHANDLER": "1"}  # the log ends with the stack of a crash in native code
LOOK_S = 0.05  # rclpy has no event for a node that is discovered
CONFIRM_S = 1.0  # a restarted node that does not say so soon that it is active is asked again
RESTARTING = "restarting"
ENCLAVES = "/sagoma"  # of the keystores of `sagoma security`


class Supervisor:
    """Owns the processes of one graph; a context manager that leaves nothing running.

    with Supervisor(graph, run_folder) as run:
        run.configure()
        run.activate()
        ...
        print(run.usage())
    """

    def __init__(
        self,
        graph: Sequence[NodeSpec],
        run_folder: str | Path,
        *,
        domain_id: int | None = None,
        env: Mapping[str, str] | None = None,
        grace_s: float = GRACE_S,
        cancel: threading.Event | None = None,
        on_event: Callable[[Death | Return], None] = lambda event: None,
        server: str = ONE_PROCESS,
        restart: RestartPolicy | None = None,
    ) -> None:
        """``on_event`` is called, from another thread, for every process that ends by itself or is back again.

        server : ONE_PROCESS or THREE_PROCESSES, for the server's nodes; each camera has a process of its own.
        run_folder : gets one log and one parameter file a process; made when missing.
        domain_id : ROS_DOMAIN_ID of the graph, the environment's by default.
        grace_s : how long a node may take to end after SIGINT before it is killed.
        cancel : once set, :meth:`configure` and :meth:`activate` wait no longer (and raise GraphError).
        restart : once the graph is active, processes that crash are started again and become active by themselves,
            but for cameras that read files: their place in the footage is lost. What they had learnt is restored
            (`restored_state`). None: what has died stays dead.
        """
        self.run_folder = Path(run_folder)
        self.graph = with_common_epoch(graph, time.time_ns())
        if restart is not None:
            self.graph = with_kept_backgrounds(self.graph, self.run_folder)
        self.processes = processes_of(self.graph, server)
        self.exit_statuses: tuple[ExitStatus, ...] = ()
        self.stop_outcome = Outcome(())
        self._domain_id, self._env, self._grace_s = domain_id, dict(env or {}), grace_s
        self._on_event, self._restart = on_event, restart
        self._cancel = cancel or threading.Event()
        self._stopping = self._running = False
        self._lock = threading.Lock()
        self._children: dict[str, Child] = {}
        self._states: dict[str, str] = {}
        self._link: RosLink | None = None
        self._restarter: Restarter | None = None
        self._body: LastBody | None = None
        self._shared_memory: set[str] = set()

    def __enter__(self) -> Supervisor:
        self.start()
        return self

    def __exit__(self, *error: object) -> None:
        self.stop()

    @property
    def node(self) -> Node:
        """The supervisor's own node, spun by a thread, once it has been started: for further requests to the graph."""
        assert self._link is not None
        return self._link.node

    def start(self) -> None:
        """Start every process; they rest unconfigured until :meth:`configure`."""
        self.run_folder.mkdir(parents=True, exist_ok=True)
        self._link = RosLink("sagoma_supervisor", domain_id=self._domain_id)
        self.diagnostics = DiagnosticsTable(self._link.node)
        self.lifecycle = LifecycleClient(self._link.node, alive=self._should_wait_for)
        try:
            for process in self.processes:
                (self.run_folder / f"{process.label}.log").unlink(missing_ok=True)
                self._spawn(process)
            if self._restart is not None:
                self._body = LastBody(self._link.node, self.run_folder)
                self._restarter = Restarter(self._restart, self._start_again, self._is_active, self._on_event)
        except BaseException:
            self.stop()
            raise

    def stop(self) -> tuple[ExitStatus, ...]:
        """Deactivate, clean up, SIGINT, and after the grace period SIGKILL; returns how each process ended.

        :attr:`stop_outcome` holds the answers to the lifecycle requests.
        """
        if self._link is None:
            return self.exit_statuses
        self._stopping, self._running = True, False
        if self._restarter is not None:
            self._restarter.halt()
        self.stop_outcome = self.suspend() + self._bring(
            self._in(State.INACTIVE, cameras_first=True), State.UNCONFIGURED, STOP_TIMEOUT_S
        )
        children = list(dict.fromkeys(self._children.values()))
        self.exit_statuses = stop_children(children, self._grace_s)
        if self._restarter is not None:
            self._restarter.close()
        self._link.close()
        self._link = None
        remove_abandoned(self._shared_memory.union(*(child.shared_memory for child in children)))
        return self.exit_statuses

    def configure(self, *, tolerate_cameras: bool = True) -> Outcome:
        """Connect every node. Raises GraphError when one of the server fails, or every camera (any, if not tolerated).

        GraphError, too, when nodes of the same names run already: two graphs would mix their messages.
        """
        self._await_own_nodes()
        outcome = self._bring(self._in(State.UNCONFIGURED), State.INACTIVE, contact_s=START_TIMEOUT_S)
        self._refuse_foreign_nodes(outcome)
        self._check(State.INACTIVE, outcome, tolerate_cameras)
        return outcome

    def activate(self, *, tolerate_cameras: bool = True) -> Outcome:
        """Start every configured node, the cameras last; GraphError as for :meth:`configure`.

        Footage played by the clock, without an epoch of its own, starts at the next whole 5 s: all its cameras are
        activated within one such span, so that they agree on it.
        """
        server, cameras = self._in(State.INACTIVE)
        outcome = self._bring([server], State.ACTIVE)
        if any(_chooses_epoch(spec) for spec in self.graph if spec.full_name in cameras):
            self._cancel.wait(seconds_to_start_window(time.time_ns()))
        outcome += self._bring([cameras], State.ACTIVE)
        self._check(State.ACTIVE, outcome, tolerate_cameras)
        with self._lock:
            self._running = True
            lost = [process for process in self.processes if not self._child_of(process).alive]
        for process in lost:
            self._report_exit(process, self._child_of(process))
        return outcome

    def suspend(self) -> Outcome:
        """Deactivate every active node, the cameras first; what dies from now on stays dead."""
        self._running = False
        return self._bring(self._in(State.ACTIVE, cameras_first=True), State.INACTIVE, STOP_TIMEOUT_S)

    def alive(self, name: str) -> bool:
        """Whether the process of the node with this full name still runs."""
        child = self._children.get(name)
        return child is not None and child.alive

    def states(self) -> dict[str, str]:
        """Full node name -> lifecycle state as last acknowledged, "dead", or "restarting" after a crash."""
        with self._lock:
            known = dict(self._states)
        return {n: known.get(n, FRESH) if child.alive else self._absence(child) for n, child in self._children.items()}

    def pids(self) -> dict[str, int]:
        """Full node name -> process id."""
        return {name: child.pid for name, child in self._children.items()}

    def usage(self) -> dict[str, Usage]:
        """Label of each living process -> the memory and processor time that it uses."""
        found = {process.label: self._child_of(process).usage() for process in self.processes}
        return {label: usage for label, usage in found.items() if usage is not None}

    def log_tail(self, name: str, lines: int = 15) -> str:
        """Return the last lines of the log of a node's process."""
        return self._children[name].log_tail(lines)

    def _spawn(self, process: ProcessSpec) -> Child:
        """Start a process. Children of the restarting thread live as long as it, the others as long as the caller's."""
        parameters = self.run_folder / f"{process.label}.yaml"
        save_mapping(parameters, process.parameter_document())
        executable = node_command(process.package, process.executable, process.module)
        command = [*executable, "--ros-args", *process.name_arguments, *enclave_arguments(process)]
        command += ["--params-file", str(parameters)]
        log, env = self.run_folder / f"{process.label}.log", self._child_environment()
        child = Child(process.label, command, log, env, partial(self._report_exit, process))
        self._children |= dict.fromkeys((node.full_name for node in process.nodes), child)
        return child

    def _child_of(self, process: ProcessSpec) -> Child:
        return self._children[process.nodes[0].full_name]

    def _absence(self, dead: Child) -> str:
        return RESTARTING if self._restarter is not None and self._restarter.is_waiting(dead.name) else "dead"

    def _child_environment(self) -> dict[str, str]:
        env = {**THREADS_ENV, **os.environ, **self._env, **LOG_ENV}
        env["ROS_LOG_DIR"] = str(self.run_folder / "ros_log")
        if self._domain_id is not None:
            env["ROS_DOMAIN_ID"] = str(self._domain_id)
        return env

    def _should_wait_for(self, name: str) -> bool:
        return self.alive(name) and (self._stopping or not self._cancel.is_set())

    def _report_exit(self, process: ProcessSpec, child: Child) -> None:
        with self._lock:
            for node in process.nodes:
                self._states.pop(node.full_name, None)
            self._shared_memory |= child.shared_memory
            running = self._running
        why_not = self._why_no_restart(process, child, running)
        delay_s = self._restarter.take(process) if self._restarter is not None and not why_not else None
        if not why_not and delay_s is None and self._restarter is not None:
            why_not = self._restarter.give_up_reason()
        reason = exit_reason(child.returncode)
        self._on_event(Death(process, child.pid, reason, child.log, child.log_tail(), delay_s, why_not))

    def _why_no_restart(self, process: ProcessSpec, child: Child, running: bool) -> str:
        """Say why a process that has ended is not started again; empty when it is."""
        if self._restarter is None:
            return "nobody asked for restarts"
        if not running:
            return "the graph is not active"
        if child.returncode == 0:
            return "somebody asked it to end"
        if any(reads_file(node) for node in process.nodes):
            return "it reads footage, and its place in it is lost"
        return ""

    def _start_again(self, process: ProcessSpec) -> int:
        """Start a process whose nodes become active by themselves; returns its process id."""
        remove_abandoned(self._shared_memory)  # each crash leaves megabytes in /dev/shm
        assert self._body is not None
        restored = self._body.restored(process)
        nodes = tuple(
            node.with_parameters({"autostart": True, **restored.get(node.full_name, {})}) for node in process.nodes
        )
        return self._spawn(replace(process, nodes=nodes)).pid

    def _is_active(self, process: ProcessSpec) -> bool:
        """Ask the nodes of a restarted process for their states; True when all are active."""
        names = [node.full_name for node in process.nodes]
        active = State.ACTIVE.value
        if set(self.lifecycle.states(names, CONFIRM_S).values()) != {active}:
            return False
        self._child_of(process).note_shared_memory()
        with self._lock:
            self._states |= dict.fromkeys(names, active)
        return True

    def _in(self, state: State, *, cameras_first: bool = False) -> list[list[str]]:
        """Return the nodes in ``state``: the server's and the cameras', or the other way round."""
        states = self.states()
        order = (Role.CAMERA, Role.SERVER) if cameras_first else (Role.SERVER, Role.CAMERA)
        return [
            [spec.full_name for spec in self.graph if spec.role is role and states.get(spec.full_name) == state.value]
            for role in order
        ]

    def _bring(
        self,
        groups: Sequence[Sequence[str]],
        goal: State,
        timeout_s: float | None = None,
        contact_s: float = STOP_TIMEOUT_S,
    ) -> Outcome:
        for child in set(self._children.values()):
            child.note_shared_memory()
        outcome = self.lifecycle.bring(groups, goal, timeout_s, contact_s)
        with self._lock:
            for answer in outcome.answers:
                if answer.transition is not None and answer.verdict is Verdict.ACKNOWLEDGED:
                    self._states[answer.node] = REACHED[answer.transition].value
        return outcome

    def _await_own_nodes(self) -> None:
        """Wait until every living process's nodes are known. Raises GraphError for their like on another machine.

        What runs elsewhere has been there for longer, and is known by then: nothing of it is ever asked to change.
        """
        here, deadline_s = own_machine(self.node), time.monotonic() + START_TIMEOUT_S
        while time.monotonic() < deadline_s:
            foreign, unknown = foreign_names(machines_of(self.node), here, self._children)
            if foreign:
                raise GraphError(_run_already(foreign, " on another machine"))
            if not any(map(self._should_wait_for, unknown)):
                return
            self._cancel.wait(LOOK_S)

    def _refuse_foreign_nodes(self, configured: Outcome) -> None:
        """Raise GraphError for foreign nodes of our names: found twice, or in a state that no new process has."""
        assert self._link is not None
        seen = Counter(node_names(self._link.node))
        asked = {answer.node for answer in configured.answers}
        foreign = sorted(n for n in self._children if seen[n] > 1 or (self.states()[n] == FRESH and n not in asked))
        if foreign:
            raise GraphError(_run_already(foreign))

    def _check(self, goal: State, outcome: Outcome, tolerate_cameras: bool) -> None:
        states = self.states()
        failed = [spec for spec in self.graph if states[spec.full_name] != goal.value]
        cameras = [spec for spec in self.graph if spec.role is Role.CAMERA]
        lost_cameras = [spec for spec in failed if spec.role is Role.CAMERA]
        tolerated = tolerate_cameras and len(lost_cameras) == len(failed) < len(cameras)
        if failed and not tolerated:
            raise GraphError("\n".join(self._failure_report(spec, states[spec.full_name], outcome) for spec in failed))

    def _failure_report(self, spec: NodeSpec, state: str, outcome: Outcome) -> str:
        child = self._children[spec.full_name]
        answers = [str(answer) for answer in outcome.failures if answer.node == spec.full_name]
        if state == "dead":
            answers = [f"{spec.full_name} has died (status {child.returncode})"]
        elif spec.full_name in outcome.silent and (busy := busy_machine()):
            answers.append(busy)
        tail = child.log_tail().replace("\n", "\n    ") or "(empty)"
        return f"{'; '.join(answers) or f'{spec.full_name} is {state}'}; the end of {child.log.name}:\n    {tail}"


def _run_already(names: Sequence[str], where: str = "") -> str:
    remedy = "stop that graph, or give this one another ROS_DOMAIN_ID"
    return f"{', '.join(names)} run already in this ROS domain{where}: {remedy}"


def seconds_to_start_window(now_ns: int) -> float:
    """How long to wait until enough is left of the current span of EPOCH_STEP_NS to activate every camera within it."""
    into_ns = now_ns % EPOCH_STEP_NS
    return 0.0 if into_ns <= EPOCH_STEP_NS - ACTIVATION_NS else (EPOCH_STEP_NS - into_ns) / 1e9


def with_common_epoch(graph: Sequence[NodeSpec], epoch_ns: int) -> tuple[NodeSpec, ...]:
    """Return the graph, its footage that is not played by the clock (rate 0) stamped from one epoch.

    Any instant will do. Without a common one, cameras that are activated before and after a whole 5 s would stamp their
    frames 5 s apart, and no frame set would ever be complete.
    """
    unpaced = [spec.full_name for spec in graph if _chooses_epoch(spec) and spec.parameters.get("footage.rate") == 0]
    if len(unpaced) < 2:
        return tuple(graph)
    epoch = {"footage.epoch_ns": epoch_ns}
    return tuple(spec.with_parameters(epoch) if spec.full_name in unpaced else spec for spec in graph)


def enclave_arguments(process: ProcessSpec) -> list[str]:
    """ROS arguments that give a process its certificate; none where security (SROS 2) is not switched on.

    All of the server's nodes have the same certificate, whether they share a process or not.
    """
    if os.environ.get("ROS_SECURITY_ENABLE", "").lower() != "true":
        return []
    is_camera = any(node.role is Role.CAMERA for node in process.nodes)
    return ["--enclave", f"{ENCLAVES}/{process.label if is_camera else SERVER_EXECUTABLE}"]


def _chooses_epoch(camera: NodeSpec) -> bool:
    return camera.parameters.get("source") == "footage" and not camera.parameters.get("footage.epoch_ns")
