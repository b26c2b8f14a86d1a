"""Processes that crash: when they are started again, what is told about it, and what they find again.

Rig, calibration and parameters are files that every start reads. Backgrounds that were learnt while the graph ran are
kept in the run folder; a tracker learns the sizes of the body anew.
"""

from __future__ import annotations

import signal
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from sagoma_bringup.graph import NodeSpec, ProcessSpec, Role

TRACKER = "icp_tracker"
LIKELY = {
    signal.SIGKILL: " (by hand, or by the kernel when memory ran out: see dmesg)",
    signal.SIGSEGV: " (it crashed in native code; the end of its log has the Python stack)",
    signal.SIGBUS: " (memory could not be had: is /dev/shm or the disk full?)",
}


@dataclass(frozen=True)
class RestartPolicy:
    """first_s, longest_s : delay before the first restart, s; it doubles with each crash up to the longest.
    most, within_s : a process that has crashed more often than ``most`` times within so many seconds is given up.
    """

    first_s: float = 1.0
    longest_s: float = 30.0
    most: int = 5
    within_s: float = 300.0

    def delay_s(self, exits_s: Sequence[float]) -> float | None:
        """Return how long to wait after the last of these crashes (times, s, ascending); None: give up."""
        recent = [each for each in exits_s if exits_s[-1] - each <= self.within_s]
        return min(self.first_s * 2.0 ** (len(recent) - 1), self.longest_s) if len(recent) <= self.most else None


@dataclass(frozen=True)
class ProcessExited:
    """The end of a process that nobody of us asked for.

    restart_s : it is started again after so many seconds; None: it is not, for the reason in ``why_not``.
    """

    process: ProcessSpec
    pid: int
    returncode: int | None
    log: Path
    log_tail: str
    restart_s: float | None = None
    why_not: str = ""

    @property
    def reason(self) -> str:
        """Exit status or signal, and what it mostly means."""
        if self.returncode is None or self.returncode >= 0:
            return f"exit status {self.returncode}"
        number = -self.returncode
        known = number in set(signal.Signals)
        name = signal.Signals(number).name if known else f"signal {number}"
        return f"killed by {name}{LIKELY.get(signal.Signals(number), '') if known else ''}"

    def __str__(self) -> str:
        next_step = f"restart in {self.restart_s:g} s" if self.restart_s is not None else f"no restart: {self.why_not}"
        return f"{self.process} (pid {self.pid}) died: {self.reason}; {next_step}"


@dataclass(frozen=True)
class ProcessRecovered:
    """A restarted process whose nodes are active again, ``after_s`` after it had died."""

    process: ProcessSpec
    pid: int
    after_s: float

    def __str__(self) -> str:
        return f"{self.process} active again after {self.after_s:.1f} s (pid {self.pid})"


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
