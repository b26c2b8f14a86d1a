"""A session folder that appears whole or not at all."""

from __future__ import annotations

import os
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from capture_rig.errors import InputError


@contextmanager
def new_session_folder(folder: str | Path) -> Iterator[Path]:
    """An empty folder beside ``folder`` to write into; it becomes ``folder`` when the block ends without an error.

    Raises InputError when ``folder`` is there already and holds anything: nothing of a user's is overwritten.
    """
    folder = Path(folder)
    if folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
        raise InputError(
            "exists and is not an empty folder",
            where=str(folder),
            remedy="Give the path of a new folder, or remove this one yourself.",
        )
    partial = folder.parent / f".{folder.name}.{os.getpid()}.partial"
    partial.mkdir(parents=True)
    try:
        yield partial
        if folder.exists():
            folder.rmdir()
        partial.rename(folder)
    finally:
        shutil.rmtree(partial, ignore_errors=True)
