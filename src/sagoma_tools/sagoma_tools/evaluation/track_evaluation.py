"""Evaluates one track (scores against the truth, states, time to track, jitter at rest), and those of several persons.

A track belongs to the truth that it is nearest to in its first second. From then on it should stay nearest to it: every
change counts as an identity switch, and so does every further number that a person is given.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from capture_rig.session import Session, Truth
from capture_rig.visibility import RigVisibility
from mocap_packets.state import Tracking

from .scores import OVERALL, Scores, mean_of_known, number, score
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
    s sqrt(3) sqrt(1 - 1 / (2 h + 1)), NaN where no point ever rests; at_rest : (15,) how many frames counted.
    """

    rms_mm: float
    at_rest: np.ndarray


def jitter(track: Track, fps: float, truth: Truth | None = None) -> Jitter:
    """Return the track's jitter at rest; frames that it lacks (and truth that is unknown) count nowhere."""
    first, last = (int(track.frames.min()), int(track.frames.max())) if len(track) else (0, -1)
    frames = np.arange(first, last + 1)
    points = track.at(frames).points_world
    half = max(1, round(0.5 * WINDOW_S * fps))
    smooth = _windows(points, half).mean(-1)
    reference = smooth if truth is None else truth.points_at(frames)
    away = np.linalg.norm(_windows(reference, half) - reference[..., None], axis=2)
    counts = (away.max(-1, initial=0.0) < STILL_M) & np.isfinite(smooth).all(-1)
    squared = np.where(counts, ((points - smooth) ** 2).sum(-1), 0.0)
    rms_m = float(np.sqrt(squared.sum() / counts.sum())) if counts.any() else float("nan")
    return Jitter(1e3 * rms_m, counts.sum(0))


def _windows(points: np.ndarray, half: int) -> np.ndarray:
    """(F, 15, 3, 2 half + 1) the frames around each frame; NaN beyond the ends."""
    if len(points) == 0:
        return np.empty((0, *points.shape[1:], 2 * half + 1))
    padded = np.pad(points, ((half, half), (0, 0), (0, 0)), constant_values=np.nan)
    return np.lib.stride_tricks.sliding_window_view(padded, 2 * half + 1, axis=0)


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


# several persons ------------------------------------------------------------------------------------------------------


LOST, SURE = str(Tracking.LOST), str(Tracking.TRACKING)
FIRST_S = 1.0
GHOST_M = 0.5  # a track that is farther from every truth, mean of its points, follows nobody
SWITCHED_FOR_S = 0.1  # so long another truth is nearer before it counts: in a hug two persons share a place


@dataclass(frozen=True, eq=False)
class Identities:
    """Which tracks follow which truth.

    numbers : of each truth, the persons as the tracker numbers them whose tracks belong to it, the first one first.
    switches : of each truth, how often a track of it went to another truth; and one for each further number; None where
    no track belongs to it. ghosts : persons of the tracker that belong to nobody. ghost_frames : frames in which some
    track that is not doubtful is with nobody.
    """

    numbers: tuple[tuple[int, ...], ...]
    switches: tuple[int | None, ...]
    ghosts: tuple[int, ...]
    ghost_frames: int


@dataclass(frozen=True, eq=False)
class PersonScores:
    """One truth and the tracks that follow it.

    frames : of the truth. numbers, switches : as in :class:`Identities`.
    time_to_track_s : of the first track, NaN without one. scores : of the first track, None without one.
    """

    frames: int
    numbers: tuple[int, ...]
    switches: int | None
    time_to_track_s: float
    scores: Scores | None

    def figures(self) -> dict[str, Any]:
        """Name to number, for a line of JSON; None where nothing is known."""
        scores = self.scores
        return {
            "numbers": list(self.numbers),
            "frames": self.frames,
            "tracked": 0 if scores is None else scores.tracked,
            **{name: None if scores is None else number(scores.overall[name]) for name in OVERALL},
            "time_to_track_s": number(self.time_to_track_s, 3),
            "identity_switches": self.switches,
        }


@dataclass(frozen=True, eq=False)
class PeopleScores:
    """Every person's scores, in the order of the truths."""

    persons: tuple[PersonScores, ...]
    who: Identities

    def figures(self, thesis: PeopleScores | None = None) -> dict[str, Any]:
        """Name to number, for a line of JSON: one record a person, and the mean of each figure over those who have it.

        ``thesis`` : the scores of the thesis's method on the same hulls.
        """
        records = [person.figures() for person in self.persons]
        if thesis is not None:
            for record, other in zip(records, thesis.persons, strict=True):
                record["thesis_mean_mm"] = other.figures()["mean_mm"]
        whole = {name: _mean([record[name] for record in records]) for name in records[0] if name != "numbers"}
        return {**whole, "persons": records, "ghosts": list(self.who.ghosts), "ghost_frames": self.who.ghost_frames}


