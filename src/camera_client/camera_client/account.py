"""How many frames a source should have delivered, and what became of each of them."""

from __future__ import annotations

import threading
from dataclasses import dataclass, field

WRAP_16_BIT = 65535  # GVSP block ids of 16 bits run 1 ... 65535 and start again at 1


@dataclass
class FrameAccount:
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
    _last: int | None = field(default=None, repr=False, compare=False)
    _lock: threading.Lock = field(default_factory=threading.Lock, repr=False, compare=False)

    def restart(self, first_id: int | None = None) -> None:
        """A new run of ids begins: at ``first_id`` where the device says so (GVSP: 1), else wherever it begins."""
        self._last = None if first_id is None else first_id - 1

    def add(self, frame_id: int, complete: bool = True) -> int:
        """Take note of a frame that arrived, whole or not; returns how many ids were skipped just before it."""
        step = self._step_to(frame_id)
        with self._lock:
            if step <= 0:
                self.repeated += 1
                return 0
            self._last = frame_id
            self.expected += step
            self.lost += step - 1
            self.delivered += complete
            self.incomplete += not complete
        return step - 1

    @property
    def arrived(self) -> int:
        """Frames of which anything came at all: what shows that the device is alive."""
        return self.delivered + self.incomplete + self.repeated

    def snapshot(self) -> FrameAccount:
        """The counts of this instant, which nobody changes any more."""
        with self._lock:
            return FrameAccount(self.expected, self.delivered, self.incomplete, self.lost, self.repeated)

    def __add__(self, other: FrameAccount) -> FrameAccount:
        """The counts of both runs together."""
        a, b = self.snapshot(), other.snapshot()
        return FrameAccount(
            a.expected + b.expected,
            a.delivered + b.delivered,
            a.incomplete + b.incomplete,
            a.lost + b.lost,
            a.repeated + b.repeated,
        )

    def _step_to(self, frame_id: int) -> int:
        if self._last is None:
            return 1
        step = frame_id - self._last
        if max(frame_id, self._last) > WRAP_16_BIT:  # ids of 64 bits, which never wrap
            return step
        if step < -WRAP_16_BIT // 2:
            return step + WRAP_16_BIT
        return step - WRAP_16_BIT if step > WRAP_16_BIT // 2 else step  # a repetition from before the wrap
