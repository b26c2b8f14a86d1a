"""The whole graph live on a stage, every node a process: run, recorded, and read back."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from diagnostic_msgs.msg import DiagnosticArray
from rclpy.serialization import deserialize_message
from sensor_msgs.msg import CompressedImage

from capture_rig.camera import CameraModel
from capture_rig.errors import InputError
from capture_rig.session import Session
from sagoma_ros.images import decode_silhouette

from ..graph.processes import Usage
from ..graph.supervisor import Supervisor
from ..graph.topics import PREDICTION_TOPIC, camera_topics
from ..recording.reader import read_messages
from ..recording.recorder import GraphRecorder
from ..recording.session_clock import SessionClock, clock_of_bag, silhouette_stamps
from .live_inputs import LiveInput
from .pictures import session_overlay
from .track import Track, track_from_bag
from .track_evaluation import TrackEvaluation, evaluate_track

FRAME_SET_TOPIC = "/hull/frame_set"
T_POSE_START, REFERENCE_START = "t_pose", "session"
AGES = {"received_ms", "published_ms"}  # time since capture: means nothing when footage is not played at its own rate


@dataclass(frozen=True, eq=False)
class LiveRun:
    """What one live run of the graph left behind.

    clock : when which frame of the session was seen.
    seen : (N,) the session's frames that a camera looked at.
    sets : frame sets sent; answered : how many of them the EKF answered, at sets_per_s of wall time.
    incomplete : sets that lacked a camera; spread_ms : the largest difference of capture stamps in one set.
    usage : memory and processor time by node, at the end of the run.
    cpu_ms_per_set : processor time that each node spent on one frame set, on average, its start left out.
    diagnostics : each node's last diagnostics; latency_ms : stage -> (sets,) time in it.
    """

    session: Session
    bag: Path
    clock: SessionClock
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
    stage: LiveInput,
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
                watch = UsageMeter(supervisor)
                play = stage.play(recorder, cancel)
                watch.stop()
                supervisor.suspend()
                recorder.close(**({} if play is None else play.provenance()))
    return _read_back(stage, bag, watch)


class UsageMeter:
    """What the graph's processes use, and last say of themselves, from its making until :meth:`stop`."""

    def __init__(self, supervisor: Supervisor) -> None:
        self._supervisor = supervisor
        self.began_ns, self._before = time.time_ns(), supervisor.usage()
        self.usage: dict[str, Usage] = {}
        self.diagnostics: dict[str, Mapping[str, str]] = {}

    def stop(self) -> None:
        names = [spec.full_name for spec in self._supervisor.graph]
        reports = {name: self._supervisor.diagnostics.report(name) for name in names}
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


def _read_back(stage: LiveInput, bag: Path, watch: UsageMeter) -> LiveRun:
    session = stage.session
    play, stamps = clock_of_bag(bag, session), silhouette_stamps(bag, session)
    watched_from_ns = watch.began_ns if stage.in_real_time else 0
    answers = [m.log_ns for m in read_messages(bag, PREDICTION_TOPIC.__eq__) if m.stamp_ns in play]
    sets = [_values(m.data) for m in read_messages(bag, FRAME_SET_TOPIC.__eq__) if m.stamp_ns in play]
    measured = {key for values in sets for key in values if key.endswith("_ms")} - {"spread_ms"}
    stages = sorted(measured if stage.in_real_time else measured - AGES)
    return LiveRun(
        session=session,
        bag=bag,
        clock=play,
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


# --- Silhouettes out of a bag, back in the camera's own pixels, for drawing over footage.


def image_masks(
    bag: Path, cameras: Iterable[CameraModel], frames: Sequence[int], frame_of_stamp: Callable[[int], int]
) -> dict[str, list[np.ndarray]]:
    """Each camera's silhouettes (H, W) at the given frames, distorted back to image pixels; empty where none came."""
    return {camera.name: _masks_of(bag, camera, frames, frame_of_stamp) for camera in cameras}


def distort_mask(camera: CameraModel, canvas_mask: np.ndarray) -> np.ndarray:
    """A mask (h, w) on the padded undistorted canvas, looked up at every pixel (H, W) of the camera's image."""
    canvas = camera.undistorted_view().camera
    rows, columns = np.mgrid[0 : camera.height, 0 : camera.width]
    rays_world = camera.rays_world(np.column_stack([columns.ravel(), rows.ravel()]))
    on_canvas = rays_world @ camera.R_camera_world.T @ canvas.K.T
    pixels = (on_canvas[:, :2] / on_canvas[:, 2:]).astype(np.float32).reshape(camera.height, camera.width, 2)
    return cv2.remap(canvas_mask, pixels[..., 0], pixels[..., 1], cv2.INTER_NEAREST)


def _masks_of(
    bag: Path, camera: CameraModel, frames: Sequence[int], frame_of_stamp: Callable[[int], int]
) -> list[np.ndarray]:
    topic, canvas = camera_topics(camera.name)[1].name, camera.undistorted_view().camera
    found = {}
    for message in read_messages(bag, topic.__eq__):
        frame = frame_of_stamp(message.stamp_ns)
        if frame in frames:
            mask = decode_silhouette(
                deserialize_message(message.data, CompressedImage), canvas.width, canvas.height, topic
            )
            found[frame] = distort_mask(camera, mask)
    empty = np.zeros((camera.height, camera.width), np.uint8)
    return [found.get(frame, empty) for frame in frames]


# --- What the demo shows of a live run: its scores and its pictures.

OVERLAY_FRAMES = 3


def draw(run: LiveRun, output: Path, judged: TrackEvaluation) -> list[Path]:
    """Write the overlay, the angles' and the errors' plots; returns their paths."""
    from .plots import draw_plots  # matplotlib takes a second to load

    session, track = run.session, run.track
    frames = [int(f) for f in track.frames[np.linspace(0, len(track.frames) - 1, OVERLAY_FRAMES + 2).astype(int)[1:-1]]]
    masks = image_masks(run.bag, session.rig.cameras, frames, run.clock.frame_of)
    overlay = output / "overlay.png"
    cv2.imwrite(str(overlay), session_overlay(session, frames, track.at(np.array(frames)).points_world, masks))
    return [overlay, *draw_plots(output, judged)]


def evaluate_run(run: LiveRun) -> TrackEvaluation:
    """The run's track against the truth of the frames that a camera looked at.

    That is all of footage, fewer where cameras were slower than it.
    """
    truth = None if run.session.truth is None else run.session.truth.of_frames(run.seen)
    return evaluate_track(replace(run.session, truth=truth), len(run.seen), run.track)
