"""The whole graph live on a stage, every node a process: run, recorded, and read back."""

from __future__ import annotations

import threading
import time
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from diagnostic_msgs.msg import DiagnosticArray
from rclpy.serialization import deserialize_message

from capture_rig.errors import InputError
from capture_rig.session import Session

from .bags import read_messages
from .evaluation.track import Track, track_from_bag
from .graph_recorder import GraphRecorder
from .playing import Play, play_of_bag, silhouette_stamps
from .processes import Usage
from .stages import Stage
from .supervisor import Supervisor
from .topics import PREDICTION_TOPIC

FRAME_SET_TOPIC = "/hull/frame_set"
T_POSE_START, REFERENCE_START = "t_pose", "session"
AGES = {"received_ms", "published_ms"}  # time since capture: means nothing when footage is not played at its own rate


@dataclass(frozen=True, eq=False)
class LiveRun:
    """What one live run of the graph left behind.

    play : when which frame of the session was seen.
    seen : (N,) the session's frames that a camera looked at.
    sets : frame sets sent; answered : how many of them the EKF answered, at sets_per_s of wall time.
    incomplete : sets that lacked a camera; spread_ms : the largest difference of capture stamps in one set.
    usage : memory and processor time by node, at the end of the run.
    cpu_ms_per_set : processor time that each node spent on one frame set, on average, its start left out.
    diagnostics : each node's last diagnostics; latency_ms : stage -> (sets,) time in it.
    """

    session: Session
    bag: Path
    play: Play
    seen: np.ndarray
    sets: int
    answered: int
    sets_per_s: float
    incomplete: int
    spread_ms: float
    usage: dict[str, Usage]
    cpu_ms_per_set: dict[str, float]
    diagnostics: dict[str, Mapping[str, str]]
    latency_ms: dict[str, np.ndarray]
    track: Track


def run_live(
    stage: Stage,
    output: Path,
    *,
    start: str = "auto",
    settings: Mapping[str, Any] | None = None,
    domain_id: int | None = None,
    cancel: threading.Event | None = None,
) -> LiveRun:
    """Play a stage's session through the whole graph, every node a process, and record a bag into ``output``/bag.

    start : where the first pose comes from: "t_pose", "session" (its reference), or "auto": the reference where the
    session says that it has one of its own making (``reference*.csv``), else the T-pose.
    """
    cancel = cancel or threading.Event()
    bag, start_from = output / "bag", start_settings(stage.session, start)
    with stage:
        stage.open(cancel)
        graph = stage.graph({**start_from, **(settings or {})})
        with Supervisor(graph, output / "logs", domain_id=domain_id, cancel=cancel) as supervisor:
            supervisor.configure(tolerate_cameras=False)
            provenance = {"session": str(stage.session.folder)}
            with GraphRecorder(graph, bag, domain_id=domain_id, provenance=provenance) as recorder:
                recorder.wait_for_publishers()
                supervisor.activate(tolerate_cameras=False)
                stage.prepare(supervisor)
                watch = Watch(supervisor)
                play = stage.play(recorder, cancel)
                watch.stop()
                supervisor.suspend()
                recorder.close(**({} if play is None else play.provenance()))
    return _read_back(stage, bag, watch)


class Watch:
    """What the graph's processes use, and last say of themselves, from its making until :meth:`stop`."""

    def __init__(self, supervisor: Supervisor) -> None:
        self._supervisor = supervisor
        self.began_ns, self._before = time.time_ns(), supervisor.usage()
        self.usage: dict[str, Usage] = {}
        self.diagnostics: dict[str, Mapping[str, str]] = {}

    def stop(self) -> None:
        names = [spec.full_name for spec in self._supervisor.graph]
        reports = {name: self._supervisor.board.report(name) for name in names}
        self.usage = self._supervisor.usage()
        self.diagnostics = {name: report.values for name, report in reports.items() if report is not None}

    def cpu_ms_per_set(self, sets: int) -> dict[str, float]:
        """Processor time of each node, shared out among so many frame sets."""
        spent = {n: used.cpu_s - self._before[n].cpu_s for n, used in self.usage.items() if n in self._before}
        return {node: 1e3 * cpu_s / max(sets, 1) for node, cpu_s in spent.items()}


def start_settings(session: Session, start: str) -> dict[str, Any]:
    """The ICP node's parameters for where its first pose comes from."""
    if start == "auto":
        measured = session.truth is not None and session.truth.source.name.startswith("reference")
        start = REFERENCE_START if measured else T_POSE_START
    if start == REFERENCE_START and session.truth is None:
        raise InputError("has no reference to start from", where=str(session.folder), remedy="Start from a T-pose.")
    if start == T_POSE_START:
        return {"icp_tracker.initial_pose.source": T_POSE_START}
    return {
        "icp_tracker.initial_pose.source": REFERENCE_START,
        "icp_tracker.initial_pose.session": str(session.folder.resolve()),
        "icp_tracker.initial_pose.frame": int(session.truth.frames[0]),  # type: ignore[union-attr]
    }


def _read_back(stage: Stage, bag: Path, watch: Watch) -> LiveRun:
    session = stage.session
    play, stamps = play_of_bag(bag, session), silhouette_stamps(bag, session)
    watched_from_ns = watch.began_ns if stage.in_real_time else 0
    answers = [m.log_ns for m in read_messages(bag, PREDICTION_TOPIC.__eq__) if m.stamp_ns in play]
    sets = [_values(m.data) for m in read_messages(bag, FRAME_SET_TOPIC.__eq__) if m.stamp_ns in play]
    measured = {key for values in sets for key in values if key.endswith("_ms")} - {"spread_ms"}
    stages = sorted(measured if stage.in_real_time else measured - AGES)
    return LiveRun(
        session=session,
        bag=bag,
        play=play,
        seen=np.unique([play.frame_of(stamp) for sent in stamps.values() for stamp in sent if stamp in play]),
        sets=max(sum(stamp in play for stamp in sent) for sent in stamps.values()),
        answered=len(answers),
        sets_per_s=(len(answers) - 1) / max(1e-9 * (answers[-1] - answers[0]), 1e-9) if answers else 0.0,
        incomplete=sum(bool(values.get("missing")) for values in sets),
        spread_ms=max((float(values["spread_ms"]) for values in sets), default=float("nan")),
        usage=watch.usage,
        cpu_ms_per_set=watch.cpu_ms_per_set(
            max(sum(stamp >= watched_from_ns for stamp in sent) for sent in stamps.values())
        ),
        diagnostics=watch.diagnostics,
        latency_ms={k: np.array([float(v[k]) for v in sets if k in v]) for k in stages},
        track=track_from_bag(bag, play.frame_of).between(0, play.frames),
    )


def _values(data: bytes) -> dict[str, str]:
    status = deserialize_message(data, DiagnosticArray).status[0]
    return {pair.key: pair.value for pair in status.values}
