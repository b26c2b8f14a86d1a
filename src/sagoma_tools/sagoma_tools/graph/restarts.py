"""Restarts of processes that ended by themselves: when, how often, and what is told about it.

A process that crashes is started again after a delay that doubles with each crash, and given up when it crashes again
and again: then its cause has to be removed first. One that ended with status 0 was asked to end, and stays ended.
"""

from __future__ import annotations

import signal
import threading
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from capture_rig.errors import InputError
from sagoma_bringup.processes import ProcessSpec

SETTLE_S = 1.0  # between two looks whether a restarted process is active: it takes seconds to start
LIKELY = {
    signal.SIGKILL: "by hand, or by the kernel when memory ran out (dmesg tells)",
    signal.SIGSEGV: "it crashed in native code; the end of its log has the Python stack",
    signal.SIGABRT: "native code gave up; its log says why",
    signal.SIGBUS: "memory could not be had: is /dev/shm or the disk full?",
}


@dataclass(frozen=True)
class RestartPolicy:
    """How crashed processes are started again.

    first_s, longest_s : delay before the first restart, s; it doubles with each crash up to the longest.
    most, within_s : a process that has crashed more often than ``most`` times within so many seconds is given up.
    """

    first_s: float = 1.0
    longest_s: float = 30.0
    most: int = 5
    within_s: float = 300.0

    def delay_s(self, deaths_s: Sequence[float]) -> float | None:
        """Return how long to wait after the last of these deaths (times, s, ascending); None: give up.

        Deaths longer ago than ``within_s`` before the last one are forgiven.
        """
        recent = [death for death in deaths_s if deaths_s[-1] - death <= self.within_s]
        if len(recent) > self.most:
            return None
        return min(self.first_s * 2.0 ** (len(recent) - 1), self.longest_s)


@dataclass(frozen=True)
class Death:
    """The end of a process that nobody of us asked for.

    reason : exit status or signal, and what it mostly means.
    restart_s : it is started again after so many seconds; None: it is not, for the reason in ``why_not``.
    """

    process: ProcessSpec
    pid: int
    reason: str
    log: Path
    log_tail: str
    restart_s: float | None = None
    why_not: str = ""

    def __str__(self) -> str:
        next_step = f"restart in {self.restart_s:g} s" if self.restart_s is not None else f"no restart: {self.why_not}"
        return f"{self.process} (pid {self.pid}) died: {self.reason}; {next_step}"


@dataclass(frozen=True)
class Return:
    """A restarted process whose nodes are active again, ``after_s`` after it had died."""

    process: ProcessSpec
    pid: int
    after_s: float

    def __str__(self) -> str:
        return f"{self.process} active again after {self.after_s:.1f} s (pid {self.pid})"


def exit_reason(returncode: int | None) -> str:
    """Say what an exit status means (negative: the number of the signal that ended the process)."""
    if returncode is None or returncode >= 0:
        return f"exit status {returncode}"
    try:
        number = signal.Signals(-returncode)
    except ValueError:
        return f"killed by signal {-returncode}"
    likely = LIKELY.get(number)
    return f"killed by {number.name}" + (f" ({likely})" if likely else "")


@dataclass
class _Pending:
    """A process that is down or starts: when it died, when it is started again (None: it has been)."""

    process: ProcessSpec
    died_s: float
    due_s: float | None
    pid: int = 0


@dataclass
class _Ledger:
    """Deaths of each process by label, and the restarts under way."""

    deaths_s: dict[str, list[float]] = field(default_factory=dict)
    pending: dict[str, _Pending] = field(default_factory=dict)


class Restarter:
    """Starts dead processes again when their delay is over, on a thread of its own, and tells when they are active.

    That thread lives until :meth:`close`: the kernel ends the children of a thread with it.
    """

    def __init__(
        self,
        policy: RestartPolicy,
        start: Callable[[ProcessSpec], int],
        is_active: Callable[[ProcessSpec], bool],
        on_return: Callable[[Return], None],
        now_s: Callable[[], float] = time.monotonic,
    ) -> None:
        """``start(process)`` starts it anew and returns its process id; ``is_active``: do all its nodes answer so?"""
        self._policy, self._start, self._is_active, self._on_return = policy, start, is_active, on_return
        self._now_s = now_s
        self._changed = threading.Condition()
        self._ledger = _Ledger()
        self._halted = self._closed = False
        self._thread = threading.Thread(target=self._run, name="restarts", daemon=True)
        self._thread.start()

    def take(self, process: ProcessSpec) -> float | None:
        """Note a death, and schedule the restart; returns its delay, s, None when the process is given up."""
        with self._changed:
            now_s = self._now_s()
            deaths_s = self._ledger.deaths_s.setdefault(process.label, [])
            deaths_s.append(now_s)
            delay_s = self._policy.delay_s(deaths_s)
            before = self._ledger.pending.pop(process.label, None)  # it died again before it was active
            if delay_s is None or self._halted:
                return None
            died_s = now_s if before is None else before.died_s
            self._ledger.pending[process.label] = _Pending(process, died_s, now_s + delay_s)
            self._changed.notify_all()
            return delay_s

    def is_waiting(self, label: str) -> bool:
        """Return whether the process with this label is down and will be started again."""
        with self._changed:
            pending = self._ledger.pending.get(label)
            return pending is not None and pending.due_s is not None

    def give_up_reason(self) -> str:
        """Say why a process is given up."""
        return (
            f"it crashed more than {self._policy.most} times within {self._policy.within_s:g} s; "
            "remove the cause that its log names, then start it again"
        )

    def halt(self) -> None:
        """Start nothing any more; returns when nothing is being started. What runs goes on until :meth:`close`."""
        with self._changed:
            self._halted = True
            self._ledger.pending.clear()
            self._changed.notify_all()

    def close(self) -> None:
        """End the thread, and with it (SIGINT) what it had started."""
        self.halt()
        with self._changed:
            self._closed = True
            self._changed.notify_all()
        self._thread.join()

    def _run(self) -> None:
        while True:
            with self._changed:
                self._changed.wait(self._wait_s())
                if self._closed:
                    return
                self._start_due()
                starting = [pending for pending in self._ledger.pending.values() if pending.due_s is None]
            for pending in starting:
                self._settle(pending)

    def _wait_s(self) -> float | None:
        """Return how long nothing is to be done; None: until something is scheduled."""
        waits = [
            SETTLE_S if pending.due_s is None else max(0.0, pending.due_s - self._now_s())
            for pending in self._ledger.pending.values()
        ]
        return min(waits, default=None)

    def _start_due(self) -> None:
        for pending in self._ledger.pending.values():
            if pending.due_s is not None and pending.due_s <= self._now_s():
                try:
                    pending.pid, pending.due_s = self._start(pending.process), None
                except (OSError, InputError):  # no memory for a process, no room for its files: perhaps later
                    pending.due_s = self._now_s() + self._policy.longest_s

    def _settle(self, pending: _Pending) -> None:
        if not self._is_active(pending.process):
            return
        with self._changed:
            if self._ledger.pending.get(pending.process.label) is not pending:
                return  # it has died again meanwhile
            del self._ledger.pending[pending.process.label]
        self._on_return(Return(pending.process, pending.pid, self._now_s() - pending.died_s))
