"""Reads video files frame after frame: the one place where a file is opened with OpenCV.

with Video(path) as video:
    for image in video: ...
    video.passed  # what came: how many frames, how far apart

What is wrong with files as people have them, cut off, damaged, of a variable or a wrong frame rate, the findings say.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path

import cv2
import numpy as np

from .errors import InputError
from .verdict import REDO, USABLE, Finding

REMEDY = "Check the file with a video player, or its codec; a recording that was cut off can often be copied whole by "
REMEDY += "ffmpeg -i FILE -c copy NEW.mkv."
# what a header gives from here on is the clock of its time stamps (1000: milliseconds; 90000: MPEG), no camera's rate
CLOCK_RATE = 1000.0
# grey levels between the channels of a grey picture stored as colour: rounding of the conversion, and chroma that a
# codec quantised (4:2:0, one step of 2 levels: 1.77 times that in blue); and the share of pixels beyond, where chroma
# was damaged
MONO_TOLERANCE, COLOURED_SHARE = 4, 1e-3
OPENING = 3
# the second frame is the first again where it differs from it by so much less than the third from the second: clips of
# XVID and MJPEG 0 to 0.2 %, of any codec without a repeated frame 50 % and more
SAME = 0.1
# a time stamp may be off by that share of the period before frames count as uneven: containers keep milliseconds, a
# tenth of the period at 100 Hz; a frame left out, or one that came a period late, is off by a whole one
UNEVEN = 0.5
FAR_FEWER = 0.5  # of the frames that were to come: what is left is no capture


@dataclass(frozen=True)
class PassedFrames:
    """What came of a video so far: ``frames``, and the shortest and longest time between neighbours by their time
    stamps, s, 0 where the file has none. ``twice`` : the second frame was the first again."""

    frames: int = 0
    shortest_s: float = 0.0
    longest_s: float = 0.0
    twice: bool = False


class Video:
    """A video file, open for reading until :meth:`close`; also a context manager and an iterator over its frames.

    fps : the file's own rate, Hz, 0 where it tells none that a camera has; header_fps : as it stands there.
    frame_count : as the file's header says, 0 where it does not.
    size_px : width and height of the images.
    """

    def __init__(self, path: str | Path, *, threads: int = 0, remedy: str = REMEDY) -> None:
        """``threads`` : that decode, each of which holds several images; 0 leaves it to OpenCV.

        Raises InputError with ``remedy`` when the file cannot be opened as a video.
        """
        self.path, self._remedy = Path(path), remedy
        self._frames, self._twice = 0, False
        self._opening: list[np.ndarray] = []
        self._stamp_ms, self._shortest_ms, self._longest_ms = 0.0, math.inf, -math.inf
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
    def passed(self) -> PassedFrames:
        """What was read or skipped since the file was opened or rewound."""
        intervals = (self._shortest_ms, self._longest_ms) if self._frames > 1 else (0.0, 0.0)
        return PassedFrames(self._frames, 1e-3 * intervals[0], 1e-3 * intervals[1], self._twice)

    def read(self) -> np.ndarray | None:
        """Return the next frame (H, W, 3) uint8, BGR; None after the last."""
        read, image = self._capture.read()
        if not read:
            return None
        if self._frames < OPENING:
            self._remember(image)
        self._count()
        return image

    def skip(self, frames: int) -> int:
        """Pass over so many frames; returns how many there were. Exact, unlike seeking."""
        for k in range(frames):
            if not self._capture.grab():
                return k
            self._count()
        return frames

    def _remember(self, image: np.ndarray) -> None:
        """Compare the first frames, as far as they are read one after the other."""
        self._opening.append(image.copy())
        if len(self._opening) == OPENING == self._frames + 1:
            changed, next_changed = (float(cv2.absdiff(a, b).mean()) for a, b in pairwise(self._opening))
            self._twice = changed < SAME * next_changed
            self._opening.clear()

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
        self._frames, self._twice, self._opening = 0, False, []
        self._stamp_ms, self._shortest_ms, self._longest_ms = 0.0, math.inf, -math.inf


def is_grey(image: np.ndarray) -> bool:
    """True for (H, W), and for (H, W, 3) whose channels are equal but for rounding and what a codec does to chroma."""
    if image.ndim == 2:
        return True
    blue, green, red = cv2.split(image)
    spread = cv2.max(cv2.absdiff(blue, green), cv2.absdiff(red, green))
    return int(np.count_nonzero(spread > MONO_TOLERANCE)) <= COLOURED_SHARE * spread.size


@dataclass(frozen=True)
class VideoFacts:
    """A video that was read to its end. header_frames : as its header says, 0 where it does not; fps : 0 likewise."""

    path: Path
    header_frames: int
    fps: float
    size_px: tuple[int, int]
    passed: PassedFrames

    @classmethod
    def of(cls, video: Video) -> VideoFacts:
        """Return what is known of a video of which all that was wanted has been read."""
        return cls(video.path, video.frame_count, video.fps, video.size_px, video.passed)


def examine_video(path: str | Path) -> VideoFacts:
    """Read a video to its end. Raises InputError when it cannot be opened."""
    with Video(path) as video:
        for _ in range(OPENING):
            video.read()
        while video.skip(1):
            pass
        return VideoFacts.of(video)


def video_findings(facts: VideoFacts) -> Iterator[Finding]:
    """Find what is wrong with one video that was read to its end."""
    passed = facts.passed
    if passed.frames == 0:
        yield Finding(REDO, "holds no frame that can be decoded", "Check the file, or its codec.")
        return
    if passed.frames < facts.header_frames:
        yield Finding(
            _grade(passed.frames, facts.header_frames),
            f"ends after {passed.frames} frames, its header promises {facts.header_frames}: it was cut off, or is "
            "damaged inside, and its later frames come too early",
            "Copy it again from where it was recorded; what was cut off cannot be used.",
        )
    if facts.fps > 0 and _uneven(facts):
        yield Finding(
            USABLE,
            f"has a variable frame rate: its frames are {1e3 * passed.shortest_s:.0f} to "
            f"{1e3 * passed.longest_s:.0f} ms apart, so that frame k of the cameras is not of one instant",
            "Record at a constant rate, or fill the gaps: "
            f"ffmpeg -i {facts.path.name} -fps_mode cfr -r RATE -c:v libx264 -crf 16 NEW.mp4.",
        )


def session_findings(videos: Mapping[str, VideoFacts]) -> Iterator[Finding]:
    """Find what is wrong with each camera's video, and where one may be a frame late; the findings name the files."""
    for facts in videos.values():
        yield from (replace(finding, what=f"{facts.path}: {finding.what}") for finding in video_findings(facts))
    late = [facts.path.name for facts in videos.values() if facts.passed.twice]
    if late and len(late) < len(videos):
        yield Finding(
            USABLE,
            f"the first frame of {', '.join(late)} comes twice, that of the other cameras does not",
            "Some encoders (XVID) repeat it, and the camera is a frame late then: cut it, ffmpeg -i IN "
            r"-vf select='gte(n\,1)' -c:v libx264 -crf 16 OUT.mp4. Of a scene in which nothing moves it means nothing.",
        )


def ended_findings(videos: Mapping[str, VideoFacts]) -> Iterator[Finding]:
    """Find the same in videos that were read in step until the first of them ended, and which one that was."""
    shortest = min(facts.passed.frames for facts in videos.values())
    first = {name: facts for name, facts in videos.items() if facts.passed.frames == shortest}
    others = {name: replace(facts, header_frames=0) for name, facts in videos.items() if name not in first}
    yield from session_findings(dict(sorted({**first, **others}.items())))
    if others:
        names = ", ".join(facts.path.name for facts in first.values())
        most = max(videos[name].header_frames for name in others)
        promised = f" (up to {most})" if most else ""
        yield Finding(
            _grade(shortest, most),
            f"{names} ended after {shortest} frames, before the others{promised}, and all with it",
            "Cut all videos so that frame k of each is of the same instant.",
        )


def _grade(frames: int, expected: int) -> str:
    return REDO if frames < FAR_FEWER * expected else USABLE


def _uneven(facts: VideoFacts) -> bool:
    period_s, passed = 1.0 / facts.fps, facts.passed
    if passed.frames < 3 or passed.longest_s <= 0.0:  # no time stamps
        return False
    return passed.longest_s - passed.shortest_s > UNEVEN * period_s
