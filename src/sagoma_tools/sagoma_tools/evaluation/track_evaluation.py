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


def jitter(track: Track, fps: float, truth: Truth | None = None) -> tuple[float, np.ndarray]:
    """Return the rms, mm, of the high-pass-filtered motion of the points at rest, and the count of each (15,).

    With a centred moving average of :data:`WINDOW_S` (2 h + 1 frames), a point's jitter at frame k is
    ``x_k - mean(x_{k-h} .. x_{k+h})``. It counts at frame k when the point rests there: when the truth's point (without
    a truth, the moving average of the track's own) stays within :data:`STILL_M` of its place at k from k - h to k + h.
    Frames that the track lacks, and truth that is unknown, count nowhere.

    The rms is over all points and frames that count, three axes together: white noise of sd s an axis gives
    s sqrt(3) sqrt(1 - 1 / (2 h + 1)), NaN where no point ever rests.
    """
    if not len(track):
        return float("nan"), np.zeros(15, int)
    frames = np.arange(track.frames.min(), track.frames.max() + 1)
    points = track.at(frames).points_world
    half = max(1, round(0.5 * WINDOW_S * fps))
    smooth = _windows(points, half).mean(-1)
    reference = smooth if truth is None else truth.points_at(frames)
    away = np.linalg.norm(_windows(reference, half) - reference[..., None], axis=2)
    counts = (away.max(-1) < STILL_M) & np.isfinite(smooth).all(-1)
    return 1e3 * float(np.sqrt(mean_of_known(((points - smooth) ** 2).sum(-1)[counts]))), counts.sum(0)


def _windows(points: np.ndarray, half: int) -> np.ndarray:
    """(F, 15, 3, 2 half + 1) the frames around each frame; NaN beyond the ends."""
    padded = np.pad(points, ((half, half), (0, 0), (0, 0)), constant_values=np.nan)
    return np.lib.stride_tricks.sliding_window_view(padded, 2 * half + 1, axis=0)


TRACKING, LOST = str(Tracking.TRACKING), str(Tracking.LOST)


@dataclass(frozen=True, eq=False)
class TrackEvaluation:
    """The evaluation of one track.

    frames : frames of footage, fps of them a second.
    states : the tracker's state -> number of frames.
    time_to_track_s : from the first frame to the first in state "tracking", NaN when there is none.
    jitter_mm, at_rest : as :func:`jitter` measures it.
    scores : against the truth, where the session has one. thesis : those of the thesis's method on the same hulls.
    switches : identity switches of the person; None without a truth, or without a track.
    """

    session: Session
    frames: int
    track: Track
    states: dict[str, int]
    time_to_track_s: float
    jitter_mm: float
    at_rest: np.ndarray
    scores: Scores | None
    thesis: Scores | None = None
    switches: int | None = None

    def figures(self) -> dict[str, object]:
        """Name to number, for a line of JSON; without a truth, those that need none."""
        return {
            **{"frames": self.frames, "tracked": len(self.track), "flagged_of_bad": None, "false_alarms": None},
            **(self.scores.figures() if self.scores is not None else {}),
            **({"thesis_mean_mm": number(self.thesis.mean_mm)} if self.thesis is not None else {}),
            "identity_switches": self.switches,
            "time_to_track_s": number(self.time_to_track_s, 3),
            "jitter_mm": number(self.jitter_mm, 2),
            "states": self.states,
        }


def evaluate_track(
    session: Session, frames: int, track: Track, thesis: Track | None = None, switches: int | None = None
) -> TrackEvaluation:
    """Score a session's track, and the one of the thesis's method if there is one; ``switches`` : of its person."""
    truth = session.truth
    states, found_s = dict(Counter(track.states.tolist())), time_to_track_s(track, session.fps)
    jitters = jitter(track, session.fps, truth)
    scores = None if truth is None else score(track, truth)
    of_thesis = None if truth is None or thesis is None or not len(thesis) else score(thesis, truth)
    return TrackEvaluation(session, frames, track, states, found_s, *jitters, scores, of_thesis, switches)


def time_to_track_s(track: Track, fps: float) -> float:
    """Seconds from frame 0 to the first frame in state "tracking"; NaN when there is none."""
    tracked = track.frames[track.states == TRACKING]
    return float(np.min(tracked)) / fps if len(tracked) else float("nan")


# several persons ------------------------------------------------------------------------------------------------------


FIRST_S = 1.0
GHOST_M = 0.5  # a track that is farther from every truth, mean of its points, is a ghost
SWITCHED_FOR_S = 0.1  # that another truth is nearer before it counts: in a hug two persons share a place


