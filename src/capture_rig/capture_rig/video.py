"""Reads video files frame after frame: the one place where a file is opened with OpenCV.

with Video(path) as video:
    for image in video: ...
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from pathlib import Path

import cv2
import numpy as np

from .errors import InputError

REMEDY = "Check the file with a video player, or its codec."


class Video:
    """A video file, open for reading until :meth:`close`; also a context manager and an iterator over its frames.

    fps : the file's own rate, Hz, 0 where it tells none. frame_count : as the file's header says, 0 where it does not.
    size_px : width and height of the images.
    """

    def __init__(self, path: str | Path, *, threads: int = 0, remedy: str = REMEDY) -> None:
        """``threads`` : that decode, each of which holds several images; 0 leaves it to OpenCV.

        Raises InputError with ``remedy`` when the file cannot be opened as a video.
        """
        self.path, self._remedy = Path(path), remedy
        self._options = [cv2.CAP_PROP_N_THREADS, threads] if threads else []
        self._open()
        fps = self._capture.get(cv2.CAP_PROP_FPS)
        self.fps = float(fps) if math.isfinite(fps) and fps > 0 else 0.0
        self.frame_count = max(int(self._capture.get(cv2.CAP_PROP_FRAME_COUNT)), 0)
        self.size_px = (
            int(self._capture.get(cv2.CAP_PROP_FRAME_WIDTH)),
            int(self._capture.get(cv2.CAP_PROP_FRAME_HEIGHT)),
        )

    def read(self) -> np.ndarray | None:
        """Return the next frame (H, W, 3) uint8, BGR; None after the last."""
        read, image = self._capture.read()
        return image if read else None

    def skip(self, frames: int) -> int:
        """Pass over so many frames; returns how many there were. Exact, unlike seeking."""
        return next((k for k in range(frames) if not self._capture.grab()), frames)

    def rewind(self) -> None:
        """Start again before the first frame. Raises InputError when the file has gone."""
        self.close()
        self._open()

    def close(self) -> None:
        self._capture.release()

    def __enter__(self) -> Video:
        return self

    def __exit__(self, *raised: object) -> None:
        self.close()

    def __iter__(self) -> Iterator[np.ndarray]:
        while (image := self.read()) is not None:
            yield image

    def _open(self) -> None:
        self._capture = cv2.VideoCapture(str(self.path), cv2.CAP_FFMPEG, self._options)
        if not self._capture.isOpened():
            raise InputError("cannot be opened as a video", where=str(self.path), remedy=self._remedy)
