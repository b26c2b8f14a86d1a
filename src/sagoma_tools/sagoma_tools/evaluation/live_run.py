"""Runs the whole graph live, every node a process, records a bag, and reads it back as figures."""

from __future__ import annotations

import math
import shutil
import threading
from collections.abc import Mapping
from dataclasses import dataclass, replace
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
from diagnostic_msgs.msg import DiagnosticArray

from capture_rig.session import Session
from mocap_packets.table import AGE_POINTS
from sagoma_bringup.launch_arguments import start_settings
from sagoma_ros.messages import values_of

from ..console import doing
from ..graph.processes import Usage
from ..graph.supervisor import Supervisor
from ..graph.topics import LATENCY_TOPIC
from ..recording.reader import BagMessage, read_messages
from ..recording.recorder import GraphRecorder
from .live_inputs import FootageInput, StudioInput
from .track import SessionClock, Track, clock_of_bag, reasons_of_bag, silhouette_stamps, tracks_from_bag
from .track_evaluation import TrackEvaluation, evaluate_track, main_track

FRAME_SET_TOPIC = "/hull/frame_set"
LEAST_HZ = 25.0  # frame sets a second that the graph is to hold of simulated cameras, or they go slower
SLOWEST = 1 / 32
KEPT_UP = 0.9  # of the frame sets, at least, are answered in a sound capture, and have all cameras if simulated


@dataclass(frozen=True, eq=False)
class LiveRun:
    """The results of one live run of the graph.

    clock : maps times to frames of the session.
    seen : (N,) the session's frames that a camera captured.
    sets : frame sets sent; answered : number of them that the EKF answered, at sets_per_s of wall time.
    incomplete : sets that lacked a camera. usage : of the graph's processes, at the end of the run.
    diagnostics : each node's last diagnostics.
    ages_ms : point -> (sets,) age there since exposure (mocap/latency); none where stamps are not those of exposures.
    speed : of the cameras' time, of which sets_per_s alone is not.
    tracks : everybody's, by the person's number; the first person's is empty where nobody was tracked.
    reasons : of each fitted set, why somebody was not tracked in it, in the tracker's words.
    """

    session: Session
    bag: Path
    clock: SessionClock
    seen: np.ndarray
    sets: int
    answered: int
    sets_per_s: float
    incomplete: int
    usage: dict[str, Usage]
    diagnostics: dict[str, Mapping[str, str]]
    ages_ms: dict[str, np.ndarray]
    speed: float
    tracks: dict[int, Track]
    reasons: list[tuple[str, ...]]

    @property
    def track(self) -> Track:
        """The track of the person that the session's first truth is of; without several truths, the first person's."""
        return main_track(self.tracks, self.session.truths, self.session.fps)

    @property
    def is_whole(self) -> bool:
        """Whether nearly all frame sets have all cameras, and were answered."""
        return self.answered >= KEPT_UP * self.sets and self.incomplete <= (1 - KEPT_UP) * self.sets

    @property
    def hz_held(self) -> float:
        """Frame sets that the cameras' clients sent in a second of the session."""
        return self.sets * self.clock.fps / self.clock.frames


def run_live(
    live_input: FootageInput,
    output: Path,
    *,
    start: str = "auto",
    settings: Mapping[str, Any] | None = None,
    cancel: threading.Event | None = None,
) -> LiveRun:
    """Play a session through the whole graph, every node a process, and record a bag into ``output``/bag.

    start : source of the first pose: "t_pose", "session" (its reference), or "auto": the reference if the session has
    one made from its footage (``reference*.csv``), else a T-pose or a person who walks in.
    """
    cancel = cancel or threading.Event()
    bag, start_from = output / "bag", start_settings(live_input.session, start)
    with live_input:
        graph = live_input.graph({**start_from, **(settings or {})})
        with Supervisor(graph, output / "logs", cancel=cancel) as supervisor:
            doing(f"starting {len(graph)} nodes")
            supervisor.configure(tolerate_cameras=False)
            provenance = {"session": str(live_input.session.folder)}
            with GraphRecorder(graph, bag, provenance=provenance) as recorder:
                recorder.wait_for_graph()
                supervisor.activate(tolerate_cameras=False)
                doing("waiting until cameras and graph are in step")
                live_input.prepare(supervisor, cancel)
                doing("playing the session")
                clock = live_input.play(recorder, cancel)
                usage = supervisor.processes.usage()
                reports = {spec.full_name: supervisor.diagnostics.report(spec.full_name) for spec in graph}
                doing("stopping the nodes")
                supervisor.suspend()
                recorder.close(None if clock is None else clock.provenance())
    doing("reading the bag")
    diagnostics = {name: report.values for name, report in reports.items() if report is not None}
    return _read_back(live_input, bag, usage, diagnostics)


