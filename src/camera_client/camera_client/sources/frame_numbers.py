"""Numbers the frames of sources that do not number them: a gap between two stamps is lost frames."""

from __future__ import annotations

import statistics
from collections import deque

NS_PER_S = 1_000_000_000
PERIODS = 31  # the frame period is the median of so many steps


class FrameNumbers:
    """Frame ids by stamps: a step of n frame periods skips n - 1 ids. One thread uses it."""

    def __init__(self) -> None:
        self._steps_ns: deque[int] = deque(maxlen=PERIODS)
        self._last_ns = self._number = 0

    def restart(self) -> None:
        """Begin a new run: what passed since the last frame is no loss."""
        self._last_ns = 0

    def add(self, stamp_ns: int) -> int:
        """Return the id of the frame taken at ``stamp_ns``; the last one's where time did not go on."""
        step_ns = stamp_ns - self._last_ns
        if not self._last_ns:
            self._number += 1
        elif step_ns > 0:
            period_ns = statistics.median(self._steps_ns) if self._steps_ns else step_ns
            self._steps_ns.append(step_ns)
            self._number += max(1, round(step_ns / period_ns))
        if not self._last_ns or step_ns > 0:
            self._last_ns = stamp_ns
        return self._number

    def details(self) -> dict[str, str]:
        """Return rate and jitter (standard deviation of the frame period) in words; nothing before the second frame."""
        if not self._steps_ns:
            return {}
        rate_hz, jitter_ms = NS_PER_S / statistics.median(self._steps_ns), statistics.pstdev(self._steps_ns) / 1e6
        return {"frame_rate": f"{rate_hz:.2f}", "jitter_ms": f"{jitter_ms:.2f}"}
