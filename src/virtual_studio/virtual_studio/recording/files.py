"""Writes videos, and folders that appear whole or not at all and replace only what the virtual studio wrote itself."""

from __future__ import annotations

import os
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from capture_rig.camera import CameraModel
from capture_rig.errors import InputError
from capture_rig.yaml_file import read_mapping

MADE_BY = "virtual_studio"
FOOTAGE = ("mp4v", ".mp4")
"""Codec and suffix of footage: MPEG-4 part 2, which every OpenCV wheel can write (H.264 is not in them)."""
LOSSLESS = ("FFV1", ".mkv")
"""Codec and suffix of exact silhouettes, under 1 KB each (OpenCV 4.8 refuses FFV1 in mp4)."""


@contextmanager
def atomic_folder(folder: Path, description: str) -> Iterator[Path]:
    """Gives a folder to write into, which takes the place of ``folder`` when all went well.

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
        return read_mapping(description, "").get("made_by") == MADE_BY
    except InputError:
        return False


def _put_in_place(partial: Path, folder: Path) -> None:
    """Swaps the finished folder in; an older one goes only when the new one is there."""
    old = partial.with_suffix(".old")
    if folder.exists():
        folder.rename(old)
    partial.rename(folder)
    shutil.rmtree(old, ignore_errors=True)


class VideoFile:
    """Writes a camera's grey video, NAME + tail + the kind's suffix; use it as a context manager.

    OpenCV's own FFmpeg writes it on every supported platform, without an ffmpeg binary.
    Raises InputError when it cannot be opened.
    """

    def __init__(self, folder: Path, camera: CameraModel, kind: tuple[str, str], fps: float, tail: str = "") -> None:
        codec, suffix = kind
        path, size = folder / f"{camera.name}{tail}{suffix}", (camera.width, camera.height)
        fourcc = cv2.VideoWriter.fourcc(*codec)
        self._writer = cv2.VideoWriter(str(path), cv2.CAP_FFMPEG, fourcc, float(fps), size, False)
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
