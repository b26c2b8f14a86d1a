"""Reads and writes video files frame after frame: the one place where a file is opened with OpenCV.

with Video(path) as video:
    for image in video: ...
    video.facts  # the number of frames read, their intervals

Findings name the faults of real files: cut off, damaged, of a variable or a wrong frame rate.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from types import TracebackType

import cv2
import numpy as np

from .errors import InputError
from .verdict import REDO, USABLE, Finding

REMEDY = "Check the file with a video player, or its codec; a recording that was cut off can often be copied whole by "
REMEDY += "ffmpeg -i FILE -c copy NEW.mkv."
# rates in headers from here on are the clock of its time stamps (1000: milliseconds; 90000: MPEG), not a camera's
CLOCK_RATE = 1000.0
# grey levels between the channels of a grey picture stored as colour: rounding of the conversion, and chroma that a
# codec quantised (4:2:0, one step of 2 levels: 1.77 times that in blue); and the share of pixels beyond, where chroma
# was damaged
MONO_TOLERANCE, COLOURED_SHARE = 4, 1e-3
# a time stamp may be off by that share of the period before frames count as uneven: containers keep milliseconds, a
# tenth of the period at 100 Hz; a frame left out, or one that came a period late, is off by a whole one
UNEVEN = 0.5
FAR_FEWER = 0.5  # of the expected frames: a video with fewer is unusable


@dataclass(frozen=True)
class VideoFacts:
    """Figures of a video since it was opened or rewound: ``frames``, and the shortest and longest time between
    neighbours by their time stamps, s, 0 if the file has none. header_frames, fps : of its header, 0 if missing."""

    path: Path
    header_frames: int
    fps: float
    frames: int
    shortest_s: float = 0.0
    longest_s: float = 0.0


class Video:
    """A video file, open for reading until :meth:`close`; also a context manager and an iterator over its frames.

    fps : the header's rate, Hz, 0 if missing or not a camera's; header_fps : as it stands there.
    frame_count : of the header, 0 if missing.
    size_px : width and height of the images.
    """

    def __init__(self, path: str | Path, *, threads: int = 0, remedy: str = REMEDY) -> None:
        """``threads`` : that decode, each of which holds several images; 0 leaves it to OpenCV.

        Raises InputError with ``remedy`` when the file cannot be opened as a video.
        """
        self.path, self._remedy = Path(path), remedy
        self._frames, self._stamp_ms, self._shortest_ms, self._longest_ms = 0, 0.0, math.inf, -math.inf
        self._options = [cv2.CAP_PROP_N_THREADS, threads] if threads else []
        self._open()
        self.header_fps = float(self._capture.get(cv2.CAP_PROP_FPS))
        self.fps = self.header_fps if 0.0 < self.header_fps < CLOCK_RATE else 0.0
        self.frame_count = max(int(self._capture.get(cv2.CAP_PROP_FRAME_COUNT)), 0)
        self.size_px = (
            int(self._capture.get(cv2.CAP_PROP_FRAME_WIDTH)),
            int(self._capture.get(cv2.CAP_PROP_FRAME_HEIGHT)),
        )

    @property
    def facts(self) -> VideoFacts:
        """What was read or skipped since the file was opened or rewound."""
        shortest_s, longest_s = (1e-3 * ms if self._frames > 1 else 0.0 for ms in (self._shortest_ms, self._longest_ms))
        return VideoFacts(self.path, self.frame_count, self.fps, self._frames, shortest_s, longest_s)

    def read(self) -> np.ndarray | None:
        """Return the next frame (H, W, 3) uint8, BGR; None after the last."""
        read, image = self._capture.read()
        if not read:
            return None
        self._count()
        return image

    def skip(self, frames: int) -> int:
        """Skip ``count`` frames; return the number skipped, fewer at the end. Exact, unlike seeking."""
        for k in range(frames):
            if not self._capture.grab():
                return k
            self._count()
        return frames

    def _count(self) -> None:
        stamp_ms = self._capture.get(cv2.CAP_PROP_POS_MSEC)
        if self._frames > 0:
            interval = stamp_ms - self._stamp_ms
            self._shortest_ms, self._longest_ms = min(self._shortest_ms, interval), max(self._longest_ms, interval)
        self._stamp_ms = stamp_ms
        self._frames += 1

    def rewind(self) -> None:
        """Start again before the first frame. Raises InputError when the file has gone."""
        self.close()
        self._frames, self._shortest_ms, self._longest_ms = 0, math.inf, -math.inf
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


CODECS = {".mp4": "mp4v", ".webm": "VP80", ".avi": "MJPG", ".mkv": "FFV1"}
"""Extension -> a codec that every OpenCV wheel can write: MPEG-4 plays in video programs, WebM in browsers, FFV1 is
lossless (OpenCV, up to 4.8, puts it into .mkv but not into .mp4)."""


class VideoFile:
    """Writes a video that appears under its name when it is whole; pictures, (H, W, 3) BGR or (H, W), are of one shape.

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
            self._writer = cv2.VideoWriter(str(self._beside), cv2.CAP_FFMPEG, code, self._fps, size, is_colour)
            if not self._writer.isOpened():
                remedy = "Install an OpenCV with FFmpeg (opencv-python-headless), or name another folder."
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


