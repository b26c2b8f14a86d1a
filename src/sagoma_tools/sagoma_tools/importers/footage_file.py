"""Footage that is written without loss: what was compressed once by its owners is not compressed again."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np

from capture_rig.errors import InputError

CODEC, SUFFIX = "FFV1", ".mkv"
"""Lossless, and in every OpenCV wheel (which, up to 4.8, puts it into .mkv but not into .mp4)."""


class FootageFile:
    """A video being written, grey or colour; use it as a context manager. InputError when it cannot be opened."""

    def __init__(self, stem: Path, fps: float, image: np.ndarray) -> None:
        """``image`` (h, w) or (h, w, 3) uint8 is like those that follow; it is not written."""
        path = stem.with_name(stem.name + SUFFIX)
        size = (image.shape[1], image.shape[0])
        fourcc = cv2.VideoWriter.fourcc(*CODEC)
        self._writer = cv2.VideoWriter(str(path), cv2.CAP_FFMPEG, fourcc, float(fps), size, image.ndim == 3)
        if not self._writer.isOpened():
            raise InputError(
                f"a video with codec {CODEC} cannot be written",
                where=str(path),
                remedy="Install an OpenCV with FFmpeg (pip install opencv-python-headless).",
            )

    def write(self, image: np.ndarray) -> None:
        """Append one image of the first one's shape."""
        self._writer.write(image)

    def __enter__(self) -> FootageFile:
        return self

    def __exit__(self, *raised: object) -> None:
        self._writer.release()
