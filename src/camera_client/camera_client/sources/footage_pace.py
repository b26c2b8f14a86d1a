"""Pacing of footage: frames leave by a clock that all cameras share, or as soon as the consumers have caught up."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from typing import NamedTuple

from capture_rig.errors import InputError
from capture_rig.session import footage_stamp_ns

LEAD_NS = 1_000_000_000  # from a camera's offer of a clock to its first frame: the other cameras hear of it meanwhile
LATE_START_NS = 1_000_000_000
WINDOW = 3  # at rate 0: frames under way before an acknowledgement is awaited
PATIENCE_S = 20.0  # ... and for so long: a machine that starts a graph beside other work is as slow
KEPT_UP_NS = 250_000_000  # a frame this late still joins its set: half of what the hull server waits for footage
MAX_EPOCH_AHEAD_NS = 3600 * 1_000_000_000


class FootageClock(NamedTuple):
    """Frame k is stamped ``epoch_ns + k / fps`` and leaves at ``begin_ns + (k / fps) / rate`` of the system clock."""

    begin_ns: int
    epoch_ns: int


class SharedClock:
    """The clock by which all cameras of a graph play: of those that were offered, the one that began first.

    Each camera offers one when it starts, and hears the others'. Whoever comes late, or goes on after a pause, so finds
    the clock that runs already; cameras that offer at the same time come to the same one, whatever they hear first.
    """

    def __init__(self, announce: Callable[[FootageClock], object] = lambda clock: None) -> None:
        """``announce`` is called with every clock that comes to hold, one after the other."""
        self._announce, self._lock = announce, threading.Lock()
        self._agreed: FootageClock | None = None

    def offer(self, clock: FootageClock) -> FootageClock:
        """Take a clock into account, one's own or another camera's; returns the one that holds."""
        with self._lock:
            if self._agreed is None or clock < self._agreed:
                self._agreed = clock
                self._announce(clock)
            return self._agreed

    def forget(self) -> None:
        """Play no longer by any clock."""
        with self._lock:
            self._agreed = None


class Pace:
    """Decides when frame k may leave: here at once. ``timeouts``: frames that left although nobody acknowledged."""

    timeouts = 0

    def begin(self, clock: FootageClock, frame: int) -> None:
        """Begin, or go on, with this frame by this clock: at every start or resumption, and for another clock."""

    def wait(self, frame: int, timeout_s: float) -> bool:
        """Wait until frame k is due; False when that did not happen within ``timeout_s``."""
        return True

    def has_missed(self, frame: int) -> bool:
        """Whether frame k is too late to be of use, and is to be left out."""
        return False

    def acknowledge(self, stamp_ns: int) -> None:
        """Take note that every frame up to ``stamp_ns`` is processed."""


class WallClockPace(Pace):
    """Frame k leaves when its clock says so; what is too late to join its set is left out."""

    def __init__(
        self,
        fps: float,
        rate: float,
        now_ns: Callable[[], int] = time.time_ns,
        sleep: Callable[[float], None] = time.sleep,
    ) -> None:
        self._fps, self._rate, self._now_ns, self._sleep = fps, rate, now_ns, sleep
        self._begin_ns = 0

    def begin(self, clock: FootageClock, frame: int) -> None:
        self._begin_ns = clock.begin_ns

    def has_missed(self, frame: int) -> bool:
        return self._due_ns(frame) < self._now_ns() - KEPT_UP_NS

    def wait(self, frame: int, timeout_s: float) -> bool:
        left_s = (self._due_ns(frame) - self._now_ns()) / 1e9
        if left_s > 0:
            self._sleep(min(left_s, timeout_s))
        return left_s <= timeout_s

    def _due_ns(self, frame: int) -> int:
        return self._begin_ns + playing_ns(frame, self._fps, self._rate)


class AcknowledgedPace(Pace):
    """Frame k leaves once the consumers have acknowledged the stamp of frame k - window: none is ever outrun.

    When no acknowledgement and no frame has moved for ``patience_s``, one frame leaves all the same, and is counted.
    """

    def __init__(self, fps: float, window: int, patience_s: float, now_s: Callable[[], float] = time.monotonic) -> None:
        self._fps, self._window, self._patience_s, self._now_s = fps, window, patience_s, now_s
        self._changed = threading.Condition()
        self._acknowledged_ns = self._epoch_ns = self._first_frame = 0
        self._last_progress_s = now_s()

    def begin(self, clock: FootageClock, frame: int) -> None:
        with self._changed:
            self._epoch_ns, self._first_frame, self._last_progress_s = clock.epoch_ns, frame, self._now_s()
            self._acknowledged_ns = 0  # forget those of an earlier playing, perhaps with another epoch

    def acknowledge(self, stamp_ns: int) -> None:
        with self._changed:
            if stamp_ns > self._acknowledged_ns:
                self._acknowledged_ns, self._last_progress_s = stamp_ns, self._now_s()
                self._changed.notify_all()

    def wait(self, frame: int, timeout_s: float) -> bool:
        deadline_s = self._now_s() + timeout_s
        with self._changed:
            while not self._may_leave(frame):
                now_s = self._now_s()
                impatient_s = self._last_progress_s + self._patience_s
                if now_s >= impatient_s:
                    self.timeouts += 1
                    break
                if now_s >= deadline_s:
                    return False
                self._changed.wait(min(deadline_s, impatient_s) - now_s)
            self._last_progress_s = self._now_s()
            return True

    def _may_leave(self, frame: int) -> bool:
        awaited = frame - self._window
        return awaited < self._first_frame or self._acknowledged_ns >= footage_stamp_ns(
            self._epoch_ns, awaited, self._fps
        )


def playing_ns(frame: int, fps: float, rate: float) -> int:
    """Return how long after frame 0 frame k leaves, ns of the system clock."""
    return round(frame * 1e9 / (fps * rate))


def choose_epoch_ns(epoch_ns: int, now_ns: int) -> int:
    """Return the stamp of frame 0: as given, or for 0 a second from now. InputError for one more than an hour ahead."""
    if epoch_ns == 0:
        return now_ns + LEAD_NS
    if epoch_ns > now_ns + MAX_EPOCH_AHEAD_NS:
        raise InputError(
            f"footage.epoch_ns = {epoch_ns} lies {(epoch_ns - now_ns) / 1e9:.0f} s ahead of the system clock",
            remedy="Give nanoseconds since 1970, or 0: the cameras agree on one.",
        )
    return epoch_ns
