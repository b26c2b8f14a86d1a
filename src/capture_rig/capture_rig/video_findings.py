"""What is wrong with video files as people have them: cut off, damaged, of a variable or a wrong frame rate."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path

from .verdict import REDO, USABLE, Finding
from .video import OPENING, PassedFrames, Video

# a time stamp may be off by that share of the period before frames count as uneven: containers keep milliseconds, a
# tenth of the period at 100 Hz; a frame left out, or one that came a period late, is off by a whole one
UNEVEN = 0.5
FAR_FEWER = 0.5  # of the frames that were to come: what is left is no capture


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
