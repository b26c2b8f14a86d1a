"""What a simulated camera sees at an instant: the interface, a test pattern, a session's footage decoded into memory,
and the playback that a rig shares."""

from __future__ import annotations

from collections.abc import Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path
from typing import Protocol

import cv2
import numpy as np

from capture_rig.errors import InputError
from capture_rig.rig import Rig
from capture_rig.session import STILL_SUFFIXES, Session
from capture_rig.stamps import UTC, CaptureClock
from capture_rig.video import Video, is_grey

from ..rendering.camera import Image

SECOND_NS = 1_000_000_000
PLAY_AFTER_NS = 1_500_000_000
"""Delay (of UTC) from the request to the playback, in which the client can get ready."""


class CameraScene(Protocol):
    """The view of one camera."""

    @property
    def shape(self) -> tuple[int, ...]:
        """(H, W) of grey pictures, (H, W, 3) of coloured ones (BGR)."""

    def image(self, instant_ns: int) -> Image:
        """Returns the picture at an instant (studio's clock, ns), uint8, not to be changed later. Must be quick."""


@dataclass(eq=False)
class StudioScene:
    """The scene of a rig's cameras: their ``views`` by name, the ``playback`` behind them (None: a test pattern).

    can_be_empty : the empty room can be shown. notes : to be printed.
    """

    rig: Rig
    views: Mapping[str, CameraScene]
    playback: Playback | None = None
    can_be_empty: bool = False
    notes: tuple[str, ...] = ()

    def start(self) -> None:
        """Begins to render, where that is done live."""

    def close(self) -> None:
        """Ends that."""


class PatternScene:
    """A test pattern that carries its own number and instant as black and white squares; stripes move below them.

    Pictures are numbered from 0 in the order in which they are taken.
    """

    SQUARE_PX = 4
    PER_ROW = 32
    ROWS = 3  # 32 bits of number, 64 of time

    def __init__(self, width: int = 640, height: int = 480, colour: bool = False) -> None:
        self._width, self._height, self._colour = width, height, colour
        y, x = np.mgrid[: height + 256, :width]
        self._stripes = ((x + y) % 256).astype(np.uint8)
        self.number = 0

    @property
    def shape(self) -> tuple[int, ...]:
        return (self._height, self._width, 3) if self._colour else (self._height, self._width)

    def image(self, instant_ns: int) -> Image:
        picture = self.picture(self.number, instant_ns)
        self.number += 1
        return picture

    def picture(self, number: int, instant_ns: int) -> Image:
        """Draws the picture with this number, taken at this instant."""
        shift = number % 256
        picture = self._stripes[shift : shift + self._height].copy()
        bits = [(number % (1 << 32)) >> bit & 1 for bit in range(32)] + [instant_ns >> bit & 1 for bit in range(64)]
        squares = (255 * np.array(bits, np.uint8)).reshape(self.ROWS, self.PER_ROW)
        block = np.kron(squares, np.ones((self.SQUARE_PX, self.SQUARE_PX), np.uint8))
        if not self._colour:
            picture[: block.shape[0], : block.shape[1]] = block
            return picture
        coloured = np.stack([picture, np.roll(picture, 64, 1), 255 - picture], axis=2)
        coloured[: block.shape[0], : block.shape[1]] = block[..., None]
        return coloured

    @classmethod
    def read(cls, picture: Image) -> tuple[int, int]:
        """Reads number and instant (UTC, ns) from a picture, in any format that keeps black from white."""
        grey = picture if picture.ndim == 2 else picture[..., 1]
        middle = cls.SQUARE_PX // 2
        squares = grey[middle :: cls.SQUARE_PX, middle :: cls.SQUARE_PX][: cls.ROWS, : cls.PER_ROW]
        bits = [int(value > 127) for value in squares.reshape(-1)]
        return sum(bit << i for i, bit in enumerate(bits[:32])), sum(bit << i for i, bit in enumerate(bits[32:]))


