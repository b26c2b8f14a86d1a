"""When which frame of a session was seen: the clock that relates a bag's stamps to the session's truth."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import cv2
import yaml

from capture_rig.errors import InputError
from capture_rig.rig import load_rig
from capture_rig.session import Session, load_session

from ..graph.topics import camera_topics
from .reader import SIDECAR_PROVENANCE, SIDECAR_RIG, frame_tolerance_ns, read_messages

KEY = "play"


@dataclass(frozen=True)
class SessionClock:
    """One playing of a session: frame k was seen ``k / fps`` seconds after ``epoch_ns``, for k < ``frames``.

    ``exposed`` : cameras looked at it, at any time while the frame was seen; otherwise stamps are those of the frames.
    """

    epoch_ns: int
    frames: int
    fps: float
    exposed: bool = False

    def frame_of(self, stamp_ns: int) -> int:
        """The number of the frame that was seen at a stamp; beyond the playing it is negative, or too large."""
        frame = (stamp_ns - self.epoch_ns) * 1e-9 * self.fps
        return math.floor(frame) if self.exposed else round(frame)

    def __contains__(self, stamp_ns: int) -> bool:
        return 0 <= self.frame_of(stamp_ns) < self.frames

    def provenance(self) -> dict[str, Any]:
        """For the bag's description, where :func:`clock_of_bag` finds it."""
        return {KEY: asdict(self)}


def clock_of_bag(bag: str | Path, session: Session) -> SessionClock:
    """How the session was played into a bag: as the bag says, else its first silhouette is the session's frame 0."""
    sidecar = Path(bag) / SIDECAR_PROVENANCE
    described = yaml.safe_load(sidecar.read_text()) if sidecar.is_file() else None
    if isinstance(described, Mapping) and KEY in described:
        return SessionClock(**described[KEY])
    first_ns = min(stamps[0] for stamps in silhouette_stamps(bag, session).values())
    return SessionClock(first_ns, frame_count(session), session.fps)


def silhouette_stamps(bag: str | Path, session: Session) -> dict[str, list[int]]:
    """The stamps of each camera's silhouettes in a bag, in order; InputError when there is none at all."""
    cameras = {camera_topics(name)[1].name: name for name in session.rig.names}
    stamps: dict[str, list[int]] = {}
    for message in read_messages(bag, cameras.__contains__):
        stamps.setdefault(cameras[message.topic], []).append(message.stamp_ns)
    if not stamps:
        raise InputError(
            "holds no silhouette of the session's cameras",
            where=str(bag),
            remedy="Give a bag of this session; if it is, read the cameras' logs beside it.",
        )
    return {name: sorted(values) for name, values in stamps.items()}


def frame_count(session: Session) -> int:
    """Frames of the session's shortest video."""
    return min(int(cv2.VideoCapture(str(path)).get(cv2.CAP_PROP_FRAME_COUNT)) for path in session.videos.values())


# --- Which session a bag is a recording of, or what can be made of one that was recorded from live cameras.

SUFFIXES = (".mcap", ".db3")


def is_bag(path: Path) -> bool:
    """Whether a path is a bag's folder or file."""
    if path.is_file():
        return path.suffix in SUFFIXES
    return (path / "metadata.yaml").is_file() or any(found for suffix in SUFFIXES for found in path.glob("*" + suffix))


def session_of_bag(bag: Path) -> Session:
    """The session that the bag says it was recorded on; of live cameras, the bag's own rig without footage or truth."""
    sidecar = bag / SIDECAR_PROVENANCE
    description = yaml.safe_load(sidecar.read_text()) if sidecar.is_file() else None
    named = description.get("session") if isinstance(description, Mapping) else None
    if named:
        return load_session(named)
    if not (bag / SIDECAR_RIG).is_file():
        raise InputError(
            f"says neither of which session it is nor, in {SIDECAR_RIG}, by which cameras",
            where=str(bag),
            remedy=f"Run sagoma evaluate SESSION --bag {bag}.",
        )
    fps = 0.5e9 / frame_tolerance_ns(bag)
    return Session(bag, load_rig(bag / SIDECAR_RIG), fps, videos={}, backgrounds={}, masks={}, truth=None)


def clock_of(bag: str, session: Session) -> SessionClock:
    """When which frame was seen; of live cameras, frame 0 is the first silhouette's."""
    if session.videos:
        return clock_of_bag(bag, session)
    stamps = [stamp for seen in silhouette_stamps(bag, session).values() for stamp in seen]
    return SessionClock(min(stamps), round((max(stamps) - min(stamps)) * 1e-9 * session.fps) + 1, session.fps)
