"""The contract of everything that delivers frames: a camera on the network, a video file, a folder of stills."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from types import TracebackType

import numpy as np

Image = np.ndarray  # (H, W) or (H, W, 3) uint8, BGR
Mask = np.ndarray  # (H, W) uint8, 0 or 255

WRAP_16_BIT = 65535  # GVSP block ids of 16 bits run 1 ... 65535 and start again at 1


class EndOfFootage(Exception):
    """The footage has no further frame. Live cameras never raise it."""


class UndecodableFrame(Exception):
    """One frame of the footage cannot be decoded; the next one may be fine."""


@dataclass(frozen=True, eq=False)
class Frame:
    """One image as it left its source.

    ``image`` (H, W) or (H, W, 3) uint8, BGR; ``stamp_ns`` the capture time; ``frame_id`` counts the source's frames,
    so that a gap shows a loss; ``clock`` says in words whose clock the stamp is.
    """

    image: Image
    stamp_ns: int
    frame_id: int
    clock: str


class FrameSource(ABC):
    """A device or file that delivers frames; connect, start, stop and close follow the thesis's verbs.

    connect() is all or nothing: after an error nothing is left open. start() after stop() goes on. As a context
    manager a source connects on entry and closes on exit. ``counters`` grows by name as things happen.
    """

    def __init__(self) -> None:
        self.counters: dict[str, int] = {}
        self.warnings: tuple[str, ...] = ()  # of connect(): it works, but the user should know

    def count(self, name: str, by: int = 1) -> None:
        self.counters[name] = self.counters.get(name, 0) + by

    @abstractmethod
    def connect(self) -> None:
        """Open the device or file. Raises InputError when it is absent, in use or unusable."""

    @abstractmethod
    def start(self) -> None:
        """Begin to deliver frames. Raises InputError when the source is not connected or refuses."""

    @abstractmethod
    def read(self, timeout_s: float) -> Frame | None:
        """The next frame, or None when none came within ``timeout_s``. Raises EndOfFootage after the last one."""

    @abstractmethod
    def stop(self) -> None:
        """Stop delivering; a stopped source may be started again. Does nothing when not started."""

    @abstractmethod
    def close(self) -> None:
        """Give the device or file back. Does nothing when not connected."""

    @property
    @abstractmethod
    def shape(self) -> tuple[int, ...]:
        """(H, W) or (H, W, 3): the shape of every image, known once connected."""

    @property
    @abstractmethod
    def description(self) -> str:
        """What this is, in words, for logs and the provenance of a background."""

    @property
    def details(self) -> dict[str, str]:
        """What is known of the device once connected: serial number, exposure time."""
        return {}

    @property
    def lost(self) -> bool:
        """True once a connected device has stopped to answer, or somebody else has taken it."""
        return False

    def acknowledge(self, stamp_ns: int) -> None:  # noqa: B027 (a live source has nothing to do)
        """Consumers have worked off every frame up to ``stamp_ns``; only paced footage listens."""

    def __enter__(self) -> FrameSource:
        self.connect()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()


class GapCounter:
    """Counts frames that never arrived, from the frame ids of those that did (16-bit ids wrap past 0)."""

    def __init__(self) -> None:
        self._last: int | None = None
        self.missing = 0

    def add(self, frame_id: int) -> int:
        """Take note of ``frame_id``; returns how many ids were skipped just before it."""
        skipped = 0
        if self._last is not None:
            step = frame_id - self._last
            if step < -WRAP_16_BIT // 2:
                step += WRAP_16_BIT
            skipped = max(step - 1, 0)
        self._last = frame_id
        self.missing += skipped
        return skipped
