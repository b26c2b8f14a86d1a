"""How busy the stages behind the frame sets are: the carver, the slicer, the tracker with its filter."""

from __future__ import annotations

from collections import deque

SPAN_NS = 500_000_000


class BusyStages:
    """The share of the last half second that each stage was at work; times are monotonic nanoseconds."""

    def __init__(self) -> None:
        self._work: deque[tuple[int, int, int, int]] = deque()  # when, and what each stage took
        self._handed_over: dict[int, int] = {}  # sets that the tracker has not answered: stamp, since when it has them
        self._answered_ns = 0

    def worked(self, carver_ns: int, slicer_ns: int, now_ns: int) -> None:
        """Take note of what carver and slicer took for a set."""
        self._work.append((now_ns, carver_ns, slicer_ns, 0))

    def hand_over(self, stamp_ns: int, now_ns: int) -> None:
        """Take note that the tracker has a set from now on."""
        self._handed_over[stamp_ns] = now_ns

    def answered(self, stamp_ns: int, now_ns: int) -> None:
        """Take note of the tracker's answer; it was at work since it had the set and had answered the one before."""
        given_ns = self._handed_over.pop(stamp_ns, None)
        if given_ns is not None:
            self._work.append((now_ns, 0, 0, now_ns - max(given_ns, self._answered_ns)))
        self._handed_over = {stamp: when for stamp, when in self._handed_over.items() if stamp > stamp_ns}
        self._answered_ns = now_ns

    def share(self, now_ns: int) -> float:
        """Return the share of the busiest stage."""
        while self._work and now_ns - self._work[0][0] > SPAN_NS:
            self._work.popleft()
        for stamp_ns in [stamp for stamp, when in self._handed_over.items() if now_ns - when > 2 * SPAN_NS]:
            del self._handed_over[stamp_ns]
        return max((sum(stage) / SPAN_NS for stage in list(zip(*self._work, strict=True))[1:]), default=0.0)
