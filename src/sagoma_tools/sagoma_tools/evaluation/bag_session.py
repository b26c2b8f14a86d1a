"""Which session a bag is a recording of, or what can be made of one that was recorded from live cameras."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import yaml

from capture_rig.errors import InputError
from capture_rig.rig import load_rig
from capture_rig.session import Session, load_session

from ..bags import SIDECAR_PROVENANCE, SIDECAR_RIG, frame_tolerance_ns
from ..playing import Play, play_of_bag, silhouette_stamps

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


def play_of(bag: str, session: Session) -> Play:
    """When which frame was seen; of live cameras, frame 0 is the first silhouette's."""
    if session.videos:
        return play_of_bag(bag, session)
    stamps = [stamp for seen in silhouette_stamps(bag, session).values() for stamp in seen]
    return Play(min(stamps), round((max(stamps) - min(stamps)) * 1e-9 * session.fps) + 1, session.fps)
