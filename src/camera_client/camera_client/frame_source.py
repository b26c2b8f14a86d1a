"""The contract of everything that delivers frames: a camera on the network, a video file, a folder of stills."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from types import TracebackType

import numpy as np

from capture_rig.errors import InputError

from .account import FrameAccount
from .link import Link

Image = np.ndarray  # (H, W) or (H, W, 3) uint8, BGR
Mask = np.ndarray  # (H, W) uint8, 0 or 255


class SourceUnavailable(InputError):
    """The device does not answer, is held by somebody else, or went away: other settings will not help, time may."""


class EndOfFootage(Exception):
    """The footage has no further frame. Live cameras never raise it."""


class UndecodableFrame(Exception):
    """One frame of the footage cannot be decoded; the next one may be fine."""


@dataclass(frozen=True, eq=False)
class Frame:
    """One image as it left its source.

    ``image`` (H, W) or (H, W, 3) uint8, BGR; ``stamp_ns`` the capture time; ``frame_id`` counts the source's frames,
    so that a gap shows a loss; ``clock`` says in words whose clock the stamp is, and ``uncertainty_ns`` how far it may
    be from the truth on the system's clock (0: exact by definition, as footage is).
    """

    image: Image
    stamp_ns: int
    frame_id: int
    clock: str
    uncertainty_ns: int = 0


class FrameSource(ABC):
    """A device or file that delivers frames; connect, start, stop and close follow the thesis's verbs.

    connect() is all or nothing: after an error nothing is left open. start() after stop() goes on. As a context
    manager a source connects on entry and closes on exit.
    """

    def __init__(self) -> None:
        self._counters: dict[str, int] = {}
        self._account = FrameAccount()
        self.warnings: tuple[str, ...] = ()  # of connect(): it works, but the user should know

    @property
    def counters(self) -> dict[str, int]:
        """What happened how often, by name."""
        return self._counters

    @property
    def account(self) -> FrameAccount:
        """What became of every frame."""
        return self._account

    def count(self, name: str, by: int = 1) -> None:
        self.counters[name] = self.counters.get(name, 0) + by

    @abstractmethod
    def connect(self) -> None:
        """Open the device or file.

        Raises SourceUnavailable when it is absent or in use, and InputError when it cannot do what the settings ask.
        """

    @abstractmethod
    def start(self) -> None:
        """Begin to deliver frames. Raises InputError when not connected, SourceUnavailable when the device refuses."""

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

    @property
    def link(self) -> Link | None:
        """The connection to the device where it is watched, else None."""
        return None

    def acknowledge(self, stamp_ns: int) -> None:  # noqa: B027 (a live source has nothing to do)
        """Consumers have worked off every frame up to ``stamp_ns``; only paced footage listens."""

    def __enter__(self) -> FrameSource:
        self.connect()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()
