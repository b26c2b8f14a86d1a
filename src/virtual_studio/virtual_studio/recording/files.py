"""Folders that appear whole or not at all, and replace only what the virtual studio wrote itself."""

from __future__ import annotations

import os
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import cv2
import numpy as np
import yaml
from numpy.typing import NDArray

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


# --- Video files that OpenCV's own FFmpeg writes and reads on every supported platform, without an ffmpeg binary.

FOOTAGE = ("mp4v", ".mp4")
"""Codec and suffix of footage: MPEG-4 part 2, which every OpenCV wheel can write (H.264 is not in them)."""
LOSSLESS = ("FFV1", ".mkv")
"""Codec and suffix of exact silhouettes, under 1 KB each (OpenCV 4.8 refuses FFV1 in mp4)."""


class VideoFile:
    """A grey video being written (`stem` plus the kind's suffix); use it as a context manager.

    Raises InputError when it cannot be opened.
    """

    def __init__(self, stem: Path, kind: tuple[str, str], fps: float, width: int, height: int) -> None:
        codec, suffix = kind
        path = stem.with_name(stem.name + suffix)
        fourcc = cv2.VideoWriter.fourcc(*codec)
        self._writer = cv2.VideoWriter(str(path), cv2.CAP_FFMPEG, fourcc, float(fps), (width, height), False)
        if not self._writer.isOpened():
            raise InputError(
                f"a video with codec {codec} cannot be written",
                where=str(path),
                remedy="Install an OpenCV with FFmpeg (pip install opencv-python-headless).",
            )

    def write(self, image: NDArray[np.uint8]) -> None:
        """Appends one image (h, w) uint8."""
        self._writer.write(image)

    def __enter__(self) -> VideoFile:
        return self

    def __exit__(self, *raised: object) -> None:
        self._writer.release()


def read_grey(path: Path) -> NDArray[np.uint8]:
    """All frames (F, h, w) of a grey video. Raises InputError when there is none."""
    capture, frames = cv2.VideoCapture(str(path)), []
    while True:
        read, image = capture.read()
        if not read:
            break
        frames.append(image[..., 0] if image.ndim == 3 else image)
    capture.release()
    if not frames:
        raise InputError("is not a readable video", where=str(path), remedy="Write the session again.")
    return np.array(frames)
