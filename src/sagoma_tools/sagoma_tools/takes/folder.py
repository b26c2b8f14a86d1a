"""A folder of takes: list them, name new ones, rename, delete to a bin and bring back; nothing recorded is overwritten.

A take is changed by one rename of its folder, so that it is there whole, under one name or the other.
"""

from __future__ import annotations

import os
import re
import shutil
import time
from dataclasses import dataclass, field, replace
from pathlib import Path

from capture_rig.errors import InputError

from ..recording.reader import open_bag, read_provenance
from .measure import SIDECAR_TAKE, read_summary
from .take import Take, TakeState, check_name

TAKES = "output/takes"
"""Where takes go unless told otherwise."""
BIN = ".bin"
BINNED = re.compile(r"(?P<name>.+)~(?P<when>\d{8}-\d{6})(?:-(?P<number>\d+))?")
"""A deleted take: its name, and when it was deleted; no name has a tilde."""
BEING_WRITTEN_S = 30.0
"""A bag without an index that has grown within so long may still be recorded: cameras write a megabyte sooner."""
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
        """Return all takes, the newest first; a bag that cannot be read is one that says why."""
        paths = [path for path in self.path.iterdir() if _is_bag(path)] if self.path.is_dir() else []
        self._seen = {path: self._seen[path] for path in paths if path in self._seen}
        return sorted(map(self._described, paths), key=lambda take: (-take.began_ns, take.name))

    def find(self, name: str) -> Take:
        """Return a take. Raises InputError when there is none of this name."""
        path = self.path / name
        if name in ("", os.curdir, os.pardir) or path.name != name or not _is_bag(path):
            known = ", ".join(take.name for take in self.takes()[:10]) or "none"
            raise InputError(f"there is no take '{name[:100]}'", where=str(self.path), remedy=f"There are: {known}.")
        return self._described(path)

    def new_path(self, name: str) -> Path:
        """Return the folder of a new take: by this name, or by date and time without one.

        Raises InputError for a name that is none, or that a take has already.
        """
        name = check_name(name) if name.strip() else time.strftime(f"take-{SAME_DATE}")
        path = self.path / name
        if os.path.lexists(path):
            raise InputError(f"there is a take '{name}' already", where=str(self.path), remedy="Choose another name.")
        self.path.mkdir(parents=True, exist_ok=True)
        return path

    def rename(self, name: str, new_name: str) -> Path:
        """Give a take another name. Raises InputError for a bad or taken name, and while it is being recorded."""
        take = self._settled(name)
        path = self.path / check_name(new_name)
        move_new(take.path, path)
        return path

    def delete(self, name: str) -> DeletedTake:
        """Move a take into the bin."""
        take = self._settled(name)
        when = time.strftime(SAME_DATE)
        (self.path / BIN).mkdir(exist_ok=True)
        for number in range(1000):  # the same name, deleted twice within a second
            path = self.path / BIN / (f"{take.name}~{when}" + (f"-{number}" if number else ""))
            if not os.path.lexists(path):
                move_new(take.path, path)
                return DeletedTake(path, take.name, when)
        raise InputError("the bin is full of it", where=str(path), remedy="Empty the bin.")

    def deleted(self) -> list[DeletedTake]:
        """Return what is in the bin, deleted last first."""
        folder = self.path / BIN
        paths = sorted(folder.iterdir(), key=_deleted_order, reverse=True) if folder.is_dir() else []
        found = [(path, BINNED.fullmatch(path.name)) for path in paths]
        return [DeletedTake(path, match["name"], match["when"]) for path, match in found if match is not None]

    def restore(self, name: str, new_name: str = "") -> Path:
        """Bring the take of this name that was deleted last back, under another name if wanted. Raises InputError."""
        for deleted in self.deleted():
            if name in (deleted.name, deleted.path.name):
                path = self.path / (check_name(new_name) if new_name else deleted.name)
                move_new(deleted.path, path)
                return path
        known = ", ".join(deleted.name for deleted in self.deleted()[:10]) or "nothing"
        raise InputError(f"'{name[:100]}' is not in the bin", where=str(self.path / BIN), remedy=f"There is: {known}.")

    def empty_bin(self) -> list[DeletedTake]:
        """Remove what is in the bin for good; returns it."""
        found = self.deleted()
        for deleted in found:
            remove_folder(deleted.path)
        return found

    def _settled(self, name: str) -> Take:
        """Return a take that nobody writes to."""
        take = self.find(name)
        if take.state is TakeState.UNFINISHED and time.time() - _newest_change_ns(take.path) / 1e9 < BEING_WRITTEN_S:
            remedy = f"Finish the recording; if its recorder was killed, wait for {BEING_WRITTEN_S:.0f} s."
            raise InputError(f"'{name}' is being recorded", where=str(self.path), remedy=remedy)
        return take

    def _described(self, path: Path) -> Take:
        """Describe a take, or say again what was found when nothing in it has changed since."""
        changed = _signature(path)
        if path not in self._seen or self._seen[path][0] != changed:
            self._seen[path] = changed, describe(path)
        return self._seen[path][1]


