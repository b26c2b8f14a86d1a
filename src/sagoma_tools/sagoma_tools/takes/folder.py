"""A folder of takes: list, name, rename, trim, delete to a bin and bring back; nothing recorded is overwritten.

A take is changed by one rename of its folder, so that it is always whole, under one name or the other. A trimmed part
holds whole frame sets by their stamps, and other messages by their log times.
"""

from __future__ import annotations

import os
import re
import shutil
import tempfile
import time
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, field, replace
from functools import cache
from operator import index
from pathlib import Path
from typing import Any

from diagnostic_msgs.msg import DiagnosticStatus

from capture_rig.errors import InputError
from sagoma_ros.messages import values_of

from ..graph import PATIENCE_S
from ..graph.topics import DIAGNOSTICS_TOPIC, LATCHED_TOPICS, type_of
from ..recording.reader import BagMessage, open_bag, read_messages, read_provenance, rig_in
from ..recording.recorded_motion import STATE, kind_of
from ..recording.recorder import has_header
from ..recording.writer import BagWriter
from .measure import SIDECAR_TAKE, finish_take, measure, read_summary
from .take import Summary, Take, TakeState, check_name

TAKES = "output/takes"
"""The default folder of takes."""
BIN = ".bin"
BINNED = re.compile(r"(?P<name>.+)~(?P<when>\d{8}-\d{6}).*")
"""A deleted take: its name, when it was deleted, and the nanoseconds of that; no name has a tilde."""
SAME_DATE = "%Y%m%d-%H%M%S"


@dataclass(frozen=True)
class DeletedTake:
    """A take in the bin."""

    path: Path
    name: str
    when: str


@dataclass
class TakesFolder:
    """The takes in one folder; names are never paths, so that nothing outside of it is reached."""

    path: Path
    _seen: dict[Path, tuple[tuple, Take]] = field(default_factory=dict, repr=False)

    def takes(self) -> list[Take]:
        """Return all takes, the newest first; one of an unreadable bag holds the reason."""
        found: dict[Path, Take] = {}
        for path in self.path.iterdir() if self.path.is_dir() else ():
            with suppress(OSError):  # of a folder that may not be read
                if _is_bag(path):
                    found[path] = self._described(path)
        self._seen = {path: self._seen[path] for path in found}
        return sorted(found.values(), key=lambda take: (-take.began_ns, take.name))

    def find(self, name: str) -> Take:
        """Return a take. Raises InputError when there is none of this name."""
        path = self.path / name
        if name in ("", os.curdir, os.pardir) or path.name != name or not _is_bag(path):
            known = ", ".join(take.name for take in self.takes()[:10]) or "none"
            raise InputError(f"there is no take '{name[:100]}'", where=str(self.path), remedy=f"There are: {known}.")
        return self._described(path)

    def new_path(self, name: str) -> Path:
        """Return the folder of a new take: by this name, or by date and time without one.

        Raises InputError for an invalid name, or one that a take has already.
        """
        path = self._free(name if name.strip() else time.strftime(f"take-{SAME_DATE}"))
        self.path.mkdir(parents=True, exist_ok=True)
        return path

    def rename(self, name: str, new_name: str) -> Path:
        """Rename a take. Raises InputError for a bad or taken name, and while it is being recorded."""
        return self._settled(name).path.rename(self._free(new_name))

    def delete(self, name: str) -> DeletedTake:
        """Move a take into the bin."""
        take = self._settled(name)
        when = time.strftime(SAME_DATE)
        (self.path / BIN).mkdir(exist_ok=True)
        path = self.path / BIN / f"{take.name}~{when}-{time.time_ns() % 1_000_000_000:09d}"
        return DeletedTake(take.path.rename(path), take.name, when)

    def deleted(self) -> list[DeletedTake]:
        """Return the bin's takes, deleted last first."""
        names = [match for path in (self.path / BIN).glob("*") if (match := BINNED.fullmatch(path.name))]
        names.sort(key=lambda match: match[0].removeprefix(match["name"]), reverse=True)
        return [DeletedTake(self.path / BIN / match[0], match["name"], match["when"]) for match in names]

    def restore(self, name: str) -> Path:
        """Bring the take of this name that was deleted last back. Raises InputError."""
        for deleted in self.deleted():
            if name in (deleted.name, deleted.path.name):
                return deleted.path.rename(self._free(deleted.name))
        known = ", ".join(deleted.name for deleted in self.deleted()[:10]) or "nothing"
        raise InputError(f"'{name[:100]}' is not in the bin", where=str(self.path / BIN), remedy=f"There is: {known}.")

    def empty_bin(self) -> list[DeletedTake]:
        """Empty the bin for good; return its takes."""
        found = self.deleted()
        for deleted in found:
            if deleted.path.is_symlink():
                deleted.path.unlink()  # the link, not its target
            else:
                shutil.rmtree(deleted.path)
        return found

    def _free(self, name: str) -> Path:
        """Return the path of a new take. Raises InputError for an invalid name, or one that a take has already."""
        path = self.path / check_name(name)
        if os.path.lexists(path):
            raise InputError(
                f"there is a take '{path.name}' already", where=str(self.path), remedy="Choose another name."
            )
        return path

    def _settled(self, name: str) -> Take:
        """Return a take that is not being written."""
        take = self.find(name)
        if take.state is TakeState.UNFINISHED and time.time() - _newest_change_ns(take.path) / 1e9 < PATIENCE_S:
            remedy = f"Finish the recording; if its recorder was killed, wait for {PATIENCE_S:.0f} s."
            raise InputError(f"'{name}' is being recorded", where=str(self.path), remedy=remedy)
        return take

    def _described(self, path: Path) -> Take:
        """Describe a take, from a cache if nothing in it has changed."""
        changed = _signature(path)
        if path not in self._seen or self._seen[path][0] != changed:
            self._seen[path] = changed, describe(path)
        return self._seen[path][1]


