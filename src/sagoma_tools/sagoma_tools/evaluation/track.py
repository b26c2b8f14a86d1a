"""A track: the filtered body of a session, one row a frame set; read from a bag or collected in process; reasons of
missing ones."""

from __future__ import annotations

import math
import re
from collections import defaultdict
from collections.abc import Callable, Iterable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np
from diagnostic_msgs.msg import DiagnosticArray

from capture_rig.errors import InputError
from capture_rig.rig import load_rig
from capture_rig.session import Session, load_session
from capture_rig.video import Video, examine_video
from mocap_packets.fit import FIRST_PERSON, PART_NAMES
from mocap_packets.state import BodyState, Tracking
from sagoma_ros.messages import values_of
from stick_figure.skeleton import ANGLE_NAMES

from ..graph.topics import FIRST_BODY_ID, camera_topics
from ..recording.reader import SIDECAR_RIG, bag_persons, frame_tolerance_ns, read_messages, read_provenance, rig_in
from ..recording.recorded_motion import ANGLES, NO_STATE, POINTS, STATE, PersonRows, read_person_rows

if TYPE_CHECKING:  # bags are read without it
    from mocap_pipeline.pipeline import Step

T = TypeVar("T")


@dataclass(frozen=True, eq=False)
class Track:
    """The filtered body, in frame order.

    frames : (F,) 0-based video frame of each row.
    points_world : (F, 15, 3) metres, map frame; covariance : (F, 15, 3, 3) m^2.
    angles : (F, 18) rad.
    states : (F,) the tracker's state: "acquiring", "tracking", ...; empty where a frame has no row.
    parts : (F, 5) quality of each part of the body (``PART_NAMES``): "good", "doubtful", "lost"; empty where unknown.
    """

    frames: np.ndarray
    points_world: np.ndarray
    covariance: np.ndarray
    angles: np.ndarray
    states: np.ndarray
    parts: np.ndarray

    @classmethod
    def of_states(cls, rows: Sequence[tuple[int, BodyState]]) -> Track:
        """Build from frames and the filter's states at them; no rows make an empty track."""
        return cls._of(
            (frame, state.points_world, state.point_covariance, state.angles, str(state.tracking), state.parts)
            for frame, state in rows
        )

    @classmethod
    def of_rows(cls, rows: PersonRows, frame_of_stamp: Callable[[int], int]) -> Track:
        """Build from a person's messages in a bag, where it has points and angles; the last of each frame."""

        def by_frame(of_kind: dict[int, T]) -> dict[int, T]:
            return {frame_of_stamp(stamp): row for stamp, row in of_kind.items()}

        points, angles, states = by_frame(rows.points), by_frame(rows.angles), by_frame(rows.states)
        frames = sorted(set(points) & set(angles))
        return cls._of(
            (f, points[f].points_world, points[f].covariance, angles[f], *states.get(f, NO_STATE)) for f in frames
        )

    @classmethod
    def _of(cls, rows: Iterable[tuple]) -> Track:
        """Build from one tuple a frame, in the order of the fields."""
        columns = list(zip(*rows, strict=True)) or [()] * 6
        frames, points, covariance, angles, states, parts = columns
        return cls(
            np.array(frames, dtype=int),
            np.array(points, dtype=float).reshape(-1, 15, 3),
            np.array(covariance, dtype=float).reshape(-1, 15, 3, 3),
            np.array(angles, dtype=float).reshape(-1, len(ANGLE_NAMES)),
            np.array(states, dtype=str),
            np.array(parts, dtype=str).reshape(-1, len(PART_NAMES)),
        )

    def __len__(self) -> int:
        return len(self.frames)

    def between(self, first: int, end: int) -> Track:
        """Return the rows of frames first, first + 1, ... end - 1."""
        return self.chosen((self.frames >= first) & (self.frames < end))

    def chosen(self, rows: np.ndarray) -> Track:
        """Return some of the rows, by mask or index."""
        return Track(*(column[rows] for column in vars(self).values()))

    def at(self, frames: np.ndarray) -> Track:
        """Return the rows of the given frames, NaN (and no state) where the track has none."""
        row_of = {int(frame): row for row, frame in enumerate(self.frames)}
        rows = np.array([row_of.get(int(frame), -1) for frame in frames], dtype=int)

        def pick(values: np.ndarray) -> np.ndarray:
            absent = "" if values.dtype.kind == "U" else np.nan
            picked = values[rows] if len(values) else np.empty((len(rows), *values.shape[1:]), values.dtype)
            picked[rows < 0] = absent
            return picked

        return Track(np.asarray(frames), *(pick(column) for column in list(vars(self).values())[1:]))


