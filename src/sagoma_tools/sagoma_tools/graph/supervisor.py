"""Runs the node graph as processes, without the ros2 command line.

Starts every process (`processes`), drives the nodes' lifecycle with acknowledgements (the server's first, the cameras'
last), restarts crashed processes, and stops all cleanly. A camera may die; the graph goes on.

A restarted node finds rig, calibration and parameters in files. Backgrounds that were learnt while the graph ran are
kept in the run folder; a tracker learns the sizes of the body again.
"""

from __future__ import annotations

import signal
import threading
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from rclpy.node import Node

from sagoma_bringup.graph import ONE_PROCESS, NodeSpec, ProcessSpec, Role

from . import ANSWER_S, ROUND_S, START_TIMEOUT_S, GraphError
from .diagnostics_table import DiagnosticsTable
from .lifecycle_client import LifecycleClient, LifecycleState, Outcome, living_nodes
from .processes import Child, ExitStatus, ProcessGroup, busy_machine
from .ros_link import RosLink

RESTARTING, DEAD = "restarting", "dead"
TRACKER = "icp_tracker"
LIKELY = {
    signal.SIGKILL: " (by hand, or by the kernel when memory ran out: see dmesg)",
    signal.SIGSEGV: " (it crashed in native code; the end of its log has the Python stack)",
    signal.SIGBUS: " (memory could not be had: is /dev/shm or the disk full?)",
}


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
        server: str = ONE_PROCESS,
        *,
        cancel: threading.Event | None = None,
        on_event: Callable[[ProcessEvent], None] = lambda event: None,
        restart_delay_s: float | None = None,
    ) -> None:
        """``on_event`` is called, from another thread, for every process that ends by itself or is back again.

        run_folder : gets one log and one parameter file a process; made when missing.
        server : ONE_PROCESS or THREE_PROCESSES, for the server's nodes; each camera has a process of its own.
        cancel : once set, :meth:`configure` and :meth:`activate` wait no longer (and raise GraphError).
        restart_delay_s : once the graph is active, processes that crash are started again after this and become active
            by themselves, but for cameras that read files: their place in the footage is lost. None: they stay dead.
        """
        self.run_folder = Path(run_folder)
        self.graph = tuple(graph)
        if restart_delay_s is not None:
            self.graph = with_kept_backgrounds(self.graph, self.run_folder)
        self.processes = ProcessGroup(self.graph, self.run_folder, server, self._on_exit)
        self.exit_statuses: tuple[ExitStatus, ...] = ()
        self.stop_outcome = Outcome()
        self._on_event, self._restart_delay_s = on_event, restart_delay_s
        self._cancel, self._halted = cancel or threading.Event(), threading.Event()
        self._running = False
        self._lock = threading.RLock()  # held while a process is started, and while states change
        self._states: dict[str, str] = {}
        self._link: RosLink | None = None

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
        self._link = RosLink("sagoma_supervisor")
        self.diagnostics = DiagnosticsTable(self._link.node)
        self.lifecycle = LifecycleClient(self._link.node, alive=self._should_wait_for)
        try:
            names = {spec.full_name for spec in self.graph}
            if running := living_nodes(self.node, names):
                remedy = "End that graph, or give this one another ROS_DOMAIN_ID (or, launched, a namespace:=NAME)"
                raise GraphError(f"{', '.join(running)} run already in this ROS domain. {remedy}.")
            self.processes.start_all()
        except BaseException:
            self.stop()
            raise

    def stop(self) -> tuple[ExitStatus, ...]:
        """Deactivate, clean up, SIGINT, and after the grace period SIGKILL; returns how each process ended.

        :attr:`stop_outcome` holds the answers to the lifecycle requests.
        """
        if self._link is None:
            return self.exit_statuses
        with self._lock:
            self._halted.set()
        self.stop_outcome = self.suspend()
        cleaned = self._bring(LifecycleState.INACTIVE, LifecycleState.UNCONFIGURED, timeout_s=ANSWER_S)
        self.stop_outcome.failures |= cleaned.failures
        self.exit_statuses = self.processes.stop()
        self._link.close()
        self._link = None
        return self.exit_statuses

    def configure(self, *, tolerate_cameras: bool = True) -> Outcome:
        """Connect every node. GraphError when one of the server's fails, or every camera (any, if not tolerated)."""
        outcome = self._bring(LifecycleState.UNCONFIGURED, LifecycleState.INACTIVE, contact_s=START_TIMEOUT_S)
        self._check(LifecycleState.INACTIVE, outcome, tolerate_cameras)
        return outcome

    def activate(self, *, tolerate_cameras: bool = True) -> Outcome:
        """Start every configured node, the cameras last; GraphError as for :meth:`configure`."""
        outcome = self._bring(LifecycleState.INACTIVE, LifecycleState.ACTIVE)
        self._check(LifecycleState.ACTIVE, outcome, tolerate_cameras)
        with self._lock:
            self._running = True
        for process in self.processes.specs:
            child = self.processes.child_of(process.nodes[0].full_name)
            if not child.alive:  # it died before its restart would have been of use
                threading.Thread(target=self._on_exit, args=(process, child), daemon=True).start()
        return outcome

    def suspend(self) -> Outcome:
        """Deactivate every active node, the cameras first; processes that end from now on are not restarted."""
        self._running = False
        return self._bring(LifecycleState.ACTIVE, LifecycleState.INACTIVE, timeout_s=ANSWER_S)

    def states(self) -> dict[str, str]:
        """Full node name -> lifecycle state as last acknowledged, "dead", or "restarting" after a crash."""
        with self._lock:
            known = {name: self._states.get(name, LifecycleState.UNCONFIGURED) for name in self.processes.pids()}
            return {
                name: state if state == RESTARTING or self.processes.alive(name) else DEAD
                for name, state in known.items()
            }

    def _should_wait_for(self, name: str) -> bool:
        return self.processes.alive(name) and (self._halted.is_set() or not self._cancel.is_set())

    # crashes ----------------------------------------------------------------------------------------------------------

    def _on_exit(self, process: ProcessSpec, child: Child) -> None:
        """Report a process that has ended by itself and restart it, on the thread that watched it: unless it was asked
        to end, or reads footage, whose position is lost."""
        exited_s, names = time.monotonic(), [node.full_name for node in process.nodes]
        with self._lock:
            delay_s = self._restart_delay_s if self._running and not self._halted.is_set() else None
            if child.returncode == 0 or any(map(reads_file, process.nodes)):
                delay_s = None
            self._states |= dict.fromkeys(names, DEAD if delay_s is None else RESTARTING)
        next_step = "no restart" if delay_s is None else f"restart in {delay_s:g} s"
        text = f"{process} (pid {child.pid}) died: {reason_of(child.returncode)}; {next_step}"
        self._on_event(ProcessEvent(process, child.pid, text, False, f"the end of {child.log}:\n{child.log_tail()}"))
        if delay_s is None or self._halted.wait(delay_s):
            return
        with self._lock:
            if self._halted.is_set() or self.processes.child_of(names[0]) is not child:  # or it has been started again
                return
            again = self.processes.start(restarted(process))
            self._states |= dict.fromkeys(names, LifecycleState.UNCONFIGURED)
        while again.alive and not self._halted.wait(ROUND_S):
            if set(self.lifecycle.states(names, ROUND_S).values()) == {LifecycleState.ACTIVE}:
                with self._lock:
                    self._states |= dict.fromkeys(names, LifecycleState.ACTIVE)
                text = f"{process} active again after {time.monotonic() - exited_s:.1f} s (pid {again.pid})"
                self._on_event(ProcessEvent(process, again.pid, text, True))
                return

    # lifecycle --------------------------------------------------------------------------------------------------------

    def _bring(self, state: LifecycleState, goal: LifecycleState, **options: Any) -> Outcome:
        """Bring the nodes that are in ``state`` to ``goal``; options as of `LifecycleClient.bring`."""
        outcome = self.lifecycle.bring([name for name, now in self.states().items() if now == state], goal, **options)
        with self._lock:
            self._states |= outcome.reached
        return outcome

    def _check(self, goal: LifecycleState, outcome: Outcome, tolerate_cameras: bool) -> None:
        states = self.states()
        failed = [spec for spec in self.graph if states[spec.full_name] != goal]
        cameras = sum(spec.role is Role.CAMERA for spec in self.graph)
        lost = sum(spec.role is Role.CAMERA for spec in failed)
        if failed and not (tolerate_cameras and lost == len(failed) < cameras):
            raise GraphError("\n".join(self._failure_report(spec, states[spec.full_name], outcome) for spec in failed))

    def _failure_report(self, spec: NodeSpec, state: str, outcome: Outcome) -> str:
        child = self.processes.child_of(spec.full_name)
        what = outcome.failures.get(spec.full_name, f"{spec.full_name} is {state}")
        if state == DEAD:
            what = f"{spec.full_name} has died (status {child.returncode})"
        elif busy := busy_machine():
            what += f"; {busy}"
        tail = child.log_tail().replace("\n", "\n    ") or "(empty)"
        return f"{what}; the end of {child.log.name}:\n    {tail}"


