"""The contract of everything that delivers frames: a camera on the network, a video file, a folder of stills.

A :class:`FrameSource` gives :class:`Frame` after :class:`Frame`, and says what became of the others
(:class:`FrameStatistics`) and, of a live camera, how its connection stands (:class:`Connection`).
"""

from __future__ import annotations

import math
import statistics
import threading
from abc import ABC, abstractmethod
from collections import defaultdict, deque
from dataclasses import dataclass, field
from enum import Enum
from types import TracebackType

import numpy as np

from capture_rig.errors import InputError
from capture_rig.stamps import NS_PER_S

Image = np.ndarray  # (H, W) or (H, W, 3) uint8, BGR
Mask = np.ndarray  # (H, W) uint8, 0 or 255
# Thresholds: judgement, no measurement.
REPORT_PERIOD_S = 0.5  # between published figures
LASTING_S = 3.0  # after which a condition counts: a static thing, another picture, lost frames, no images
POLL_S = 0.05  # between polls of states without an event
RELEASE_S = 1.0  # a living device gives its resources back within this, a thread that served it ends


class SourceUnavailable(InputError):
    """The device does not answer, is controlled by another program, or went away: time may help, other settings not."""


class EndOfFootage(Exception):
    """Raised where the footage has no further frame. Live cameras never raise it."""


