"""The takes in a folder: bags with what is known of each, and names for new ones that overwrite nothing."""

from __future__ import annotations

import re
import time
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from capture_rig.errors import InputError

from ..recording.reader import open_bag

NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9 _.-]{0,80}")
"""Of a take: a folder's name on every system, and none that leads out of the folder of takes."""


@dataclass(frozen=True)
class Take:
    """One bag. began_ns : of its first message; counts : messages by topic; problem : why it cannot be read, if so."""

    path: Path
    began_ns: int = 0
    seconds: float = 0.0
    counts: Mapping[str, int] | None = None
    problem: str = ""

    @property
    def name(self) -> str:
        """The folder's name."""
        return self.path.name


def takes_in(folder: Path) -> list[Take]:
    """Return the takes of a folder, the newest first."""
    found = [describe(path) for path in folder.iterdir() if _is_bag(path)] if folder.is_dir() else []
    return sorted(found, key=lambda take: (-take.began_ns, take.name))


def describe(path: Path) -> Take:
    """Read length and counts of a take from its index."""
    try:
        with open_bag(path) as reader:
            counts = {connection.topic: connection.msgcount for connection in reader.connections}
            empty = reader.message_count == 0
            return Take(path, 0 if empty else reader.start_time, 0.0 if empty else reader.duration / 1e9, counts)
    except InputError as error:
        return Take(path, problem=str(error))


def new_take(folder: Path, name: str) -> Path:
    """Return the folder of a new take: by this name, or by date and time without one.

    Raises InputError for a name that is none, or that a take has already.
    """
    name = name.strip() or time.strftime("take-%Y%m%d-%H%M%S")
    if not NAME.fullmatch(name):
        remedy = "Use up to 80 letters, digits, blanks, points, dashes and underscores, a letter or digit first."
        raise InputError(f"'{name}' is no name for a take", where="name", remedy=remedy)
    path = folder / name
    if path.exists():
        raise InputError(f"there is a take '{name}' already", where=str(folder), remedy="Choose another name.")
    folder.mkdir(parents=True, exist_ok=True)
    return path


def _is_bag(path: Path) -> bool:
    return (
        path.is_dir()
        and not path.name.startswith(".")
        and ((path / "metadata.yaml").exists() or any(path.glob("*.mcap")))
    )