# processes that crash -------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class ProcessEvent:
    """A process that has ended by itself, or one that is ``back``: its nodes are active again.

    text : the event, and the next step. log_tail : the end of the log of one that has ended.
    """

    process: ProcessSpec
    pid: int
    text: str
    back: bool
    log_tail: str = ""


def reason_of(returncode: int) -> str:
    """Return exit status or signal, and its usual meaning."""
    if returncode >= 0:
        return f"exit status {returncode}"
    number = signal.Signals(-returncode)
    return f"killed by {number.name}{LIKELY.get(number, '')}"


def with_kept_backgrounds(graph: Sequence[NodeSpec], folder: Path) -> tuple[NodeSpec, ...]:
    """Return the graph, the live cameras that save their background nowhere saving it into ``folder``."""
    return tuple(
        spec.with_parameters({"background_file": str((folder / f"{spec.label}_background.npz").resolve())})
        if spec.role is Role.CAMERA and not reads_file(spec) and not spec.parameters.get("background_file")
        else spec
        for spec in graph
    )


def reads_file(spec: NodeSpec) -> bool:
    """Return whether a node is a camera that plays footage."""
    return spec.role is Role.CAMERA and spec.parameters.get("source") == "footage"


def restarted(process: ProcessSpec) -> ProcessSpec:
    """Return the process with nodes that become active by themselves; its tracker finds the person in any pose."""
    own = {TRACKER: {"initial_pose.source": "auto"}}
    nodes = (node.with_parameters({"autostart": True, **own.get(node.name, {})}) for node in process.nodes)
    return replace(process, nodes=tuple(nodes))
