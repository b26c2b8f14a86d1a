"""Writes session folders: the folder appears whole or not at all; footage is lossless; truth.csv holds points."""

from __future__ import annotations

import csv
import os
import shutil
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path

import cv2
import numpy as np

from capture_rig.errors import InputError
from capture_rig.rig import FLOOR_MARGIN_M, Volume

SIDE_MARGIN_M, TOP_MARGIN_M = 0.4, 0.3
"""From the outermost markers to the sides of the capture volume: body surface and hands lie beyond them."""
CODEC, SUFFIX = "FFV1", ".mkv"
"""Lossless, and in every OpenCV wheel (which, up to 4.8, puts it into .mkv but not into .mp4)."""


@contextmanager
def new_session_folder(folder: str | Path) -> Iterator[Path]:
    """An empty folder beside ``folder`` to write into; it becomes ``folder`` when the block ends without an error.

    Raises InputError when ``folder`` exists and is not empty.
    """
    folder = Path(folder)
    if folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
        remedy = "Give the path of a new folder, or remove this one yourself."
        raise InputError("exists and is not an empty folder", where=str(folder), remedy=remedy)
    partial = folder.parent / f".{folder.name}.{os.getpid()}.partial"
    partial.mkdir(parents=True)
    try:
        yield partial
        if folder.exists():
            folder.rmdir()
        partial.rename(folder)
    finally:
        shutil.rmtree(partial, ignore_errors=True)


class FootageFile:
    """Writes a lossless video, grey or colour; a context manager. Raises InputError when it cannot be opened."""

    def __init__(self, stem: Path, fps: float, image: np.ndarray) -> None:
        """``image`` (h, w) or (h, w, 3) uint8 is like those that follow; it is not written."""
        path = stem.with_name(stem.name + SUFFIX)
        size = (image.shape[1], image.shape[0])
        fourcc = cv2.VideoWriter.fourcc(*CODEC)
        self._writer = cv2.VideoWriter(str(path), cv2.CAP_FFMPEG, fourcc, float(fps), size, image.ndim == 3)
        if not self._writer.isOpened():
            remedy = "Install an OpenCV with FFmpeg (pip install opencv-python-headless)."
            raise InputError(f"a video with codec {CODEC} cannot be written", where=str(path), remedy=remedy)

    def write(self, image: np.ndarray) -> None:
        """Append one image of the first one's shape."""
        self._writer.write(image)

    def __enter__(self) -> FootageFile:
        return self

    def __exit__(self, *raised: object) -> None:
        self._writer.release()


def volume_around(points_world: np.ndarray) -> Volume:
    """Return the capture volume around all markers (n, 3) of a recording, metres."""
    low, high = points_world.min(axis=0), points_world.max(axis=0)
    return Volume(
        np.array([*(low[:2] - SIDE_MARGIN_M), -FLOOR_MARGIN_M]),
        np.array([*(high[:2] + SIDE_MARGIN_M), high[2] + TOP_MARGIN_M]),
    )


def write_truth_file(path: Path, frames: np.ndarray, points_world: Mapping[str, np.ndarray]) -> None:
    """Write one row a frame: its 0-based number (F,), then x, y, z of every point (F, 3), metres, map frame.

    Cells of points that are not finite stay empty: unknown.
    """
    header = ["frame", *(f"{name}_{axis}" for name in points_world for axis in "xyz")]
    table = np.hstack(list(points_world.values()))
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(header)
        for frame, row in zip(frames, table, strict=True):
            writer.writerow([int(frame), *(f"{value:.6f}" if np.isfinite(value) else "" for value in row)])
