"""Folders that appear whole or not at all, and replace only what the virtual studio wrote itself."""

from __future__ import annotations

import os
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import yaml

from capture_rig.errors import InputError

MADE_BY = "virtual_studio"


@contextmanager
def whole_folder(folder: Path, description: str) -> Iterator[Path]:
    """A folder to write into, which is put in the place of ``folder`` when all went well.

    ``description`` names the YAML file in it that says ``made_by: virtual_studio``.
    Raises InputError when ``folder`` is no folder, or holds something that the studio did not write.
    """
    _check(folder, description)
    partial = folder.parent / f".{folder.name}.{os.getpid()}.partial"
    partial.mkdir(parents=True)
    try:
        yield partial
        _put_in_place(partial, folder)
    finally:
        shutil.rmtree(partial, ignore_errors=True)


def _check(folder: Path, description: str) -> None:
    if folder.exists() and not folder.is_dir():
        raise InputError("is not a folder", where=str(folder), remedy="Give the path of a new folder.")
    if folder.is_dir() and any(folder.iterdir()) and not _is_own(folder / description):
        raise InputError(
            "is not empty and was not written by the virtual studio",
            where=str(folder),
            remedy="Give a new folder, or empty this one yourself.",
        )


def _is_own(description: Path) -> bool:
    try:
        document = yaml.safe_load(description.read_text(encoding="utf-8"))
    except (OSError, UnicodeDecodeError, yaml.YAMLError):
        return False
    return isinstance(document, dict) and document.get("made_by") == MADE_BY


def _put_in_place(partial: Path, folder: Path) -> None:
    """Swaps the finished folder in; an older one goes only when the new one is there."""
    old = partial.with_suffix(".old")
    if folder.exists():
        folder.rename(old)
    partial.rename(folder)
    shutil.rmtree(old, ignore_errors=True)
