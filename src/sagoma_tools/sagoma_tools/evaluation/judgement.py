"""Everything that `sagoma evaluate` says about one track."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass

import numpy as np

from capture_rig.session import Session

from .jitter import Jitter, jitter
from .scores import Scores, number, score
from .track import Track

TRACKING = "tracking"


@dataclass(frozen=True, eq=False)
class Judgement:
    """A track and what became of it.

    frames : frames of footage that were looked at, fps of them a second.
    states : what the tracker said of itself -> in how many frames.
    time_to_track_s : from the first frame to the first that the tracker calls tracked, NaN when it never does.
    scores : against the truth, where the session has one. thesis : those of the thesis's method on the same hulls.
    """

    session: Session
    frames: int
    track: Track
    states: dict[str, int]
    time_to_track_s: float
    jitter: Jitter
    scores: Scores | None
    thesis: Scores | None = None

    def figures(self) -> dict[str, object]:
        """Name to number, for a line of JSON; without a truth, what can be said without one."""
        whole: dict[str, object] = {"frames": self.frames, "tracked": len(self.track)}
        if self.scores is not None:
            whole |= self.scores.figures()
        if self.thesis is not None:
            whole["thesis_mean_mm"] = number(self.thesis.mean_mm)
        whole["time_to_track_s"] = number(self.time_to_track_s, 3)
        whole["jitter_mm"] = number(self.jitter.rms_mm, 2)
        whole["states"] = self.states
        return whole


def judge(session: Session, frames: int, track: Track, thesis: Track | None = None) -> Judgement:
    """Score a session's track, and the one of the thesis's method if there is one."""
    truth = session.truth
    return Judgement(
        session=session,
        frames=frames,
        track=track,
        states=dict(Counter(track.states.tolist())),
        time_to_track_s=time_to_track_s(track, session.fps),
        jitter=jitter(track, session.fps, truth),
        scores=None if truth is None else score(track, truth),
        thesis=None if truth is None or thesis is None or not len(thesis) else score(thesis, truth),
    )


def time_to_track_s(track: Track, fps: float) -> float:
    """Seconds from frame 0 to the first frame in which the tracker says that it tracks; NaN when it never does."""
    tracked = track.frames[track.states == TRACKING]
    return float(np.min(tracked)) / fps if len(tracked) else float("nan")
