"""Sheets of several cameras' pictures under a caption, of one size, and the video file that they go into."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from types import TracebackType

import cv2
import numpy as np

from capture_rig.errors import InputError

GOOD_BGR, UNSURE_BGR, GREY_BGR = (110, 220, 110), (60, 190, 250), (170, 170, 170)
MAX_WIDTH_PX, MAX_HEIGHT_PX, BAR_PX = 1920, 1080, 40
CODECS = {".mp4": "mp4v", ".webm": "VP80", ".avi": "MJPG", ".mkv": "FFV1"}
"""Extension -> a codec that every OpenCV wheel can write: MPEG-4 plays in video programs, WebM in browsers, FFV1 is
lossless (OpenCV, up to 4.8, puts it into .mkv but not into .mp4)."""
SMALL_TEXT = 0.6  # of OpenCV's font: below, strokes two pixels wide run together


def captioned(sheet: np.ndarray, text: str, sure: bool | None) -> np.ndarray:
    """Return a sheet under a bar with a line of text, made smaller where it would not fit; sides are even, as codecs
    need it. sure : whether what is drawn is tracked, which colours the text; None where nobody is."""
    width, font = sheet.shape[1], cv2.FONT_HERSHEY_SIMPLEX
    colour = GREY_BGR if sure is None else GOOD_BGR if sure else UNSURE_BGR
    needed = cv2.getTextSize(text, font, 0.8, 2)[0][0]
    scale = min(0.8, 0.8 * (width - 20) / max(needed, 1))
    bar = np.zeros((BAR_PX, width, 3), np.uint8)
    cv2.putText(bar, text, (10, 28), font, scale, colour, 1 if scale < SMALL_TEXT else 2, cv2.LINE_AA)
    picture = np.vstack([bar, sheet])
    return np.ascontiguousarray(picture[: picture.shape[0] // 2 * 2, : width // 2 * 2])


def tiling(widths: Sequence[int], heights: Sequence[int]) -> tuple[int, float]:
    """Return the number of cameras a row, and the scale, that fill the video best."""
    count, width, height = len(widths), max(widths), max(heights)
    room = MAX_HEIGHT_PX - BAR_PX

    def scale(columns: int) -> float:
        return min(1.0, MAX_WIDTH_PX / (columns * width), room / (-(-count // columns) * height))

    columns = max(range(1, count + 1), key=scale)
    return columns, scale(columns)


class VideoFile:
    """A video that appears under its name when it is whole; pictures, (H, W, 3) BGR or (H, W), are of one shape.

    The extension chooses the codec (CODECS). Raises InputError for another one, and where it cannot be written.
    """

    def __init__(self, path: Path, fps: float) -> None:
        if path.suffix not in CODECS:
            remedy = f"Name it with one of {', '.join(CODECS)}."
            raise InputError(f"a video '{path.suffix}' cannot be written", where=str(path), remedy=remedy)
        self.path, self._fps = path, fps
        self._beside = path.with_name(f".{path.stem}.part{path.suffix}")
        self._writer: cv2.VideoWriter | None = None

    def write(self, picture: np.ndarray) -> None:
        """Append a picture."""
        if self._writer is None:
            self.path.parent.mkdir(parents=True, exist_ok=True)
            code = cv2.VideoWriter.fourcc(*CODECS[self.path.suffix])
            size, is_colour = (picture.shape[1], picture.shape[0]), picture.ndim == 3
            self._writer = cv2.VideoWriter(str(self._beside), code, self._fps, size, is_colour)
            if not self._writer.isOpened():
                remedy = "Install an OpenCV with FFmpeg, or name another folder."
                raise InputError("a video cannot be written", where=str(self.path), remedy=remedy)
        self._writer.write(picture)

    def __enter__(self) -> VideoFile:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._writer is not None:
            self._writer.release()
        if kind is None and self._beside.exists():
            self._beside.replace(self.path)
        self._beside.unlink(missing_ok=True)
