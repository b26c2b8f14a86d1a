"""Time by the frames' capture stamps, so that the same footage gives the same results at every playing speed."""

from __future__ import annotations

NS = 1e-9


class StampThrottle:
    """Picks about one frame a period by the frames' stamps, and says how much time each one stands for."""

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
