"""Files read and written with care: read within a limit, written beside their place and renamed.

A reader of the file sees the old content or the new one, whole, whatever ends the writer: the new content is on the
disk (fsync) before the name points to it (rename, POSIX), and so is the name itself before the writer goes on.
"""

from __future__ import annotations

import errno
import os
import secrets
import shutil
import stat
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import BinaryIO

from .errors import InputError, shortened

MOST_TEXT_BYTES = 256 << 20  # an hour of reference points at 60 Hz has 150 MB
_READABLE = 0o666  # less the user's umask, as any program's files
FREE_SPACE = "Free space on that disk, or choose another."
FULL = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)  # the disk, the quota, the largest file size


def describe_os_error(error: OSError, what: str, where: object = None, remedy: str = "") -> InputError:
    """Return the InputError for an operation (``what``) that failed, with reason and remedy."""
    place = where if where is not None else error.filename
    remedy = remedy or (FREE_SPACE if error.errno in FULL else "Check the path and who may use it.")
    return InputError(f"{what} ({error.strerror or error})", where=shortened(str(place or "")), remedy=remedy)


def read_text(path: str | Path, remedy: str = "", most_bytes: int = MOST_TEXT_BYTES) -> str:
    """The text (UTF-8) of a regular file. Raises InputError: not there, too large, no file, not UTF-8."""
    where = shortened(str(path))
    try:
        with open(path, "rb", opener=_open_at_once) as file:
            if not stat.S_ISREG(os.fstat(file.fileno()).st_mode):
                raise InputError("is not a regular file", where=where, remedy=remedy or "Give the path of a file.")
            data = file.read(most_bytes + 1)
    except OSError as error:
        raise describe_os_error(error, "cannot be read", path, remedy) from None
    except InputError:
        raise
    except ValueError:  # a null character
        raise InputError("is not a path", where=repr(where), remedy="Check the path.") from None
    if len(data) > most_bytes:
        what = f"is larger than {most_bytes / 2**20:g} MiB, too large for such a file"
        raise InputError(what, where=where, remedy=remedy)
    try:
        return data.decode("utf-8")
    except UnicodeDecodeError as error:
        line = data.count(b"\n", 0, error.start) + 1
        raise InputError(f"is not UTF-8 text (line {line}: {error.reason})", where=where, remedy=remedy) from None


def _open_at_once(path: str, flags: int) -> int:
    return os.open(path, flags | os.O_NONBLOCK)  # a named pipe without a writer would block for ever


def write_text(path: str | Path, text: str) -> None:
    """Write ``text`` (UTF-8), all or nothing. Raises InputError when the file cannot be written."""
    write_bytes(path, text.encode("utf-8"))


def write_bytes(path: str | Path, data: bytes) -> None:
    """Write ``data``, all or nothing. Raises InputError when the file cannot be written."""
    with replaced_file(path) as file:
        file.write(data)


def copy_file(source: str | Path, target: str | Path) -> None:
    """Copy a small file's bytes, all or nothing. Raises InputError when it cannot be read or written."""
    try:
        data = Path(source).read_bytes()
    except OSError as error:
        raise describe_os_error(error, "cannot be read", source) from None
    write_bytes(target, data)


@contextmanager
def replaced_file(path: str | Path) -> Iterator[BinaryIO]:
    """Open a new file to write into, which replaces ``path`` when the block ends without an error.

    The file that a link names is replaced, not the link; a device or a pipe is written as it is. Raises InputError when
    it cannot be written; nothing is left beside it then.
    """
    try:
        place = Path(os.path.realpath(path))
        if place.exists() and not place.is_file() and not place.is_dir():
            with place.open("wb") as device:
                yield device
            return
        partial = place.with_name(f".{secrets.token_hex(6)}.partial")
        with _open_new(partial) as file:
            try:
                yield file
                file.flush()
                os.fsync(file.fileno())
                os.replace(partial, place)
            except BaseException:
                with suppress(OSError):
                    partial.unlink()
                raise
        sync_folder(place.parent)
    except OSError as error:
        raise describe_os_error(error, "cannot be written", path) from None


def _open_new(path: Path) -> BinaryIO:
    return open(path, "xb", opener=lambda name, flags: os.open(name, flags, _READABLE))


@contextmanager
def replaced_folder(folder: str | Path, may_replace: Callable[[Path], bool] = lambda folder: False) -> Iterator[Path]:
    """Make an empty folder beside ``folder`` to write into; it becomes ``folder`` when the block ends without an error.

    A ``folder`` that is not empty is replaced only if ``may_replace`` allows it, once the new one is complete. Raises
    InputError otherwise.
    """
    folder = Path(folder)
    if folder.exists() and (not folder.is_dir() or (any(folder.iterdir()) and not may_replace(folder))):
        remedy = "Give the path of a new folder, or remove this one yourself."
        raise InputError("exists and is not an empty folder", where=str(folder), remedy=remedy)
    partial = folder.parent / f".{folder.name}.{os.getpid()}.partial"
    partial.mkdir(parents=True)
    old = partial.with_suffix(".old")
    try:
        yield partial
        if folder.exists():
            folder.rename(old)
        partial.rename(folder)
    finally:
        for left in (partial, old):
            shutil.rmtree(left, ignore_errors=True)


def make_folder(folder: str | Path) -> Path:
    """Make a folder and those above it, where they are not there. Raises InputError when it cannot."""
    try:
        Path(folder).mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise describe_os_error(error, "cannot be made", folder) from None
    return Path(folder)


def sync_folder(folder: str | Path) -> None:
    """Flush a folder's entries to the disk, so that a new or renamed file survives a power cut."""
    descriptor = os.open(folder, os.O_RDONLY | os.O_DIRECTORY)
    try:
        with suppress(OSError):  # file systems that know no such thing (EINVAL)
            os.fsync(descriptor)
    finally:
        os.close(descriptor)