def describe(path: Path) -> Take:
    """Describe a bag by its index, provenance and summary, even a damaged one; raises OSError alone."""
    take = Take(path, bytes=sum(file.stat().st_size for file in path.glob("*") if file.is_file()))
    if _is_bag(path) and not (path / "metadata.yaml").exists():
        what = "has no index: it is being recorded, or its recorder was killed"
        problem = InputError(what, where=str(path), remedy=f"Once nobody records it: `sagoma recover '{path}'`.")
        return replace(take, state=TakeState.UNFINISHED, problem=str(problem), began_ns=_newest_change_ns(path))
    try:
        with open_bag(path) as reader:
            topics = {connection.topic: index(connection.msgcount) for connection in reader.connections}
            if reader.message_count:
                take = replace(take, began_ns=reader.start_time, seconds=reader.duration / 1e9)
        provenance = read_provenance(path)
        return replace(
            take,
            topics=topics,
            software=str(provenance.get("software", {}).get("sagoma", "")),
            trimmed_from=provenance.get("trimmed_from"),
            summary=read_summary(path),
        )
    except Exception as error:  # a broken file may break its reader in any way, and one take must not hide the others
        what = f"cannot be read ({type(error).__name__}: {error})"
        other = InputError(what, where=str(path), remedy="Bring it back from a copy, or delete it.")
        return replace(take, state=TakeState.DAMAGED, problem=str(error if isinstance(error, InputError) else other))


def _is_bag(path: Path) -> bool:
    if path.name.startswith(".") or not path.is_dir():
        return False
    return (path / "metadata.yaml").exists() or any(path.glob("*.mcap"))


def _signature(path: Path) -> tuple:
    """What changes whenever a take does: its files' sizes and times."""
    names = ("metadata.yaml", SIDECAR_TAKE, "sagoma.yaml")
    files = [*(path / name for name in names if (path / name).exists()), *path.glob("*.mcap"), *path.glob("*.db3")]
    return tuple((file.name, file.stat().st_mtime_ns, file.stat().st_size) for file in files)


def _newest_change_ns(path: Path) -> int:
    return max((ns for _, ns, _ in _signature(path)), default=0)


# a part as a new take -------------------------------------------------------------------------------------------------


OF_A_CAMERA = re.compile(r"^/[^/]+/(silhouette/compressed|camera_info|preview/compressed|image_raw)$")
LATCHED = LATCHED_TOPICS | {"/tf_static", "/robot_description"}