class Playback:
    """Which of ``frames`` frames at ``fps`` is seen at an instant, the same for every camera.

    Until play() is called it runs for ever, from frame 0 at the start of 1970. ``occupied``: whether somebody is in the
    room, which can be set meanwhile.
    clock : of the instants; UTC, unless in slow motion.
    """

    def __init__(self, frames: int, fps: float, clock: CaptureClock = UTC) -> None:
        self.clock = clock
        self.frames, self._fps = frames, Fraction(fps).limit_denominator(1000)
        self.epoch_ns, self.loop, self._held = 0, True, False
        self.occupied = True

    @property
    def fps(self) -> float:
        return float(self._fps)

    def play(self, at_ns: int | None = None, loop: bool = True) -> int:
        """Restarts: frame 0 at ``at_ns`` (None: a second and a half of UTC from now), which is returned.

        It is rounded to a whole multiple of the frame period, where free-running cameras expose. Before, frame 0 is
        seen; without ``loop`` the last frame stays.
        """
        if at_ns is None:
            at_ns = self.clock.now_ns() + round(PLAY_AFTER_NS * self.clock.speed)
        period_ns = SECOND_NS / self._fps
        self.epoch_ns, self.loop, self._held = round(round(at_ns / period_ns) * period_ns), loop, False
        return self.epoch_ns

    def hold(self) -> None:
        self._held = True

    def frame_at(self, instant_ns: int) -> int:
        if self._held:
            return 0
        frame = (instant_ns - self.epoch_ns) * self._fps.numerator // (self._fps.denominator * SECOND_NS)
        if self.loop and frame >= 0:
            return frame % self.frames
        return min(max(frame, 0), self.frames - 1)


# --- The footage of a session.

BACKGROUND_SHARE = 0.25
"""Of the memory, at most, for the empty room."""
LOADERS = 2


@dataclass(frozen=True, eq=False)
class SessionView:
    """One camera's pictures of a session, all in memory: F frames, and any number of the empty room."""

    playback: Playback
    frames: tuple[Image, ...]
    background: tuple[Image, ...]

    @property
    def shape(self) -> tuple[int, ...]:
        return self.frames[0].shape

    def image(self, instant_ns: int) -> Image:
        if self.background and not self.playback.occupied:
            number = int(instant_ns * self.playback.fps // 1_000_000_000)
            return self.background[number % len(self.background)]
        return self.frames[self.playback.frame_at(instant_ns)]


def load_session_scene(session: Session, memory_mb: float = 800.0, clock: CaptureClock = UTC) -> StudioScene:
    """Decodes a session into memory; no more frames than fit into ``memory_mb``, the same number for each camera.

    A note tells of frames that do not fit. Raises InputError when not even one frame a camera fits, or a video cannot
    be read.
    """
    names = session.rig.names
    budget = memory_mb * 1e6 / len(names)
    with ThreadPoolExecutor(LOADERS) as pool:
        footage = list(pool.map(lambda n: _decode(session.videos[n], budget * (1 - BACKGROUND_SHARE)), names))
        grey = {name: frames[0].ndim == 2 for name, (frames, _) in zip(names, footage, strict=True)}
        rooms = list(pool.map(lambda n: _background(session, n, budget * BACKGROUND_SHARE, grey[n]), names))
    count = min(len(frames) for frames, _ in footage)
    shortest = min(length for _, length in footage)
    playback = Playback(count, session.fps, clock)
    views = {
        name: SessionView(playback, tuple(frames[:count]), tuple(room))
        for name, (frames, _), room in zip(names, footage, rooms, strict=True)
    }
    cut = f"only the first {count} of {shortest} frames fit into {memory_mb:g} MB and are shown (--memory)"
    can_be_empty = all(view.background for view in views.values())
    return StudioScene(session.rig, views, playback, can_be_empty, (cut,) if count < shortest else ())


def _background(session: Session, name: str, budget: float, grey: bool) -> list[Image]:
    path = session.backgrounds.get(name)
    if path is None:
        return []
    if path.suffix.lower() not in STILL_SUFFIXES:
        return _decode(path, budget, grey)[0]
    still = cv2.imread(str(path), cv2.IMREAD_COLOR)
    if still is None:
        raise InputError("is not a readable picture", where=str(path), remedy="Check the file.")
    return [np.ascontiguousarray(still[..., 1] if grey else still, np.uint8)]


def _decode(path: Path, budget: float, grey: bool | None = None) -> tuple[list[Image], int]:
    """Return the first frames of a video, as many as fit into ``budget`` bytes, at least one; and its frame count.

    grey : whether colour is left out; None: where the first frame has none.
    """
    frames = list[Image]()
    with Video(path) as video:
        for picture in video:
            grey = is_grey(picture) if grey is None else grey
            if frames and frames[0].nbytes * (len(frames) + 1) > budget:
                break
            frames.append(np.ascontiguousarray(picture[..., 1] if grey else picture, np.uint8))
    if not frames:
        raise InputError("holds no frame that can be decoded", where=str(path), remedy="Check the file, or its codec.")
    if frames[0].nbytes > budget:
        size, remedy = f"one frame has {frames[0].nbytes / 1e6:.1f} MB", "Give the studio more memory (--memory)."
        raise InputError(size, where=str(path), remedy=remedy)
    return frames, max(video.frame_count, len(frames))  # a raw stream's header has no count