def is_grey(image: np.ndarray) -> bool:
    """Return True for (H, W), and for (H, W, 3) whose channels are equal but for rounding and a codec's chroma."""
    if image.ndim == 2:
        return True
    blue, green, red = cv2.split(image)
    spread = cv2.max(cv2.absdiff(blue, green), cv2.absdiff(red, green))
    return int(np.count_nonzero(spread > MONO_TOLERANCE)) <= COLOURED_SHARE * spread.size


def examine_video(path: str | Path) -> VideoFacts:
    """Read a video to its end. Raises InputError when it cannot be opened."""
    with Video(path) as video:
        while video.skip(1):
            pass
        return video.facts


def video_findings(facts: VideoFacts) -> Iterator[Finding]:
    """Yield the faults of one video that was read to its end."""
    if facts.frames == 0:
        yield Finding(REDO, "holds no frame that can be decoded", "Check the file, or its codec.")
        return
    if facts.frames < facts.header_frames:
        yield Finding(
            _grade(facts.frames, facts.header_frames),
            f"ends after {facts.frames} frames, its header promises {facts.header_frames}: it was cut off, or is "
            "damaged inside, and its later frames come too early",
            "Copy it again from where it was recorded; what was cut off cannot be used.",
        )
    # a file without time stamps has no longest interval
    if facts.frames > 2 and facts.longest_s > 0 and facts.longest_s - facts.shortest_s > UNEVEN / (facts.fps or np.inf):
        yield Finding(
            USABLE,
            f"has a variable frame rate: its frames are {1e3 * facts.shortest_s:.0f} to "
            f"{1e3 * facts.longest_s:.0f} ms apart, so that frame k of the cameras is not of one instant",
            "Record at a constant rate, or fill the gaps: "
            f"ffmpeg -i {facts.path.name} -fps_mode cfr -r RATE -c:v libx264 -crf 16 NEW.mp4.",
        )


def ended_findings(videos: Mapping[str, VideoFacts]) -> Iterator[Finding]:
    """Yield the faults of all cameras' videos, which were read in step until the first of them ended, and that one;
    findings name the files."""
    shortest = min(facts.frames for facts in videos.values())
    first = [facts for facts in videos.values() if facts.frames == shortest]
    others = [facts for facts in videos.values() if facts.frames > shortest]
    for facts in (*first, *(replace(facts, header_frames=0) for facts in others)):
        yield from (replace(finding, what=f"{facts.path}: {finding.what}") for finding in video_findings(facts))
    if others:
        names = ", ".join(facts.path.name for facts in first)
        most = max(facts.header_frames for facts in others)
        promised = f" (up to {most})" if most else ""
        yield Finding(
            _grade(shortest, most),
            f"{names} ended after {shortest} frames, before the others{promised}, and all with it",
            "Cut all videos so that frame k of each is of the same instant.",
        )


def _grade(frames: int, expected: int) -> str:
    return REDO if frames < FAR_FEWER * expected else USABLE
