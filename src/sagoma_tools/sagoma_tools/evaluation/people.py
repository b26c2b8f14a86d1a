"""Tracks of several persons against several truths: who is who, and whether it stays so.

A track belongs to the truth that it is nearest to in its first second. From then on it should stay nearest to it: every
change counts as an identity switch, and so does every further number that a person is given.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from capture_rig.session import Truth
from capture_rig.visibility import RigVisibility
from mocap_packets.state import Tracking

from .scores import OVERALL, Scores, number, score
from .track import Track

LOST, SURE = str(Tracking.LOST), str(Tracking.TRACKING)
FIRST_S = 1.0
GHOST_M = 0.5  # a track that is farther from every truth, mean of its points, follows nobody
SWITCHED_FOR_S = 0.1  # so long another truth is nearer before it counts: in a hug two persons share a place


@dataclass(frozen=True, eq=False)
class PersonScores:
    """One truth and the tracks that follow it.

    truth : its place among the session's truths. numbers : persons as the tracker numbers them whose tracks belong to
    it, the first one first. switches : how often the first track left it for another truth, and came back; and one for
    each further number. scores : of the first track, None without one.
    """

    truth: int
    numbers: tuple[int, ...]
    switches: int
    scores: Scores | None

    def figures(self) -> dict[str, object]:
        """Name to number, for a line of JSON."""
        whole: dict[str, object] = {"numbers": list(self.numbers), "identity_switches": self.switches}
        if self.scores is not None:
            whole |= {"frames": self.scores.frames, "tracked": self.scores.tracked}
            whole |= {name: number(getattr(self.scores, name)) for name in OVERALL}
        return whole


@dataclass(frozen=True, eq=False)
class PeopleScores:
    """Every person's scores, in the order of the truths.

    ghosts : persons of the tracker that belong to nobody. ghost_frames : frames in which some track that is not
    doubtful is with nobody.
    """

    persons: tuple[PersonScores, ...]
    ghosts: tuple[int, ...]
    ghost_frames: int

    @property
    def switches(self) -> int:
        """Identity switches of all persons."""
        return sum(person.switches for person in self.persons)

    def figures(self) -> dict[str, object]:
        """Name to number, for a line of JSON: one record a person, and the mean of those that have scores."""
        scored = [person.scores for person in self.persons if person.scores is not None]
        means = {name: number(float(np.mean([getattr(one, name) for one in scored]))) for name in OVERALL if scored}
        return {
            **means,
            "persons": [person.figures() for person in self.persons],
            "identity_switches": self.switches,
            "ghosts": list(self.ghosts),
            "ghost_frames": self.ghost_frames,
        }


def score_people(
    tracks: Mapping[int, Track], truths: Sequence[Truth], fps: float, visibility: RigVisibility | None = None
) -> PeopleScores:
    """Score the tracks of persons 1, 2, ... against the truths of a session of ``fps`` frames a second.

    Where a track says that it has lost its person it is not looked at: that person may have left. With ``visibility``
    errors count of those points alone that the rig shows.
    """
    tracks = {person: track.chosen(track.states != LOST) for person, track in sorted(tracks.items())}
    distances = {person: distances_m(track, truths) for person, track in tracks.items() if len(track)}
    owners = assign(distances, fps)
    patience = max(round(SWITCHED_FOR_S * fps), 1)
    persons = []
    for place, truth in enumerate(truths):
        numbers = tuple(person for person, owner in owners.items() if owner == place)
        switches = max(len(numbers) - 1, 0)
        switches += sum(changes(distances[person], patience) for person in numbers)
        first = tracks[numbers[0]] if numbers else None
        persons.append(PersonScores(place, numbers, switches, _scores(first, truth, visibility)))
    ghosts = tuple(person for person, owner in owners.items() if owner is None)
    astray = {
        int(frame)
        for person, rows in distances.items()
        for frame, state, row in zip(tracks[person].frames, tracks[person].states, rows, strict=True)
        if state == SURE and np.isfinite(row).any() and np.nanmin(row) > GHOST_M
    }
    return PeopleScores(tuple(persons), ghosts, len(astray))


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
        row_of = {int(frame): row for row, frame in enumerate(truth.frames)}
        rows = np.array([row_of.get(int(frame), -1) for frame in track.frames], dtype=int)
        apart = np.linalg.norm(truth.comparable(track.points_world) - truth.points_world[rows], axis=2)
        known = np.isfinite(apart) & (rows >= 0)[:, None]
        count = known.sum(axis=1)
        mean = np.where(known, apart, 0.0).sum(axis=1) / np.maximum(count, 1)
        columns.append(np.where(count > 0, mean, np.nan))
    return np.array(columns).T.reshape(-1, len(truths))


def assign(distances: Mapping[int, np.ndarray], fps: float) -> dict[int, int | None]:
    """Return the truth that each person's track belongs to by its first second; None for one that is with nobody."""
    owners: dict[int, int | None] = {}
    for person, rows in distances.items():
        first = rows[: max(round(FIRST_S * fps), 1)]
        known = np.isfinite(first)
        mean = np.where(known, first, 0.0).sum(axis=0) / np.maximum(known.sum(axis=0), 1)
        mean[~known.any(axis=0)] = np.inf
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
    of_first = score_people(tracks, truths, fps).persons[0].numbers
    return tracks[of_first[0]] if of_first else first


def _scores(track: Track | None, truth: Truth, visibility: RigVisibility | None) -> Scores | None:
    truth = truth if visibility is None else shown(truth, visibility)
    if track is None or not np.isin(truth.frames, track.frames).any():
        return None
    return score(track, truth)