class UndecodableFrame(Exception):
    """Raised where one frame of the footage cannot be decoded; the next one may be fine."""


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

    shape : (H, W) or (H, W, 3), of every image, known once connected; halved : images are made at half of the size that
    the device sends. description : what this is, in words, for logs and the provenance of a background.
    """

    shape: tuple[int, ...] = ()
    halved = False
    description = "camera"

    def __init__(self) -> None:
        self._counters: dict[str, int] = defaultdict(int)
        self._statistics = FrameStatistics()
        self.warnings: tuple[str, ...] = ()  # of connect(): it works, but the user should know

    @property
    def counters(self) -> dict[str, int]:
        """What happened how often, by name."""
        return self._counters

    @property
    def statistics(self) -> FrameStatistics:
        """What became of every frame."""
        return self._statistics

    def count(self, name: str, by: int = 1) -> None:
        self._counters[name] += by

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
    def details(self) -> dict[str, str]:
        """What is known of the device once connected: serial number, exposure time."""
        return {}

    @property
    def lost(self) -> bool:
        """Whether a connected device does not answer any more, or another program has taken control of it."""
        return False

    @property
    def connection(self) -> Connection | None:
        """The connection to the device where it is watched, else None."""
        return None

    def acknowledge(self, stamp_ns: int) -> None:  # noqa: B027 (a live source has nothing to do)
        """Take note that consumers have processed every frame up to ``stamp_ns``; only paced footage listens."""

    def __enter__(self) -> FrameSource:
        self.connect()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()


# --- what became of the frames

COUNTS = ("expected", "delivered", "incomplete", "lost", "repeated")
# Thresholds: WRAP_16_BIT from GigE Vision; else judgement.
WRAP_16_BIT = 65535  # GVSP block ids of 16 bits run 1 ... 65535 and start again at 1


@dataclass
class FrameStatistics:
    """Counts frames by their ids; the rule expected = delivered + incomplete + lost always holds.

    ``expected`` follows from the ids alone (the last one minus the first one of each run), the three parts from what
    happened to each frame. A run begins at :meth:`restart`. Frames lost after the last one that arrived are not known
    yet, and are counted when the next one comes. ``repeated`` ids (a device that answers twice, or whose ids go back)
    belong to none of them.

    One thread adds; :meth:`snapshot` may be taken on another, and the rule holds in it too.
    """

    expected: int = 0
    delivered: int = 0
    incomplete: int = 0
    lost: int = 0
    repeated: int = 0
    _last: int | None = field(default=None, init=False, repr=False, compare=False)
    _lock: threading.Lock = field(default_factory=threading.Lock, init=False, repr=False, compare=False)

    def restart(self, first_id: int | None = None) -> None:
        """Begin a new run of ids, at ``first_id`` where the device says so (GVSP: 1), else wherever it begins."""
        self._last = None if first_id is None else first_id - 1

    def add(self, frame_id: int, complete: bool = True) -> None:
        """Take note of a frame that arrived, whole or not."""
        step = self._step_to(frame_id)
        with self._lock:
            if step <= 0:
                self.repeated += 1
                return
            self._last = frame_id
            self.expected += step
            self.lost += step - 1
            self.delivered += complete
            self.incomplete += not complete

    @property
    def arrived(self) -> int:
        """Frames of which anything came at all: what shows that the device is alive."""
        return self.delivered + self.incomplete + self.repeated

    def counts(self) -> dict[str, int]:
        """Return the five counts of this instant, by name."""
        with self._lock:
            return {name: getattr(self, name) for name in COUNTS}

    def snapshot(self) -> FrameStatistics:
        """Return a copy of the counts of this instant."""
        return FrameStatistics(**self.counts())

    def __add__(self, other: FrameStatistics) -> FrameStatistics:
        """Return the counts of both runs together."""
        a, b = self.counts(), other.counts()
        return FrameStatistics(**{name: a[name] + b[name] for name in COUNTS})

    def __sub__(self, earlier: FrameStatistics) -> FrameStatistics:
        """Return the counts since ``earlier`` of the same run."""
        a, b = self.counts(), earlier.counts()
        return FrameStatistics(**{name: a[name] - b[name] for name in COUNTS})

    def _step_to(self, frame_id: int) -> int:
        if self._last is None:
            return 1
        step = frame_id - self._last
        if max(frame_id, self._last) > WRAP_16_BIT:  # ids of 64 bits, which never wrap
            return step
        if step < -WRAP_16_BIT // 2:
            return step + WRAP_16_BIT
        return step - WRAP_16_BIT if step > WRAP_16_BIT // 2 else step  # a repetition from before the wrap


PERIODS = 31  # steps whose median is the frame period


class FrameNumbers:
    """Numbers the frames of sources that do not: by stamps, ns, a step of n frame periods skips n - 1 ids.

    ``counts`` takes those for lost frames. One thread uses it.
    """

    def __init__(self, counts: FrameStatistics) -> None:
        self._counts = counts
        self._steps_ns: deque[int] = deque(maxlen=PERIODS)
        self._last_ns = self._number = 0

    def restart(self) -> None:
        """Begin a new run: what passed since the last frame is no loss."""
        self._last_ns = 0
        self._counts.restart()

    def add(self, stamp_ns: int) -> int | None:
        """Count the frame taken at ``stamp_ns`` and return its id; None, and counted as repeated, where time did not go
        on since the frame before."""
        step_ns = stamp_ns - self._last_ns
        if self._last_ns and step_ns <= 0:
            self._counts.add(self._number)
            return None
        if self._last_ns:
            period_ns = statistics.median(self._steps_ns) if self._steps_ns else step_ns
            self._steps_ns.append(step_ns)
            self._number += max(1, round(step_ns / period_ns))
        else:
            self._number += 1
        self._last_ns = stamp_ns
        self._counts.add(self._number)
        return self._number

    def details(self) -> dict[str, str]:
        """Return rate, Hz, and jitter, ms (standard deviation of the period), as texts; nothing before two frames."""
        if not self._steps_ns:
            return {}
        rate_hz, jitter_ms = NS_PER_S / statistics.median(self._steps_ns), statistics.pstdev(self._steps_ns) / 1e6
        return {"frame_rate": f"{rate_hz:.2f}", "jitter_ms": f"{jitter_ms:.2f}"}


# --- the connection to a live camera: its state and its outages


class ConnectionState(Enum):
    """Where the connection to the device stands."""

    CLOSED = "closed"
    CONNECTED = "connected"
    STREAMING = "streaming"
    CONNECTING = "connecting"
    WAITING = "waiting"
    STALLED = "stalled"
    CONTROL_LOST = "control lost"

    @property
    def away(self) -> bool:
        """Whether nothing comes, and it should."""
        return self not in (ConnectionState.CLOSED, ConnectionState.CONNECTED, ConnectionState.STREAMING)


@dataclass(frozen=True)
class Connection:
    """The connection at one instant, for a report.

    ``reason`` says why nothing comes; ``refused`` that waiting will not help (the settings do not fit the device);
    ``next_try_s`` until the next attempt. ``down_s`` is how long nothing has come by now, ``downtime_s`` the sum since
    the source was made, ``last_outage_s`` how long the last outage was, from frame to frame.
    """

    state: ConnectionState
    reason: str = ""
    refused: bool = False
    next_try_s: float = 0.0
    down_s: float = 0.0
    downtime_s: float = 0.0
    last_outage_s: float | None = None


class Downtime:
    """Adds up the time in which frames should have come and did not. All times in seconds of one monotonic clock."""

    def __init__(self) -> None:
        self._sum_s, self._since_s = 0.0, math.inf
        self.last_outage_s: float | None = None

    def begin(self, since_s: float) -> None:
        """Begin an outage: nothing has come since ``since_s``. One that goes on stays one."""
        self._since_s = min(self._since_s, since_s)

    def end(self, now_s: float, delivered: bool) -> None:
        """End the outage, if there is one: a frame came (``delivered``), or the source was stopped."""
        if delivered and self._since_s < math.inf:
            self.last_outage_s = self.present_s(now_s)
        self._sum_s, self._since_s = self.sum_s(now_s), math.inf

    def present_s(self, now_s: float) -> float:
        """Return how long the present outage has lasted; 0 when there is none."""
        return max(now_s - self._since_s, 0.0)

    def sum_s(self, now_s: float) -> float:
        """Return the whole downtime, the present outage included."""
        return self._sum_s + self.present_s(now_s)
