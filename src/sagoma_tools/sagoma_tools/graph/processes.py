"""Child processes: started in their own process group, watched, stopped by pid; leftover shared memory is removed.

Of Fast DDS's shared memory the segments are removed, which are the megabytes and have names of their own. Its ports are
small and stay: their numbers from 7000 on are shared by the graphs of all domains of a machine, and Fast DDS opens one
that was left behind anew. To delete a port that another graph's process takes at this moment makes that process deaf to
the names of nodes.
"""

from __future__ import annotations

import contextlib
import ctypes
import os
import re
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from enum import Enum
from pathlib import Path

import psutil

PR_SET_PDEATHSIG = 1
REAP_S = 5.0
STALLED_S, LONGEST_START_S = 60.0, 900.0  # at a load of 50 a process has its turn every few seconds
SEGMENT_LOCK = re.compile(r"^/dev/shm/(fastrtps_(?!port)\w+)_el$")  # held open by the process that owns the segment
_libc = ctypes.CDLL(None)


def busy_machine() -> str:
    """Say how busy the machine is, and what helps, when more wants to run than it has processors; else nothing."""
    load, processors = os.getloadavg()[0], os.cpu_count() or 1
    if load <= processors:
        return ""
    return f"the machine is busy (load {load:.1f} on {processors} processors): end other programs and try again"


class StartDeadline:
    """Deadline for a process to start: as long as it is at work, however slowly a busy machine lets it.

    It is given up when it has not used the processor for STALLED_S, or after LONGEST_START_S: it hangs.
    """

    def __init__(self, cpu_s: Callable[[], float | None], now_s: Callable[[], float] = time.monotonic) -> None:
        """``cpu_s``: its processor time so far; None when it has ended."""
        self._cpu_s, self._now_s = cpu_s, now_s
        self._began_s = self._at_work_s = now_s()
        self._used_s = 0.0

    def exceeded(self) -> str:
        """Say why the process is waited for no longer; empty while it is."""
        used_s, now_s = self._cpu_s(), self._now_s()
        if used_s is None:
            return "it has ended"
        if used_s > self._used_s:
            self._used_s, self._at_work_s = used_s, now_s
        waited = f"after {now_s - self._began_s:.0f} s, {self._used_s:.1f} s of them on the processor"
        if now_s - self._at_work_s > STALLED_S:
            return f"it hangs {waited}"
        return f"it was not ready {waited}" if now_s - self._began_s > LONGEST_START_S else ""


class Exit(Enum):
    """How a child ended."""

    CLEAN = "stopped on SIGINT"
    KILLED = "ignored SIGINT and was killed"
    FAILED = "stopped with an error"
    ALREADY_DEAD = "had died before"


@dataclass(frozen=True)
class ExitStatus:
    """How one child ended, and its exit status (negative: the signal's number)."""

    name: str
    exit: Exit
    returncode: int


@dataclass(frozen=True)
class Usage:
    """Resources of a process: memory resident now and at its peak, MiB, processor time since its start, seconds."""

    resident_mib: float
    peak_mib: float
    cpu_s: float


class Child:
    """One running process with its log file.

    The kernel sends it SIGINT when the thread that started it ends, so that no node outlives its supervisor: start
    children from a thread that lives as long as they shall, usually the main one.
    """

    def __init__(
        self, name: str, command: Sequence[str], log: Path, env: Mapping[str, str], on_exit: Callable[[Child], None]
    ) -> None:
        """``on_exit`` is called from the child's watching thread when the process ends by itself.

        A log that exists is continued: that of a process that is started again.
        """
        self.name, self.log = name, log
        self.shared_memory: set[str] = set()
        self._stopping = False
        with log.open("ab") as sink:
            self._process = subprocess.Popen(
                command,
                stdin=subprocess.DEVNULL,
                stdout=sink,
                stderr=subprocess.STDOUT,
                env=dict(env),
                process_group=0,
                preexec_fn=_prepare_child,
            )
        self._on_exit = on_exit
        self._ended = threading.Event()
        threading.Thread(target=self._watch, name=f"watch {name}", daemon=True).start()

    @property
    def pid(self) -> int:
        return self._process.pid

    @property
    def alive(self) -> bool:
        return not self._ended.is_set()

    @property
    def returncode(self) -> int | None:
        return self._process.returncode

    def log_tail(self, lines: int = 15) -> str:
        """Return the last lines of its log."""
        return "\n".join(self.log.read_text(errors="replace").splitlines()[-lines:])

    def usage(self) -> Usage | None:
        """Return its resources; None once it has ended."""
        try:
            status = Path(f"/proc/{self.pid}/status").read_text()
            cpu = psutil.Process(self.pid).cpu_times()
        except (OSError, psutil.Error):
            return None
        kib = {line.split(":")[0]: int(line.split()[1]) for line in status.splitlines() if line.startswith("Vm")}
        return Usage(kib["VmRSS"] / 1024, kib["VmHWM"] / 1024, cpu.user + cpu.system) if "VmRSS" in kib else None

    def note_shared_memory(self) -> None:
        """Record which shared memory it owns: a node that is killed or crashes leaves it behind."""
        self.shared_memory |= owned_shared_memory([self.pid])

    def interrupt(self) -> None:
        """Ask it to stop (SIGINT)."""
        self._stopping = True
        if self.alive:
            self._process.send_signal(signal.SIGINT)

    def wait(self, timeout_s: float) -> bool:
        """True when it has ended within ``timeout_s``."""
        return self._ended.wait(timeout_s)

    def kill(self) -> None:
        """SIGKILL to its whole process group."""
        self._stopping = True
        if not self.alive:
            return
        self.note_shared_memory()
        with contextlib.suppress(ProcessLookupError):
            os.killpg(self.pid, signal.SIGKILL)
        self._ended.wait(REAP_S)

    def _watch(self) -> None:
        self._process.wait()
        self._ended.set()
        if not self._stopping:
            self._on_exit(self)