def tracks_from_bag(
    bag: str | Path, frame_of_stamp: Callable[[int], int], *, may_be_empty: bool = False
) -> dict[int, Track]:
    """Read everybody's track from a bag, by the person's number; ``frame_of_stamp`` converts a stamp in ns into a frame
    number. The first person's is there, others' where they have any row.

    Raises InputError when the first person has none, unless it ``may_be_empty``.
    """
    rows = read_person_rows(bag, (POINTS, ANGLES, STATE))
    tracks = {FIRST_PERSON: Track.of_rows(rows[FIRST_BODY_ID], frame_of_stamp)}
    if not (len(tracks[FIRST_PERSON]) or may_be_empty):
        what, reasons = "holds no tracked body", reasons_of_bag(bag)
        if any(reasons):
            raise nobody_tracked(what, str(bag), reasons)
        remedy = f"Record /mocap/{POINTS}, /mocap/{ANGLES} while the graph tracks a person."
        raise InputError(what, where=str(bag), remedy=remedy)
    for body_id, person in bag_persons(bag).items():
        if person != FIRST_PERSON:
            tracks[person] = Track.of_rows(rows[body_id], frame_of_stamp)
    return {person: track for person, track in sorted(tracks.items()) if person == FIRST_PERSON or len(track)}


# the session that a bag recorded --------------------------------------------------------------------------------------


KEY = "play"  # of the clock in the bag's provenance
SUFFIXES = (".mcap", ".db3")


@dataclass(frozen=True)
class SessionClock:
    """One playback of a session: frame k < ``frames`` was visible ``k / fps`` seconds after ``epoch_ns``.

    ``exposed`` : cameras exposed at any time while the frame was visible; otherwise stamps are those of the frames.
    """

    epoch_ns: int
    frames: int
    fps: float
    exposed: bool = False

    def frame_of(self, stamp_ns: int) -> int:
        """Return the number of the frame visible at a stamp; outside the playback it is negative or too large."""
        frame = (stamp_ns - self.epoch_ns) * 1e-9 * self.fps
        return math.floor(frame) if self.exposed else round(frame)

    def __contains__(self, stamp_ns: int) -> bool:
        return 0 <= self.frame_of(stamp_ns) < self.frames

    def provenance(self) -> dict[str, Any]:
        """Return the clock as plain data for the bag's provenance, which :func:`clock_of_bag` reads."""
        return {KEY: asdict(self)}


def clock_of_bag(bag: str | Path, session: Session) -> SessionClock:
    """Return the clock in the bag's provenance; otherwise frame 0 is the first silhouette's.

    A session of live cameras, without videos, lasts from the first silhouette to the last.
    """
    described = read_provenance(bag).get(KEY)
    if described is not None and session.videos:
        return SessionClock(**described)
    stamps = [stamp for seen in silhouette_stamps(bag, session).values() for stamp in seen]
    live_frames = round((max(stamps) - min(stamps)) * 1e-9 * session.fps) + 1
    return SessionClock(min(stamps), frame_count(session) if session.videos else live_frames, session.fps)


