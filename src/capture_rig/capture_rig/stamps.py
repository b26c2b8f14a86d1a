"""Time by the frames' capture stamps, so that the same footage gives the same results at every playing speed."""

from __future__ import annotations

import time
from fractions import Fraction

NS_PER_S = 1_000_000_000
NS = 1.0 / NS_PER_S
SLOW_ORIGIN_NS = 1_767_225_600_000_000_000  # 2026-01-01 00:00 UTC: a slow capture clock agrees with UTC then


class CaptureClock:
    """The clock that stamps frames: UTC, or in slow motion one that runs at ``speed`` (0 to 1) of it. All times in ns.

    Cameras in slow motion are simulated. The speed determines the time in every process, without messages.
    """

    def __init__(self, speed: float = 1.0) -> None:
        self.speed = Fraction(speed).limit_denominator(1000)

    def now_ns(self) -> int:
        """Return the time that it shows."""
        return self.at_utc(time.time_ns())

    def at_utc(self, utc_ns: int) -> int:
        """Return its time at an instant of UTC."""
        if self.speed == 1:
            return utc_ns
        return SLOW_ORIGIN_NS + (utc_ns - SLOW_ORIGIN_NS) * self.speed.numerator // self.speed.denominator

    def wait_ns(self, until_ns: int) -> int:
        """Return the UTC time to wait until it shows a time; 0 for a time that has passed."""
        ahead_ns = max(until_ns - self.now_ns(), 0)
        return -(-ahead_ns * self.speed.denominator // self.speed.numerator)


UTC = CaptureClock()


class StampThrottle:
    """Picks about one frame a period by the frames' stamps, with the time that each one stands for."""

    def __init__(self, period_s: float, *, early_share: float = 0.0, longest_s: float | None = None) -> None:
        """``early_share``: a frame may come early by this share of the period, for stamps jitter. ``longest_s``: a gap
        between frames counts as this at most; by default two periods."""
        self._period_s, self._least_s = period_s, (1 - early_share) * period_s
        self._longest_s = 2 * period_s if longest_s is None else longest_s
        self._last_ns: int | None = None

    def is_due(self, stamp_ns: int) -> bool:
        """Whether :meth:`step_s` would pick a frame of ``stamp_ns``."""
        if self._last_ns is None or stamp_ns < self._last_ns:
            return True
        return (stamp_ns - self._last_ns) * NS >= self._least_s

    def step_s(self, stamp_ns: int) -> float:
        """Seconds that a frame of ``stamp_ns`` stands for if it is due, else 0.

        The first frame, and the first after stamps went back, stand for one period.
        """
        if self._last_ns is None or stamp_ns < self._last_ns:
            self._last_ns = stamp_ns
            return self._period_s
        elapsed_s = (stamp_ns - self._last_ns) * NS
        if not self.is_due(stamp_ns):
            return 0.0
        self._last_ns = stamp_ns
        return min(elapsed_s, self._longest_s)