def run_studio(
    session_folder: str | Path,
    output: Path,
    fps: float,
    speed: float | None = None,
    *,
    cancel: threading.Event | None = None,
    **options: Any,
) -> LiveRun:
    """Run the whole graph on simulated cameras of ``fps`` Hz (:func:`run_live`), as slowly as this machine needs it.

    speed : of the cameras' time; None: 1 if the graph holds LEAST_HZ frame sets a second, else the largest power of two
    at which it holds them all; halved again while sets are torn or not answered.
    """
    cancel = cancel or threading.Event()
    chosen, speed = speed is not None, speed or 1.0
    while True:
        studio = StudioInput(session_folder, output / "studio", fps, speed, cancel=cancel)
        live = run_live(studio, output, cancel=cancel, **options)
        enough = live.is_whole and live.hz_held >= KEPT_UP * min(LEAST_HZ, fps)
        if chosen or cancel.is_set() or speed <= SLOWEST or enough:
            return live
        held = 2.0 ** math.floor(math.log2(max(live.hz_held / fps, SLOWEST)))
        speed = max(min(held, speed / 2), SLOWEST)
        doing(f"again, at {Fraction(speed)} of the speed: this machine does not hold the cameras' rate")
        shutil.rmtree(output / "bag", ignore_errors=True)


def _read_back(
    live_input: FootageInput, bag: Path, usage: dict[str, Usage], diagnostics: dict[str, Mapping[str, str]]
) -> LiveRun:
    """Read the bag's figures."""
    session = live_input.session
    clock, stamps = clock_of_bag(bag, session), silhouette_stamps(bag, session)
    answers = [m for m in read_messages(bag, LATENCY_TOPIC.__eq__) if m.stamp_ns in clock]
    sets = [_values(m) for m in read_messages(bag, FRAME_SET_TOPIC.__eq__) if m.stamp_ns in clock]
    points = [f"{point}_ms" for point in AGE_POINTS] if answers and live_input.in_real_time else []
    ages = [_values(answer) for answer in answers] if points else []
    span_s = 1e-9 * (answers[-1].log_ns - answers[0].log_ns) if answers else 0.0
    tracks = tracks_from_bag(bag, clock.frame_of, may_be_empty=True)
    return LiveRun(
        session=session,
        bag=bag,
        clock=clock,
        seen=np.unique([clock.frame_of(stamp) for sent in stamps.values() for stamp in sent if stamp in clock]),
        sets=max(sum(stamp in clock for stamp in sent) for sent in stamps.values()),
        answered=len(answers),
        sets_per_s=(len(answers) - 1) / max(span_s, 1e-9) if answers else 0.0,
        incomplete=sum(bool(values.get("missing")) for values in sets),
        usage=usage,
        diagnostics=diagnostics,
        ages_ms={point: np.array([float(values[point]) for values in ages]) for point in points},
        speed=float(live_input.clock.speed),
        tracks={n: track.between(0, clock.frames) for n, track in tracks.items()},
        reasons=reasons_of_bag(bag, clock.__contains__),
    )


def _values(message: BagMessage) -> dict[str, str]:
    statuses = message.decode(DiagnosticArray).status
    if not statuses:
        raise message.damaged("holds no status")
    return values_of(statuses[0])


def evaluate_run(run: LiveRun) -> TrackEvaluation:
    """Evaluate the run's track against the truth of the frames that a camera captured (of footage, all)."""
    truth = None if run.session.truth is None else run.session.truth.of_frames(run.seen)
    return evaluate_track(replace(run.session, truth=truth), len(run.seen), run.track)
