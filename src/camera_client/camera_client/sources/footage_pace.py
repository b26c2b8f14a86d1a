"""Pacing of footage: frames leave by the wall clock, or as soon as the consumers have caught up; the epoch."""

from __future__ import annotations

import threading
import time
from abc import ABC, abstractmethod
from collections.abc import Callable

from capture_rig.errors import InputError
from capture_rig.session import footage_stamp_ns

EPOCH_STEP_NS = 5_000_000_000
LATE_START_NS = 1_000_000_000
KEPT_UP_NS = 250_000_000  # a frame this late still joins its set: half of what the hull server waits for footage
MAX_EPOCH_AHEAD_NS = 3600 * 1_000_000_000


class Pace(ABC):
    """Decides when frame k may leave. ``begin`` is called at every start or resumption with the next frame's k."""

    @abstractmethod
    def begin(self, epoch_ns: int, frame: int) -> None:
        """Begin with this frame; ``epoch_ns`` : the stamp of frame 0."""

    @abstractmethod
    def wait(self, frame: int, timeout_s: float) -> bool:
        """Wait until frame k is due; False when that did not happen within ``timeout_s``."""

    def has_missed(self, frame: int) -> bool:
        """Whether frame k is too late to be of use, and is to be left out."""
        return False

    def acknowledge(self, stamp_ns: int) -> None:  # noqa: B027
        """Take note that every frame up to ``stamp_ns`` is processed."""

    @property
    def timeouts(self) -> int:
        """How often a frame left although no acknowledgement came."""
        return 0


class WallClockPace(Pace):
    """Frame k leaves at ``epoch + (k / fps) / rate`` of the system clock.

    A start more than a second after that (a late start, or the resumption after a pause) goes on from now instead of
    hurrying through what was missed; with ``keep_up`` what was missed is left out.
    """

    def __init__(
        self,
        fps: float,
        rate: float,
        now_ns: Callable[[], int] = time.time_ns,
        sleep: Callable[[float], None] = time.sleep,
        keep_up: bool = False,
    ) -> None:
        self._fps, self._rate, self._now_ns, self._sleep, self._keep_up = fps, rate, now_ns, sleep, keep_up
        self._first_frame, self._anchor_ns = 0, 0

    def begin(self, epoch_ns: int, frame: int) -> None:
        now, due = self._now_ns(), epoch_ns + round(frame * 1e9 / (self._fps * self._rate))
        self._first_frame = frame
        self._anchor_ns = due if self._keep_up or due >= now - LATE_START_NS else now

    def has_missed(self, frame: int) -> bool:
        return self._keep_up and self._due_ns(frame) < self._now_ns() - KEPT_UP_NS

    def wait(self, frame: int, timeout_s: float) -> bool:
        left_s = (self._due_ns(frame) - self._now_ns()) / 1e9
        if left_s > 0:
            self._sleep(min(left_s, timeout_s))
        return left_s <= timeout_s

    def _due_ns(self, frame: int) -> int:
        return self._anchor_ns + round((frame - self._first_frame) * 1e9 / (self._fps * self._rate))


class AcknowledgedPace(Pace):
    """Frame k leaves once the consumers have acknowledged the stamp of frame k - window: none is ever outrun.

    When no acknowledgement and no frame has moved for ``patience_s``, one frame leaves all the same, and is counted.
    """

    def __init__(self, fps: float, window: int, patience_s: float, now_s: Callable[[], float] = time.monotonic) -> None:
        self._fps, self._window, self._patience_s, self._now_s = fps, window, patience_s, now_s
        self._changed = threading.Condition()
        self._acknowledged_ns: int | None = None
        self._epoch_ns, self._last_progress_s, self._timeouts = 0, now_s(), 0
        self._first_frame = 0

    def begin(self, epoch_ns: int, frame: int) -> None:
        with self._changed:
            self._epoch_ns, self._first_frame, self._last_progress_s = epoch_ns, frame, self._now_s()
            self._acknowledged_ns = None  # of an earlier playing, perhaps with another epoch

    def acknowledge(self, stamp_ns: int) -> None:
        with self._changed:
            if self._acknowledged_ns is None or stamp_ns > self._acknowledged_ns:
                self._acknowledged_ns, self._last_progress_s = stamp_ns, self._now_s()
                self._changed.notify_all()

    @property
    def timeouts(self) -> int:
        return self._timeouts

    def wait(self, frame: int, timeout_s: float) -> bool:
        deadline_s = self._now_s() + timeout_s
        with self._changed:
            while not self._may_leave(frame):
                now_s = self._now_s()
                impatient_s = self._last_progress_s + self._patience_s
                if now_s >= impatient_s:
                    self._timeouts += 1
                    break
                if now_s >= deadline_s:
                    return False
                self._changed.wait(min(deadline_s, impatient_s) - now_s)
            self._last_progress_s = self._now_s()
            return True

    def _may_leave(self, frame: int) -> bool:
        awaited = frame - self._window
        if awaited < self._first_frame:
            return True
        if self._acknowledged_ns is None:
            return False
        return self._acknowledged_ns >= footage_stamp_ns(self._epoch_ns, awaited, self._fps)


def choose_epoch_ns(epoch_ns: int, now_ns: int) -> int:
    """Return the stamp of frame 0: as given, or for 0 the next whole multiple of 5 s of the system clock.

    Camera PCs whose clocks agree (NTP, PTP) and that start within the same 5 s thus play in step unasked.
    Raises InputError for an epoch more than an hour ahead.
    """
    if epoch_ns == 0:
        return (now_ns // EPOCH_STEP_NS + 1) * EPOCH_STEP_NS
    if epoch_ns > now_ns + MAX_EPOCH_AHEAD_NS:
        raise InputError(
            f"footage.epoch_ns = {epoch_ns} lies {(epoch_ns - now_ns) / 1e9:.0f} s ahead of the system clock",
            remedy="Give nanoseconds since 1970, or 0 for the next whole multiple of 5 s.",
        )
    return epoch_ns