def silhouette_stamps(bag: str | Path, session: Session) -> dict[str, list[int]]:
    """Return the stamps of each camera's silhouettes in a bag, in order. Raises InputError when there are none."""
    cameras = {camera_topics(name)[1].name: name for name in session.rig.names}
    stamps: dict[str, list[int]] = {}
    for message in read_messages(bag, cameras.__contains__):
        stamps.setdefault(cameras[message.topic], []).append(message.stamp_ns)
    if not stamps:
        remedy = "Give a bag of this session; if it is, read the cameras' logs beside it."
        raise InputError("holds no silhouette of the session's cameras", where=str(bag), remedy=remedy)
    return {name: sorted(values) for name, values in stamps.items()}


def frame_count(session: Session) -> int:
    """Return the frames of the session's shortest video, by the headers, or by reading it where they are missing."""
    counts = []
    for path in session.videos.values():
        with Video(path) as video:
            counts.append(video.frame_count)
        if not counts[-1]:
            counts[-1] = examine_video(path).frames
    return min(counts)


def is_bag(path: Path) -> bool:
    """Return whether a path is a bag's folder or file."""
    return path.suffix in SUFFIXES or (path / "metadata.yaml").is_file() or any(path.glob("*.mcap"))


def session_of_bag(bag: Path) -> Session:
    """Return the session named in the bag's provenance; of live cameras, the bag's own rig without footage or truth.

    Raises InputError when the bag has neither.
    """
    named = read_provenance(bag).get("session")
    if named:
        return load_session(named)
    if (rig_file := rig_in(bag)) is None:
        what = f"says neither of which session it is nor, in {SIDECAR_RIG}, by which cameras"
        raise InputError(what, where=str(bag), remedy=f"Run sagoma evaluate SESSION --bag {bag}.")
    fps = 0.5e9 / frame_tolerance_ns(bag)
    return Session(bag, load_rig(rig_file), fps, videos={}, backgrounds={}, masks={}, truth=None)


# why nobody is tracked -----------------------------------------------------------------------------------------------


FIT_TOPIC = "/icp/fit"
SHOWN = 3
VARYING = re.compile(r": step .*|(?<![\w.])[+-]?\d+(?:\.\d+)?")
"""Parts of a reason that may differ between two sets with the same one: the way to step, and numbers outside names."""
REMEDY = "What to do about each: docs/how-to/tracking.md, 'Why it refuses'; of the rig: sagoma doctor --rig."


def reasons_of_step(step: Step) -> tuple[str, ...]:
    """Return why the fits of one set are doubtful or missing."""
    return tuple(person.fit.reason for person in step.people if person.fit.state != Tracking.TRACKING)


def reasons_of_bag(bag: str | Path, wanted: Callable[[int], bool] = lambda stamp_ns: True) -> list[tuple[str, ...]]:
    """Return the reasons of each frame set of a wanted stamp in a bag; none of a bag without fits."""
    found = []
    for message in read_messages(bag, FIT_TOPIC.__eq__):
        if wanted(message.stamp_ns):
            statuses = message.decode(DiagnosticArray).status
            troubled = [s for s in statuses if values_of(s).get(STATE) != Tracking.TRACKING]
            found.append(tuple(status.message for status in troubled))
    return found


def rank_reasons(sets: Sequence[Sequence[str]]) -> list[tuple[str, int]]:
    """Return each reason, with the numbers of the middle one of its sets, and the number of sets; the most frequent
    first."""
    texts: dict[str, list[str]] = defaultdict(list)
    for reasons in sets:
        for kind, reason in {VARYING.sub("#", reason): reason for reason in reasons}.items():
            texts[kind].append(reason)
    return [(same[len(same) // 2], len(same)) for same in sorted(texts.values(), key=len, reverse=True)]


def explain(sets: Sequence[Sequence[str]]) -> str:
    """Return the most frequent reasons as one clause."""
    said = ", ".join(f'"{text}" in {count}' for text, count in rank_reasons(sets)[:SHOWN])
    return f"of {len(sets)} frame sets the tracker said {said or 'nothing'}"


def nobody_tracked(what: str, where: str, sets: Sequence[Sequence[str]]) -> InputError:
    """Return the error of a session or bag in which nobody was tracked."""
    return InputError(f"{what}: {explain(sets)}", where=where, remedy=REMEDY)