def describe(path: Path) -> Take:
    """Return what is known of a bag, by its index, provenance and summary; never raises, whatever is in the folder."""
    take = Take(path, bytes=_size(path))
    if path.is_dir() and not (path / "metadata.yaml").exists():
        what = "has no index: it is being recorded, or its recorder was killed"
        problem = InputError(what, where=str(path), remedy=f"Once nobody records it: `sagoma recover '{path}'`.")
        return replace(take, state=TakeState.UNFINISHED, problem=str(problem), began_ns=_newest_change_ns(path))
    try:
        with open_bag(path) as reader:
            topics = {connection.topic: connection.msgcount for connection in reader.connections}
            if reader.message_count:
                take = replace(take, began_ns=reader.start_time, seconds=reader.duration / 1e9)
        provenance = read_provenance(path)
        software = provenance.get("software")
        recorded_by = str(software.get("sagoma", "")) if isinstance(software, dict) else ""
        trimmed = provenance.get("trimmed_from")
        return replace(
            take,
            topics=topics,
            software=recorded_by,
            trimmed_from=trimmed if isinstance(trimmed, dict) else None,
            summary=read_summary(path),
        )
    except InputError as error:
        return replace(take, state=TakeState.DAMAGED, problem=str(error))
    except Exception as error:  # a broken file may break its reader in any way, and one take must not hide the others
        what = f"cannot be read ({type(error).__name__}: {error})"
        problem = InputError(what, where=str(path), remedy="Bring it back from a copy, or delete it.")
        return replace(take, state=TakeState.DAMAGED, problem=str(problem))


def move_new(source: Path, target: Path) -> None:
    """Rename a take's folder. Raises InputError where something has the new name, or the system refuses."""
    if os.path.lexists(target):
        raise InputError(f"there is a take '{target.name}' already", where=str(target.parent), remedy="Name it anew.")
    try:
        source.rename(target)
    except OSError as error:
        remedy = "See the rights of the folder, and whether its disk is full."
        raise InputError(f"cannot be renamed ({error.strerror})", where=str(source), remedy=remedy) from error


def remove_folder(path: Path) -> None:
    """Remove a folder with all in it; of a link, the link alone."""
    try:
        if path.is_symlink() or path.is_file():
            path.unlink()
        else:
            shutil.rmtree(path)
    except OSError as error:
        raise InputError(f"cannot be removed ({error.strerror})", where=str(path), remedy="See its rights.") from error


def _is_bag(path: Path) -> bool:
    try:
        return (
            path.is_dir()
            and not path.name.startswith(".")
            and ((path / "metadata.yaml").exists() or any(path.glob("*.mcap")))
        )
    except OSError:  # of a folder that may not be read
        return False


def _deleted_order(path: Path) -> tuple[str, int]:
    match = BINNED.fullmatch(path.name)
    return (match["when"], int(match["number"] or 0)) if match else ("", 0)


def _signature(path: Path) -> tuple:
    """What changes whenever a take does: its files' sizes and times."""
    names = ("metadata.yaml", SIDECAR_TAKE, "sagoma.yaml")
    try:
        files = [*(path / name for name in names if (path / name).exists()), *path.glob("*.mcap"), *path.glob("*.db3")]
        return tuple((file.name, file.stat().st_mtime_ns, file.stat().st_size) for file in files)
    except OSError:
        return (time.monotonic(),)


def _newest_change_ns(path: Path) -> int:
    return max((ns for _, ns, _ in _signature(path)), default=0)


def _size(path: Path) -> int:
    try:
        return sum(file.stat().st_size for file in path.glob("*") if file.is_file())
    except OSError:
        return 0
