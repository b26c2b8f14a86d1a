"""Serves the footage of a session, decoded into memory, as what the cameras see."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from capture_rig.errors import InputError
from capture_rig.session import STILL_SUFFIXES, Session
from capture_rig.stamps import UTC, CaptureClock
from capture_rig.video import Video, is_grey

from ..rendering.camera import Image
from .scenes import Playback

"""Grey levels between the channels of a grey picture that was stored as colour."""
BACKGROUND_SHARE = 0.25
"""Of the memory, at most, for the empty room."""
LOADERS = 2


@dataclass(frozen=True, eq=False)
class SessionView:
    """One camera's pictures of a session, all in memory: frames (F of them), and of the empty room (none, or more)."""

    playback: Playback
    frames: tuple[Image, ...]
    background: tuple[Image, ...]

    @property
    def shape(self) -> tuple[int, ...]:
        return self.frames[0].shape

    def image(self, instant_ns: int) -> Image:
        if self.background and not self.playback.occupied_at(instant_ns):
            number = int(instant_ns * self.playback.fps // 1_000_000_000)
            return self.background[number % len(self.background)]
        return self.frames[self.playback.frame_at(instant_ns)]


@dataclass(frozen=True, eq=False)
class SessionScene:
    """A session as a scene: views by camera name; of total_frames in the footage playback.frames are shown."""

    playback: Playback
    views: dict[str, SessionView]
    total_frames: int

    @property
    def can_be_empty(self) -> bool:
        """True when every camera knows what the empty room looks like."""
        return all(view.background for view in self.views.values())


def load_session_scene(session: Session, memory_mb: float = 800.0, clock: CaptureClock = UTC) -> SessionScene:
    """Decodes a session into memory; no more frames than fit into ``memory_mb``, the same number for each camera.

    Raises InputError when not even one frame a camera fits, or a video cannot be read.
    """
    names = session.rig.names
    budget = memory_mb * 1e6 / len(names)
    with ThreadPoolExecutor(LOADERS) as pool:
        footage = list(pool.map(lambda n: _decode(session.videos[n], budget * (1 - BACKGROUND_SHARE)), names))
        backgrounds = list(pool.map(lambda n: _background(session, n, budget * BACKGROUND_SHARE), names))
    count = min(len(frames) for frames in footage)
    playback = Playback(count, session.fps, clock)
    views = {
        name: SessionView(playback, tuple(frames[:count]), tuple(_alike(frames[0], background)))
        for name, frames, background in zip(names, footage, backgrounds, strict=True)
    }
    lengths = []
    for name, frames in zip(names, footage, strict=True):
        with Video(session.videos[name]) as video:
            lengths.append(max(video.frame_count, len(frames)))  # a raw stream's header does not tell
    return SessionScene(playback, views, min(lengths))


def _background(session: Session, name: str, budget: float) -> list[Image]:
    path = session.backgrounds.get(name)
    if path is None:
        return []
    if path.suffix.lower() not in STILL_SUFFIXES:
        return _decode(path, budget)
    still = cv2.imread(str(path), cv2.IMREAD_COLOR)
    if still is None:
        raise InputError("is not a readable picture", where=str(path), remedy="Check the file.")
    return [np.ascontiguousarray(still[..., 1] if is_grey(still) else still, np.uint8)]


def _decode(path: Path, budget: float) -> list[Image]:
    """Return the first frames of a video, as many as fit into ``budget`` bytes; at least one."""
    frames = list[Image]()
    with Video(path) as video:
        for picture in video:
            if not frames:
                mono = is_grey(picture)
            elif frames[0].nbytes * (len(frames) + 1) > budget:
                break
            frames.append(np.ascontiguousarray(picture[..., 1] if mono else picture, np.uint8))
    if not frames:
        raise InputError("holds no frame that can be decoded", where=str(path), remedy="Check the file, or its codec.")
    if frames[0].nbytes > budget:
        size, remedy = f"one frame has {frames[0].nbytes / 1e6:.1f} MB", "Give the studio more memory (--memory)."
        raise InputError(size, where=str(path), remedy=remedy)
    return frames


def _alike(frame: Image, background: list[Image]) -> list[Image]:
    """Return the background in the same form (grey or colour) as the frames."""
    if not background or background[0].ndim == frame.ndim:
        return background
    code = cv2.COLOR_GRAY2BGR if frame.ndim == 3 else cv2.COLOR_BGR2GRAY
    return [np.asarray(cv2.cvtColor(picture, code), np.uint8) for picture in background]
