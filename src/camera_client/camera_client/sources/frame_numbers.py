"""Numbers the frames of sources that do not number them: a gap between two stamps is lost frames."""

from __future__ import annotations

import statistics
from collections import deque

from capture_rig.stamps import NS_PER_S

from ..frame_source import FrameStatistics

PERIODS = 31  # the frame period is the median of so many steps


class FrameNumbers:
    """Frame ids by stamps, ns: a step of n frame periods skips n - 1 ids, which ``counts`` takes for lost frames.

    One thread uses it.
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
