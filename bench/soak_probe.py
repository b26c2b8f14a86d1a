"""What a soak watches from outside: what became of every exposure, and what each process holds."""

from __future__ import annotations

import csv
import threading
import time
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, TextIO

import psutil
from diagnostic_msgs.msg import DiagnosticArray
from rclpy.node import Node
from rclpy.qos import HistoryPolicy, QoSProfile
from sensor_msgs.msg import JointState

from sagoma_tools.graph.topics import LATENCY_TOPIC

FRAME_SET_TOPIC, JOINT_STATES_TOPIC = "/hull/frame_set", "/mocap/joint_states"
SETTLED_S = 5.0  # no answer comes later than this after its exposure: longer than a frame set ever waits
QUEUE = QoSProfile(history=HistoryPolicy.KEEP_LAST, depth=200)
SECOND_NS = 1_000_000_000
COUNTERS = (
    *("expected", "delivered", "incomplete", "lost", "results", "frames_thinned", "frames_without_background"),
    *("failed_frames", "bad_frames", "frames_dropped", "reconnects", "stalls", "control_losses", "missing_packets"),
    *("resent_packets", "frames", "sets_complete", "sets_incomplete", "frames_missing", "frames_late"),
    *("frames_duplicate", "frames_backwards", "frames_ahead", "frames_refused", "bad_images", "sets_dropped"),
    *("dropped_sets", "backward_stamps", "restarts", "recoveries", "without_body", "unexpected_errors", "rate_hz"),
    *("latency_p50_ms", "latency_p95_ms", "thinning"),
)
"""Of the nodes' diagnostics; each node has some of them."""


@dataclass
class Exposure:
    """What became of the cameras' frames of one instant.

    cameras, missing : in its frame set, both 0 where no set of it came. age_ms : exposure to answer; None: none came.
    """

    cameras: int = 0
    missing: int = 0
    age_ms: float | None = None
    tracked: bool = False

    def row(self) -> tuple[object, ...]:
        """Return its cells of exposures.csv."""
        return self.cameras, self.missing, "" if self.age_ms is None else f"{self.age_ms:.1f}", int(self.tracked)


@dataclass
class Sightings:
    """The instants of the last whole frame set and the last joint state, ns; and all exposures that are not old yet."""

    whole_ns: int = 0
    tracked_ns: int = 0
    exposures: dict[int, Exposure] = field(default_factory=dict)


class ExposureProbe:
    """Follows every exposure of cameras in step at ``hz``: its frame set, its answer, its joint states.

    Instants are numbered: number n is n / hz seconds after the epoch.
    """

    def __init__(self, node: Node, hz: float) -> None:
        self._hz, self._lock, self._seen = hz, threading.Lock(), Sightings()
        self._subscriptions = [
            node.create_subscription(DiagnosticArray, FRAME_SET_TOPIC, self._on_frame_set, QUEUE),
            node.create_subscription(DiagnosticArray, LATENCY_TOPIC, self._on_answer, QUEUE),
            node.create_subscription(JointState, JOINT_STATES_TOPIC, self._on_joint_states, QUEUE),
        ]

    def number_at(self, instant_ns: int) -> int:
        """Return the number of the exposure nearest to an instant."""
        return round(instant_ns * self._hz / SECOND_NS)

    def whole_since(self, instant_ns: int) -> bool:
        """Return whether a whole frame set and a joint state of later exposures have come."""
        with self._lock:
            return min(self._seen.whole_ns, self._seen.tracked_ns) > instant_ns

    def take(self, before_ns: int) -> dict[int, Exposure]:
        """Take out the exposures before an instant, by their number."""
        last = self.number_at(before_ns)
        with self._lock:
            return {n: self._seen.exposures.pop(n) for n in sorted(self._seen.exposures) if n < last}

    def _of(self, message: Any) -> tuple[Exposure, int]:
        stamp = message.header.stamp
        stamp_ns = stamp.sec * SECOND_NS + stamp.nanosec
        return self._seen.exposures.setdefault(self.number_at(stamp_ns), Exposure()), stamp_ns

    def _on_frame_set(self, message: DiagnosticArray) -> None:
        values = {pair.key: pair.value for pair in message.status[0].values}
        cameras, missing = (len([n for n in values[key].split(",") if n]) for key in ("cameras", "missing"))
        with self._lock:
            exposure, stamp_ns = self._of(message)
            exposure.cameras, exposure.missing = cameras, missing
            if not missing:
                self._seen.whole_ns = stamp_ns

    def _on_answer(self, message: Any) -> None:
        now_ns = time.time_ns()
        with self._lock:
            exposure, stamp_ns = self._of(message)
            exposure.age_ms = (now_ns - stamp_ns) * 1e-6

    def _on_joint_states(self, message: JointState) -> None:
        with self._lock:
            exposure, stamp_ns = self._of(message)
            exposure.tracked = True
            self._seen.tracked_ns = stamp_ns


class Rows:
    """A CSV file that is written row by row, each at once, so that a kill loses none; continued where it exists."""

    def __init__(self, path: Path, columns: str) -> None:
        self._file: TextIO = path.open("a", newline="", encoding="utf-8")
        self._writer = csv.writer(self._file)
        if path.stat().st_size == 0:
            self.add(*columns.split())

    def add(self, *values: object) -> None:
        """Write one row."""
        self._writer.writerow([f"{value:.6g}" if isinstance(value, float) else value for value in values])
        self._file.flush()


def resources(pids: Mapping[str, int]) -> dict[str, tuple[int, float, float, float, float, int, int, float]]:
    """Label of each living process -> pid, memory (MiB), threads, file handles, CPU time (s).

    Memory: resident; unshared; anonymous, which is what the process has asked for (heaps, arrays, stacks); and shared
    (the middleware's segments). Unshared memory rises, too, when another process lets go of a page of a library.
    """
    found = {}
    for label, pid in pids.items():
        try:
            process = psutil.Process(pid)
            memory, cpu = process.memory_full_info(), process.cpu_times()
            parts = memory_parts(pid)
            held = (memory.rss / 2**20, memory.uss / 2**20, *parts, process.num_threads(), process.num_fds())
        except (psutil.Error, OSError):
            continue
        found[label] = (pid, *held, cpu.user + cpu.system)
    return found


def memory_parts(pid: int) -> tuple[float, float]:
    """Return the anonymous and the shared memory that is resident, MiB (proc(5), /proc/PID/status)."""
    kib = dict.fromkeys(("RssAnon", "RssShmem"), 0)
    for line in Path(f"/proc/{pid}/status").read_text().splitlines():
        name, _, value = line.partition(":")
        if name in kib:
            kib[name] = int(value.split()[0])
    return kib["RssAnon"] / 1024, kib["RssShmem"] / 1024
