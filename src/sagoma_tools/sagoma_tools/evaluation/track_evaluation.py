"""Evaluates one track: scores against the truth, states, time to track, jitter at rest."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass

import numpy as np

from capture_rig.session import Session, Truth

from .scores import Scores, number, score
from .track import Track

WINDOW_S = 0.5
"""Length of the moving average whose removal leaves the jitter: above about 1 Hz."""
STILL_M = 0.010
"""A point rests at a frame when it stays this close to where it is then, for the whole window around it."""


@dataclass(frozen=True, eq=False)
class Jitter:
    """rms of the high-pass-filtered motion of the points at rest.

    With a centred moving average of :data:`WINDOW_S` (2 h + 1 frames), a point's jitter at frame k is
    ``x_k - mean(x_{k-h} .. x_{k+h})``. It counts at frame k when the point rests there: when the truth's point (without
    a truth, the moving average of the track's own) stays within :data:`STILL_M` of its place at k from k - h to k + h.

    rms_mm : over all points and frames that count, three axes together: white noise of sd s an axis gives
    s sqrt(3) sqrt(1 - 1 / (2 h + 1)). point_rms_mm : (15,) of each point; at_rest : (15,) how many frames counted.
    NaN where a point never rests.
    """

    rms_mm: float
    point_rms_mm: np.ndarray
    at_rest: np.ndarray


def jitter(track: Track, fps: float, truth: Truth | None = None) -> Jitter:
    """Return the track's jitter at rest; frames that it lacks (and truth that is unknown) count nowhere."""
    first, last = (int(track.frames.min()), int(track.frames.max())) if len(track) else (0, -1)
    frames = np.arange(first, last + 1)
    points = track.at(frames).points_world
    half = max(1, round(0.5 * WINDOW_S * fps))
    smooth = _windows(points, half).mean(-1)
    reference = smooth if truth is None else truth.points_at(frames)
    counts = _rests(reference, half) & np.isfinite(smooth).all(-1)
    squared = np.where(counts, ((points - smooth) ** 2).sum(-1), 0.0)
    point_count, count = counts.sum(0), counts.sum()
    return Jitter(
        rms_mm=1e3 * float(np.sqrt(squared.sum() / count)) if count else float("nan"),
        point_rms_mm=1e3 * np.where(point_count > 0, np.sqrt(squared.sum(0) / np.maximum(point_count, 1)), np.nan),
        at_rest=point_count,
    )


def _windows(points: np.ndarray, half: int) -> np.ndarray:
    """(F, 15, 3, 2 half + 1) the frames around each frame; NaN beyond the ends."""
    if len(points) == 0:
        return np.empty((0, *points.shape[1:], 2 * half + 1))
    padded = np.pad(points, ((half, half), (0, 0), (0, 0)), constant_values=np.nan)
    return np.lib.stride_tricks.sliding_window_view(padded, 2 * half + 1, axis=0)


def _rests(points: np.ndarray, half: int) -> np.ndarray:
    """(F, 15) bool."""
    away = np.linalg.norm(_windows(points, half) - points[..., None], axis=2)
    return away.max(-1, initial=0.0) < STILL_M


TRACKING = "tracking"


@dataclass(frozen=True, eq=False)
class TrackEvaluation:
    """The evaluation of one track.

    frames : frames of footage, fps of them a second.
    states : the tracker's state -> in how many frames.
    time_to_track_s : from the first frame to the first in state "tracking", NaN when there is none.
    scores : against the truth, where the session has one. thesis : those of the thesis's method on the same hulls.
    switches : identity switches of the person; None without a truth, or of somebody whom no track follows.
    """

    session: Session
    frames: int
    track: Track
    states: dict[str, int]
    time_to_track_s: float
    jitter: Jitter
    scores: Scores | None
    thesis: Scores | None = None
    switches: int | None = None

    def figures(self) -> dict[str, object]:
        """Name to number, for a line of JSON; without a truth, those that need none."""
        whole: dict[str, object] = {"frames": self.frames, "tracked": len(self.track)}
        whole |= dict.fromkeys(("flagged_of_bad", "false_alarms"))
        if self.scores is not None:
            whole |= self.scores.figures()
        if self.thesis is not None:
            whole["thesis_mean_mm"] = number(self.thesis.mean_mm)
        whole["identity_switches"] = self.switches
        whole["time_to_track_s"] = number(self.time_to_track_s, 3)
        whole["jitter_mm"] = number(self.jitter.rms_mm, 2)
        whole["states"] = self.states
        return whole


def evaluate_track(
    session: Session, frames: int, track: Track, thesis: Track | None = None, switches: int | None = None
) -> TrackEvaluation:
    """Score a session's track, and the one of the thesis's method if there is one; ``switches`` : of its person."""
    truth = session.truth
    return TrackEvaluation(
        session=session,
        frames=frames,
        track=track,
        states=dict(Counter(track.states.tolist())),
        time_to_track_s=time_to_track_s(track, session.fps),
        jitter=jitter(track, session.fps, truth),
        scores=None if truth is None else score(track, truth),
        thesis=None if truth is None or thesis is None or not len(thesis) else score(thesis, truth),
        switches=switches,
    )


def time_to_track_s(track: Track, fps: float) -> float:
    """Seconds from frame 0 to the first frame in state "tracking"; NaN when there is none."""
    tracked = track.frames[track.states == TRACKING]
    return float(np.min(tracked)) / fps if len(tracked) else float("nan")