def score_people(
    tracks: Mapping[int, Track], truths: Sequence[Truth], fps: float, visibility: RigVisibility | None = None
) -> PeopleScores:
    """Score the tracks of persons 1, 2, ... against the truths of a session of ``fps`` frames a second.

    Where a track says that it has lost its person it is not looked at: that person may have left. With ``visibility``
    errors count of those points alone that the rig shows.
    """
    who, persons = identify(tracks, truths, fps), []
    for truth, numbers, switches in zip(truths, who.numbers, who.switches, strict=True):
        first = _believed(tracks[numbers[0]]) if numbers else Track.of_states([])
        seen = truth if visibility is None else shown(truth, visibility)
        scores = score(first, seen) if np.isin(truth.frames, first.frames).any() else None
        persons.append(PersonScores(len(truth.frames), numbers, switches, time_to_track_s(first, fps), scores))
    return PeopleScores(tuple(persons), who)


def identify(tracks: Mapping[int, Track], truths: Sequence[Truth], fps: float) -> Identities:
    """Find whose tracks the persons 1, 2, ... are, and how often they change; as :func:`score_people`."""
    tracks = {person: _believed(track) for person, track in sorted(tracks.items())}
    distances = {person: distances_m(track, truths) for person, track in tracks.items() if len(track)}
    owners = assign(distances, fps)
    patience = max(round(SWITCHED_FOR_S * fps), 1)
    numbers = [tuple(person for person, owner in owners.items() if owner == place) for place in range(len(truths))]
    astray = {
        int(frame)
        for person, rows in distances.items()
        for frame, state, row in zip(tracks[person].frames, tracks[person].states, rows, strict=True)
        if state == SURE and np.isfinite(row).any() and np.nanmin(row) > GHOST_M
    }
    return Identities(
        tuple(numbers),
        tuple(len(own) - 1 + sum(changes(distances[n], patience) for n in own) if own else None for own in numbers),
        tuple(person for person, owner in owners.items() if owner is None),
        len(astray),
    )


def _believed(track: Track) -> Track:
    return track.chosen(track.states != LOST)


def shown(truth: Truth, visibility: RigVisibility) -> Truth:
    """Return the truth without the points that lie where hulls show nothing."""
    points = truth.points_world.copy()
    flat = points.reshape(-1, 3)
    known = np.flatnonzero(np.isfinite(flat).all(axis=1))
    flat[known[~visibility.shows(flat[known])]] = np.nan
    return replace(truth, points_world=points)


def distances_m(track: Track, truths: Sequence[Truth]) -> np.ndarray:
    """Return (F, truths) the mean distance of a track's points from each truth's, m; NaN where unknown."""
    columns = []
    for truth in truths:
        apart = np.linalg.norm(truth.comparable(track.points_world) - truth.points_at(track.frames), axis=2)
        columns.append(mean_of_known(apart, 1))
    return np.array(columns).T.reshape(-1, len(truths))


def assign(distances: Mapping[int, np.ndarray], fps: float) -> dict[int, int | None]:
    """Return the truth that each person's track belongs to by its first second; None for one that is with nobody."""
    owners: dict[int, int | None] = {}
    for person, rows in distances.items():
        mean = np.nan_to_num(mean_of_known(rows[: max(round(FIRST_S * fps), 1)], 0), nan=np.inf)
        nearest = int(np.argmin(mean))
        owners[person] = nearest if mean[nearest] < GHOST_M else None
    return owners


def changes(rows: np.ndarray, patience: int) -> int:
    """Count how often the nearest truth of a track's rows (F, truths) changes, and stays so for some frames."""
    known = rows[np.isfinite(rows).any(axis=1)]
    if len(known) == 0:
        return 0
    nearest, current, since, count = np.nanargmin(known, axis=1), -1, 0, 0
    for truth in nearest:
        if current < 0 or truth == current:
            current, since = int(truth), 0
            continue
        since += 1
        if since >= patience:
            current, since, count = int(truth), 0, count + 1
    return count


def main_track(tracks: Mapping[int, Track], truths: Sequence[Truth], fps: float) -> Track:
    """Return the track of the person that the first truth is of; the first person's without several truths."""
    first = tracks[min(tracks)]
    if len(truths) < 2:
        return first
    of_first = identify(tracks, truths, fps).numbers[0]
    return tracks[of_first[0]] if of_first else first


def _mean(values: Sequence[float | None]) -> float | None:
    """Over those that are known; None of none."""
    known = [value for value in values if value is not None]
    return number(float(np.mean(known))) if known else None
