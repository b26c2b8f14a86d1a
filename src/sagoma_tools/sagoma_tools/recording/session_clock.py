"""Relates a bag to the session that it recorded: which session, and which of its frames was visible at a stamp."""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from capture_rig.errors import InputError
from capture_rig.rig import load_rig
from capture_rig.session import Session, load_session
from capture_rig.video import Video
from capture_rig.video_findings import examine_video

from ..graph.topics import camera_topics
from .reader import SIDECAR_RIG, frame_tolerance_ns, read_messages, read_provenance

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
    """The stamps of each camera's silhouettes in a bag, in order. Raises InputError when there is none at all."""
    cameras = {camera_topics(name)[1].name: name for name in session.rig.names}
    stamps: dict[str, list[int]] = {}
    for message in read_messages(bag, cameras.__contains__):
        stamps.setdefault(cameras[message.topic], []).append(message.stamp_ns)
    if not stamps:
        remedy = "Give a bag of this session; if it is, read the cameras' logs beside it."
        raise InputError("holds no silhouette of the session's cameras", where=str(bag), remedy=remedy)
    return {name: sorted(values) for name, values in stamps.items()}


def frame_count(session: Session) -> int:
    """Frames of the session's shortest video, by the headers; of one whose header does not tell, as many as come."""
    counts = []
    for path in session.videos.values():
        with Video(path) as video:
            counts.append(video.frame_count)
        if not counts[-1]:
            counts[-1] = examine_video(path).passed.frames
    return min(counts)


def is_bag(path: Path) -> bool:
    """Return whether a path is a bag's folder or file."""
    if path.is_file():
        return path.suffix in SUFFIXES
    return (path / "metadata.yaml").is_file() or any(found for suffix in SUFFIXES for found in path.glob("*" + suffix))


def session_of_bag(bag: Path) -> Session:
    """Return the session named in the bag's provenance; of live cameras, the bag's own rig without footage or truth.

    Raises InputError when the bag has neither.
    """
    named = read_provenance(bag).get("session")
    if named:
        return load_session(named)
    if not (bag / SIDECAR_RIG).is_file():
        what = f"says neither of which session it is nor, in {SIDECAR_RIG}, by which cameras"
        raise InputError(what, where=str(bag), remedy=f"Run sagoma evaluate SESSION --bag {bag}.")
    fps = 0.5e9 / frame_tolerance_ns(bag)
    return Session(bag, load_rig(bag / SIDECAR_RIG), fps, videos={}, backgrounds={}, masks={}, truth=None)