@dataclass(frozen=True, eq=False)
class Identities:
    """Assignment of tracks to truths.

    numbers : for each truth, the tracker's numbers of the persons whose tracks belong to it, the first one first.
    switches : for each truth, changes of its tracks to another truth, and one for each further number; None without a
    track. ghosts : persons of the tracker without a truth. ghost_frames : frames in which some track that is not
    doubtful is near no truth.
    """

    numbers: tuple[tuple[int, ...], ...]
    switches: tuple[int | None, ...]
    ghosts: tuple[int, ...]
    ghost_frames: int


@dataclass(frozen=True, eq=False)
class PeopleScores:
    """The truths, the tracks assigned to them, and for each the scores of its first track (None without one) and the
    time until that tracks, s."""

    truths: Sequence[Truth]
    who: Identities
    scores: tuple[Scores | None, ...]
    times_s: tuple[float, ...]

    def figures(self, thesis: PeopleScores | None = None) -> dict[str, Any]:
        """Name to number, for a line of JSON: one record a person, and the mean of each figure over those who have it.

        ``thesis`` : the scores of the thesis's method on the same hulls.
        """
        records: list[dict[str, Any]] = [
            {
                "numbers": list(numbers),
                "frames": len(truth.frames),
                "tracked": 0 if scores is None else scores.tracked,
                **{name: None if scores is None else number(scores.overall[name]) for name in OVERALL},
                "time_to_track_s": number(time_s, 3),
                "identity_switches": switches,
            }
            for truth, numbers, switches, scores, time_s in zip(
                self.truths, self.who.numbers, self.who.switches, self.scores, self.times_s, strict=True
            )
        ]
        for record, other in zip(records, thesis.scores, strict=True) if thesis is not None else ():
            record["thesis_mean_mm"] = None if other is None else number(other.mean_mm)
        known = {name: [r[name] for r in records if r[name] is not None] for name in records[0] if name != "numbers"}
        whole = {name: number(float(np.mean(values))) if values else None for name, values in known.items()}
        return {**whole, "persons": records, "ghosts": list(self.who.ghosts), "ghost_frames": self.who.ghost_frames}


def score_people(
    tracks: Mapping[int, Track], truths: Sequence[Truth], fps: float, visibility: RigVisibility | None = None
) -> PeopleScores:
    """Score the tracks of persons 1, 2, ... against the truths of a session of ``fps`` frames a second.

    Frames in which a track is lost do not count: its person may have left. With ``visibility`` only errors of points
    that the rig sees count.
    """
    who = identify(tracks, truths, fps)
    firsts = [_believed(tracks[numbers[0]]) if numbers else Track.of_states([]) for numbers in who.numbers]
    scores = tuple(
        score(first, truth if visibility is None else shown(truth, visibility))
        if np.isin(truth.frames, first.frames).any()
        else None
        for truth, first in zip(truths, firsts, strict=True)
    )
    return PeopleScores(truths, who, scores, tuple(time_to_track_s(first, fps) for first in firsts))


def identify(tracks: Mapping[int, Track], truths: Sequence[Truth], fps: float) -> Identities:
    """Assign the tracks of persons 1, 2, ... to truths, and count switches; arguments as of :func:`score_people`."""
    tracks = {person: _believed(track) for person, track in sorted(tracks.items())}
    distances = {person: distances_m(track, truths) for person, track in tracks.items() if len(track)}
    owners = assign(distances, fps)
    patience = max(round(SWITCHED_FOR_S * fps), 1)
    numbers = [tuple(person for person, owner in owners.items() if owner == place) for place in range(len(truths))]
    astray = {
        int(frame)
        for person, rows in distances.items()
        for frame, state, row in zip(tracks[person].frames, tracks[person].states, rows, strict=True)
        if state == TRACKING and np.isfinite(row).any() and np.nanmin(row) > GHOST_M
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
    """Return the truth that each person's track belongs to by its first second; None for a ghost."""
    owners: dict[int, int | None] = {}
    for person, rows in distances.items():
        mean = np.nan_to_num(mean_of_known(rows[: max(round(FIRST_S * fps), 1)], 0), nan=np.inf)
        nearest = int(np.argmin(mean))
        owners[person] = nearest if mean[nearest] < GHOST_M else None
    return owners


def changes(rows: np.ndarray, patience: int) -> int:
    """Count how often the nearest truth of a track's rows (F, truths) changes, and stays so for some frames."""
    current, since, count = -1, 0, 0
    for truth in np.nanargmin(rows[np.isfinite(rows).any(axis=1)], axis=1).tolist():
        since = since + 1 if truth != current >= 0 else 0
        if current < 0 or since >= patience:
            current, since, count = truth, 0, count + (current >= 0)
    return count


def main_track(tracks: Mapping[int, Track], truths: Sequence[Truth], fps: float) -> Track:
    """Return the track of the person that the first truth is of; the first person's without several truths."""
    first = tracks[min(tracks)]
    if len(truths) < 2:
        return first
    of_first = identify(tracks, truths, fps).numbers[0]
    return tracks[of_first[0]] if of_first else first
