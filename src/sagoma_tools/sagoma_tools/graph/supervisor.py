"""Runs the node graph as processes, without the ros2 command line.

Starts every process (`process_group`), drives the nodes' lifecycle with acknowledgements (the server's first, the
cameras' last), starts what has crashed again (`restarts`), and stops all cleanly. A camera may die; the graph goes on.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

from rclpy.node import Node

from sagoma_bringup.graph import NodeSpec, Role
from sagoma_bringup.processes import ProcessSpec

from .diagnostics_table import DiagnosticsTable
from .errors import GraphError
from .lifecycle_client import REACHED, LifecycleClient, Outcome, State, Verdict
from .process_group import ProcessGroup, ProcessSettings
from .processes import Child, ExitStatus, busy_machine
from .restarts import Death, Restarter, RestartPolicy, Return, exit_reason
from .restored_state import LastBody, reads_file, with_kept_backgrounds
from .ros_link import RosLink
from .running_nodes import foreign_nodes, living_nodes, own_machine, places_of, run_already

FRESH = State.UNCONFIGURED.value
STOP_TIMEOUT_S = 5.0
START_TIMEOUT_S = 300.0  # from a process's start to its first answer: seconds of imports, times the machine's load
LOOK_S = 0.05  # rclpy has no event for a node that is discovered
CONFIRM_S = 1.0  # a restarted node that does not say so soon that it is active is asked again
RESTARTING = "restarting"


class Supervisor:
    """Owns the processes of one graph; a context manager that leaves nothing running.

    with Supervisor(graph, run_folder) as run:
        run.configure()
        run.activate()
        ...
        print(run.processes.usage())
    """

    def __init__(
        self,
        graph: Sequence[NodeSpec],
        run_folder: str | Path,
        settings: ProcessSettings | None = None,
        *,
        cancel: threading.Event | None = None,
        on_event: Callable[[Death | Return], None] = lambda event: None,
        restart: RestartPolicy | None = None,
    ) -> None:
        """``on_event`` is called, from another thread, for every process that ends by itself or is back again.

        run_folder : gets one log and one parameter file a process; made when missing.
        cancel : once set, :meth:`configure` and :meth:`activate` wait no longer (and raise GraphError).
        restart : once the graph is active, processes that crash are started again and become active by themselves,
            but for cameras that read files: their place in the footage is lost. What they had learnt is restored
            (`restored_state`). None: what has died stays dead.
        """
        self.run_folder, settings = Path(run_folder), settings or ProcessSettings()
        self.graph = with_common_epoch(graph, time.time_ns())
        if restart is not None:
            self.graph = with_kept_backgrounds(self.graph, self.run_folder)
        self.processes = ProcessGroup(self.graph, self.run_folder, settings, self._report_exit)
        self.exit_statuses: tuple[ExitStatus, ...] = ()
        self.stop_outcome = Outcome(())
        self._domain_id, self._on_event, self._restart = settings.domain_id, on_event, restart
        self._cancel = cancel or threading.Event()
        self._stopping = self._running = False
        self._lock = threading.Lock()
        self._states: dict[str, str] = {}
        self._link: RosLink | None = None
        self._restarter: Restarter | None = None
        self._body: LastBody | None = None

    def __enter__(self) -> Supervisor:
        self.start()
        return self

    def __exit__(self, kind: object, error: BaseException | None, trace: object) -> None:
        """Stop the graph. What a cancelled start could not reach is no failure of the graph: KeyboardInterrupt."""
        self.stop()
        if isinstance(error, GraphError) and self._cancel.is_set():
            raise KeyboardInterrupt from None

    @property
    def node(self) -> Node:
        """The supervisor's own node, spun by a thread, once it has been started: for further requests to the graph."""
        assert self._link is not None
        return self._link.node

    def start(self) -> None:
        """Start every process; they rest unconfigured until :meth:`configure`.

        GraphError when nodes of the same names run already: two graphs would mix their messages. Nothing is started.
        """
        self._link = RosLink("sagoma_supervisor", domain_id=self._domain_id)
        self.diagnostics = DiagnosticsTable(self._link.node)
        self.lifecycle = LifecycleClient(self._link.node, alive=self._should_wait_for)
        try:
            names = {spec.full_name for spec in self.graph}
            if running := living_nodes(self.node, names, self._cancel):
                raise GraphError(run_already(running, own_machine(self.node)))
            self.processes.start_all()
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
        self.exit_statuses = self.processes.stop()
        if self._restarter is not None:
            self._restarter.close()
        self._link.close()
        self._link = None
        self.processes.remove_shared_memory()
        return self.exit_statuses

    def configure(self, *, tolerate_cameras: bool = True) -> Outcome:
        """Connect every node. Raises GraphError when one of the server fails, or every camera (any, if not tolerated).

        GraphError, too, before any is asked, when nodes of the same names have come meanwhile.
        """
        self._await_own_nodes()
        outcome = self._bring(self._in(State.UNCONFIGURED), State.INACTIVE, contact_s=START_TIMEOUT_S)
        self._check(State.INACTIVE, outcome, tolerate_cameras)
        return outcome

    def activate(self, *, tolerate_cameras: bool = True) -> Outcome:
        """Start every configured node, the cameras last; GraphError as for :meth:`configure`."""
        outcome = self._bring(self._in(State.INACTIVE), State.ACTIVE)
        self._check(State.ACTIVE, outcome, tolerate_cameras)
        with self._lock:
            self._running = True
            children = [(process, self.processes.child_of(process)) for process in self.processes.specs]
            lost = [(process, child) for process, child in children if not child.alive]
        for process, child in lost:
            self._report_exit(process, child)
        return outcome

    def suspend(self) -> Outcome:
        """Deactivate every active node, the cameras first; what dies from now on stays dead."""
        self._running = False
        return self._bring(self._in(State.ACTIVE, cameras_first=True), State.INACTIVE, STOP_TIMEOUT_S)

    def states(self) -> dict[str, str]:
        """Full node name -> lifecycle state as last acknowledged, "dead", or "restarting" after a crash."""
        with self._lock:
            known = dict(self._states)
        children = self.processes.by_node()
        return {n: known.get(n, FRESH) if child.alive else self._absence(child) for n, child in children.items()}

    def _absence(self, dead: Child) -> str:
        return RESTARTING if self._restarter is not None and self._restarter.is_waiting(dead.name) else "dead"

    def _should_wait_for(self, name: str) -> bool:
        return self.processes.alive(name) and (self._stopping or not self._cancel.is_set())

    def _report_exit(self, process: ProcessSpec, child: Child) -> None:
        with self._lock:
            for node in process.nodes:
                self._states.pop(node.full_name, None)
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
        self.processes.remove_shared_memory()
        assert self._body is not None
        restored = self._body.restored(process)
        nodes = tuple(
            node.with_parameters({"autostart": True, **restored.get(node.full_name, {})}) for node in process.nodes
        )
        return self.processes.start(replace(process, nodes=nodes))

    def _is_active(self, process: ProcessSpec) -> bool:
        """Ask the nodes of a restarted process for their states; True when all are active."""
        names = [node.full_name for node in process.nodes]
        active = State.ACTIVE.value
        if set(self.lifecycle.states(names, CONFIRM_S).values()) != {active}:
            return False
        self.processes.child_of(process).note_shared_memory()
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
        self.processes.note_shared_memory()
        outcome = self.lifecycle.bring(groups, goal, timeout_s, contact_s)
        with self._lock:
            for answer in outcome.answers:
                if answer.transition is not None and answer.verdict is Verdict.ACKNOWLEDGED:
                    self._states[answer.node] = REACHED[answer.transition].value
        return outcome

    def _await_own_nodes(self) -> None:
        """Wait until the nodes of every living process are known. GraphError for nodes of their names that are not."""
        here, deadline_s = own_machine(self.node), time.monotonic() + START_TIMEOUT_S
        while time.monotonic() < deadline_s:
            foreign, unknown = foreign_nodes(places_of(self.node), here, self.processes.pids())
            if foreign:
                raise GraphError(run_already(foreign, here))
            if not any(map(self._should_wait_for, unknown)):
                return
            self._cancel.wait(LOOK_S)

    def _check(self, goal: State, outcome: Outcome, tolerate_cameras: bool) -> None:
        states = self.states()
        failed = [spec for spec in self.graph if states[spec.full_name] != goal.value]
        cameras = [spec for spec in self.graph if spec.role is Role.CAMERA]
        lost_cameras = [spec for spec in failed if spec.role is Role.CAMERA]
        tolerated = tolerate_cameras and len(lost_cameras) == len(failed) < len(cameras)
        if failed and not tolerated:
            raise GraphError("\n".join(self._failure_report(spec, states[spec.full_name], outcome) for spec in failed))

    def _failure_report(self, spec: NodeSpec, state: str, outcome: Outcome) -> str:
        child = self.processes.by_node()[spec.full_name]
        answers = [str(answer) for answer in outcome.failures if answer.node == spec.full_name]
        if state == "dead":
            answers = [f"{spec.full_name} has died (status {child.returncode})"]
        elif spec.full_name in outcome.silent and (busy := busy_machine()):
            answers.append(busy)
        tail = child.log_tail().replace("\n", "\n    ") or "(empty)"
        return f"{'; '.join(answers) or f'{spec.full_name} is {state}'}; the end of {child.log.name}:\n    {tail}"


def with_common_epoch(graph: Sequence[NodeSpec], epoch_ns: int) -> tuple[NodeSpec, ...]:
    """Return the graph, its footage that is not played by the clock (rate 0) stamped from one epoch; any will do."""

    def unstamped(spec: NodeSpec) -> bool:
        given = spec.parameters
        return given.get("source") == "footage" and given.get("footage.rate") == 0 and not given.get("footage.epoch_ns")

    epoch = {"footage.epoch_ns": epoch_ns}
    return tuple(spec.with_parameters(epoch) if unstamped(spec) else spec for spec in graph)