def trim(
    takes: TakesFolder,
    name: str,
    new_name: str,
    from_s: float = 0.0,
    to_s: float | None = None,
    progress: Callable[[int], None] = lambda messages: None,
) -> Path:
    """Write the part of a take from one second to another (from its first frame set's stamp) as a new take.

    It is written beside, and gets its name when it is whole. Raises InputError for a part that holds no frame set, and
    for a name that is taken.
    """
    take = takes.find(name)
    if take.state is not TakeState.WHOLE:
        raise InputError(f"'{name}' cannot be trimmed: {take.problem}", where=str(take.path))
    target = takes.new_path(new_name)
    begins_ns, ends_ns = _part(take.summary or measure(take.path), from_s, to_s, str(take.path))
    with tempfile.TemporaryDirectory(prefix=".trim-", dir=takes.path) as workshop:
        beside = Path(workshop) / target.name
        with BagWriter(beside) as writer:
            _copy(take.path, writer, begins_ns, ends_ns, progress)
            writer.describe(_provenance(take, from_s, to_s), rig_in(take.path))
        finish_take(beside)
        return beside.rename(target)


def _part(summary: Summary, from_s: float, to_s: float | None, where: str) -> tuple[int, int]:
    """The stamps between which frame sets are kept."""
    quality = summary.quality
    end_s = quality.seconds if to_s is None else to_s
    if not 0.0 <= from_s < end_s or from_s > quality.seconds:
        remedy = f"Give seconds between 0 and {quality.seconds:.2f}, the first below the second."
        raise InputError(f"there is no part from {from_s:g} s to {end_s:g} s", where=where, remedy=remedy)
    return quality.begins_ns + round(from_s * 1e9), quality.begins_ns + round(end_s * 1e9)


def _copy(bag: Path, writer: BagWriter, begins_ns: int, ends_ns: int, progress: Callable[[int], None]) -> None:
    """Copy the messages' bytes. A latched topic begins with the last message from before the cut."""

    def kept(stamp_ns: int | None) -> bool:
        return stamp_ns is not None and begins_ns <= stamp_ns <= ends_ns

    logged = [message.log_ns for message in read_messages(bag, _has_stamp) if kept(_stamp_ns(message))]
    if not logged:
        raise InputError("the part holds no frame set", where=str(bag), remedy="Give a longer part.")
    first_ns, last_ns = min(logged), max(logged)
    with open_bag(bag) as reader:
        for connection in reader.connections:
            writer.add_topic_like(connection)
    before = {m.topic: m for m in read_messages(bag, LATCHED.__contains__) if m.log_ns < first_ns}
    for message in before.values():
        writer.write(message.topic, first_ns, message.data)
    for number, message in enumerate(read_messages(bag)):
        progress(number)
        stamp = _stamp_ns(message)
        if kept(stamp) if stamp is not None else first_ns <= message.log_ns <= last_ns:
            writer.write(message.topic, message.log_ns, message.data)


@cache  # few topics, called for every message
def _has_stamp(topic: str) -> bool:
    """Return whether a topic's messages carry the stamp of their frame set: the graph's, except latched ones and
    diagnostics."""
    if kind_of(topic) == STATE or OF_A_CAMERA.match(topic):
        return True
    kind = type_of(topic)
    return kind is not None and topic not in LATCHED and topic != DIAGNOSTICS_TOPIC and has_header(kind)


def _stamp_ns(message: BagMessage) -> int | None:
    """Return the stamp of a message's frame set, None if it has none."""
    if kind_of(message.topic) == STATE:
        stamp = values_of(message.decode(DiagnosticStatus)).get("stamp_ns", "")
        return int(stamp) if stamp.isdigit() else None
    return message.stamp_ns if _has_stamp(message.topic) else None


def _provenance(take: Take, from_s: float, to_s: float | None) -> dict[str, Any]:
    """Return the take's own provenance, and the part's origin."""
    origin = {"take": take.name, "from_s": from_s, "to_s": to_s, "trimmed_from": take.trimmed_from}
    return {"software": {}, **read_provenance(take.path), "trimmed_from": origin}
