"""The main job on a session of footage: run the whole graph live, record it, measure it, draw it."""

from __future__ import annotations

import threading
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from diagnostic_msgs.msg import DiagnosticArray
from rclpy.serialization import deserialize_message

from capture_rig.errors import InputError
from capture_rig.session import Session, load_session
from sagoma_bringup.graph import build_graph
from stick_figure.skeleton import ANGLE_NAMES, POINT_NAMES

from .bags import read_messages
from .evaluation.pictures import plot_angles, plot_point_errors, session_overlay
from .evaluation.scores import Scores, score
from .evaluation.silhouettes import image_masks
from .evaluation.track import Track, track_from_bag
from .graph_recorder import GraphRecorder
from .processes import Usage
from .supervisor import Supervisor
from .topics import PREDICTION_TOPIC, camera_topics

SILENCE_S = 20.0
FLUSH_S = 5.0
T_POSE_START, REFERENCE_START = "t_pose", "session"
OVERLAY_FRAMES = 3
AGES = {"received_ms", "published_ms"}  # time since capture: means nothing when footage is not played at its own rate


@dataclass(frozen=True, eq=False)
class LiveRun:
    """What one live run of the graph left behind.

    sets : frame sets sent; answered : how many of them the EKF answered, at sets_per_s of wall time.
    incomplete : sets that lacked a camera; spread_ms : the largest difference of capture stamps in one set.
    usage : memory and processor time by node, at the end of the run.
    cpu_ms_per_set : processor time that each node spent on one frame set, on average, its start left out.
    diagnostics : each node's last diagnostics; latency_ms : stage -> (sets,) time in it.
    """

    session: Session
    bag: Path
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
    session_folder: str | Path,
    output: Path,
    *,
    rate: float = 1.0,
    start: str = "auto",
    settings: Mapping[str, Any] | None = None,
    domain_id: int | None = None,
    cancel: threading.Event | None = None,
) -> LiveRun:
    """Play a session through the whole graph, every node a process, and record a bag into ``output``/bag.

    rate : playing speed; 0 plays as fast as the graph keeps up.
    start : where the first pose comes from: "t_pose", "session" (its reference), or "auto": the reference where the
    session says that it has one of its own making (``reference*.csv``), else the T-pose.
    """
    session = load_session(session_folder)
    graph = build_graph(
        session=session_folder, rate=rate, settings={**start_settings(session, start), **(settings or {})}
    )
    bag = output / "bag"
    with Supervisor(graph, output / "logs", domain_id=domain_id, cancel=cancel) as supervisor:
        supervisor.configure(tolerate_cameras=False)
        with GraphRecorder(graph, bag, domain_id=domain_id, provenance={"session": str(session.folder)}) as recorder:
            recorder.wait_for_publishers()
            supervisor.activate(tolerate_cameras=False)
            usage_before = supervisor.usage()
            wait_for_the_end(recorder, session, cancel)
            usage = supervisor.usage()
            names = [spec.full_name for spec in graph]
            reports = {name: report.values for name in names if (report := supervisor.board.report(name))}
            supervisor.suspend()
    return _read_back(session, bag, (usage_before, usage), reports, live=rate > 0.0)


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


def frame_count(session: Session) -> int:
    """Frames of the session's shortest video."""
    return min(int(cv2.VideoCapture(str(path)).get(cv2.CAP_PROP_FRAME_COUNT)) for path in session.videos.values())


def wait_for_the_end(recorder: GraphRecorder, session: Session, cancel: threading.Event | None) -> None:
    """Return when the EKF has answered the last frame set, or when nothing has moved for SILENCE_S."""
    expected, seen = frame_count(session), -1
    while seen < expected and not (cancel and cancel.is_set()):
        reached = recorder.recorder.wait_for_count(PREDICTION_TOPIC, seen + 1, SILENCE_S)
        if not reached:
            return
        seen = recorder.recorder.counts.get(PREDICTION_TOPIC, 0)


def _read_back(
    session: Session,
    bag: Path,
    usage: tuple[dict[str, Usage], dict[str, Usage]],
    reports: dict[str, Any],
    *,
    live: bool,
) -> LiveRun:
    stamps = silhouette_stamps(bag, session)
    answers = [message.log_ns for message in read_messages(bag, PREDICTION_TOPIC.__eq__)]
    sets = [_values(message.data) for message in read_messages(bag, "/hull/frame_set".__eq__)]
    measured = {key for values in sets for key in values if key.endswith("_ms")} - {"spread_ms"}
    stages = sorted(measured if live else measured - AGES)
    return LiveRun(
        session=session,
        bag=bag,
        sets=len(stamps),
        answered=len(answers),
        sets_per_s=(len(answers) - 1) / max(1e-9 * (answers[-1] - answers[0]), 1e-9) if answers else 0.0,
        incomplete=sum(bool(values.get("missing")) for values in sets),
        spread_ms=max((float(values["spread_ms"]) for values in sets), default=float("nan")),
        usage=usage[1],
        cpu_ms_per_set={
            label: 1e3 * (after.cpu_s - usage[0][label].cpu_s) / len(stamps)
            for label, after in usage[1].items()
            if label in usage[0]
        },
        diagnostics=reports,
        latency_ms={k: np.array([float(v[k]) for v in sets if k in v]) for k in stages},
        track=session_track(bag, session),
    )


def session_track(bag: str | Path, session: Session) -> Track:
    """The track in a bag that was recorded while the session's footage played from its first frame."""
    epoch_ns = min(silhouette_stamps(bag, session))
    return track_from_bag(bag, lambda stamp_ns: round((stamp_ns - epoch_ns) * 1e-9 * session.fps))


def silhouette_stamps(bag: str | Path, session: Session) -> set[int]:
    """The stamps of all silhouettes of the session's cameras in a bag; InputError when there is none."""
    topics = {camera_topics(name)[1].name for name in session.rig.names}
    stamps = {message.stamp_ns for message in read_messages(bag, topics.__contains__)}
    if not stamps:
        raise InputError("holds no silhouette of the session's cameras", where=str(bag),
                         remedy="Give a bag of this session; if it is, read the cameras' logs beside it.")  # fmt: skip
    return stamps


def _values(data: bytes) -> dict[str, str]:
    status = deserialize_message(data, DiagnosticArray).status[0]
    return {pair.key: pair.value for pair in status.values}


def draw(run: LiveRun, output: Path, scores: Scores | None) -> list[Path]:
    """Write the overlay, the angles' and the errors' plots; returns their paths."""
    session, track = run.session, run.track
    frames = [int(f) for f in track.frames[np.linspace(0, len(track.frames) - 1, OVERLAY_FRAMES + 2).astype(int)[1:-1]]]
    masks = image_masks(run.bag, session, frames)
    paths = [output / name for name in ("overlay.png", "angles.png", "point_errors.png")]
    cv2.imwrite(str(paths[0]), session_overlay(session, frames, track.at(np.array(frames)).points_world, masks))
    truth = session.truth
    truth_seconds = None if truth is None or truth.angles is None else truth.frames / session.fps
    truth_angles = None if truth is None else truth.angles
    plot_angles(paths[1], ANGLE_NAMES, track.frames / session.fps, track.angles, truth_seconds, truth_angles)
    if scores is None or truth is None:
        return paths[:2]
    plot_point_errors(paths[2], POINT_NAMES, truth.frames / session.fps, scores.errors_mm)
    return paths


def judged(run: LiveRun) -> Scores | None:
    """The run's scores, None where the session has no truth."""
    return None if run.session.truth is None else score(run.track, run.session.truth)