def stop_children(children: Sequence[Child], grace_s: float) -> tuple[ExitStatus, ...]:
    """Send SIGINT to all, and SIGKILL to those that still run ``grace_s`` later; returns how each one ended."""
    already_dead = {child.name for child in children if not child.alive}
    for child in children:
        child.interrupt()
    deadline_s = time.monotonic() + grace_s
    killed = set()
    for child in children:
        if not child.wait(max(0.0, deadline_s - time.monotonic())):
            killed.add(child.name)
            child.kill()
    return tuple(_exit_status(child, already_dead, killed) for child in children)


def node_command(package: str, executable: str, module: str) -> list[str]:
    """The installed executable when a sourced workspace has it (as ``ros2 run`` would find it), else the module."""
    for prefix in filter(None, os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep)):
        installed = Path(prefix) / "lib" / package / executable
        if os.access(installed, os.X_OK) and installed.is_file():
            return [str(installed)]
    return [sys.executable, "-m", module]


def owned_shared_memory(pids: Iterable[int]) -> set[str]:
    """Return the names of the Fast DDS shared-memory segments that these processes own."""
    matches = (SEGMENT_LOCK.match(target) for pid in pids for target in _open_files(pid))
    return {match[1] for match in matches if match}


def _open_files(pid: int) -> Iterator[str]:
    """What a process has open, but for what it closes meanwhile; nothing if it is not ours to look into."""
    with contextlib.suppress(OSError):
        for link in os.listdir(f"/proc/{pid}/fd"):
            with contextlib.suppress(OSError):
                yield os.readlink(f"/proc/{pid}/fd/{link}")


def shared_memory_files(names: Iterable[str]) -> list[Path]:
    """Return the files of these segments that exist."""
    paths = [Path(f"/dev/shm/{file}") for name in names for file in (name, f"{name}_el")]
    return [path for path in paths if path.exists()]


def abandoned(names: Iterable[str]) -> set[str]:
    """Return those of these segments that no living process owns."""
    names = set(names)
    return names - owned_shared_memory(process.pid for process in psutil.process_iter()) if names else names


def remove_abandoned(names: Iterable[str]) -> None:
    """Delete the files of those segments that no living process owns."""
    for path in shared_memory_files(abandoned(names)):
        path.unlink(missing_ok=True)


def _prepare_child() -> None:
    """Set up the child before exec: SIGINT when the supervisor ends, and not ignored even if the shell ignores it."""
    _libc.prctl(PR_SET_PDEATHSIG, signal.SIGINT)
    signal.signal(signal.SIGINT, signal.SIG_DFL)


def _exit_status(child: Child, already_dead: set[str], killed: set[str]) -> ExitStatus:
    code = child.returncode if child.returncode is not None else -signal.SIGKILL
    if child.name in already_dead:
        return ExitStatus(child.name, Exit.ALREADY_DEAD, code)
    if child.name in killed:
        return ExitStatus(child.name, Exit.KILLED, code)
    return ExitStatus(child.name, Exit.CLEAN if code in (0, -signal.SIGINT) else Exit.FAILED, code)
