"""Latency of a frame set at five points: exposure, received, hull published, fitted, joint state published."""

from __future__ import annotations

from collections import OrderedDict
from dataclasses import dataclass
from typing import TypeVar

T = TypeVar("T")

SETS_KEPT = 64  # that wait for their other half: more than all queues of the graph hold together

POINTS = ("received", "hull", "fitted", "published")
"""The points after the exposure, in their order."""


@dataclass(frozen=True)
class HullTimes:
    """When a set was closed and its hull left the hull server; nanoseconds of the system's clock, as its stamp."""

    stamp_ns: int
    received_ns: int
    hull_ns: int


@dataclass(frozen=True)
class SetLatency:
    """When a set was exposed (``stamp_ns``), closed, carved, fitted, and its joint state published."""

    stamp_ns: int
    received_ns: int
    hull_ns: int
    fitted_ns: int
    published_ns: int

    def ages_ms(self) -> dict[str, float]:
        """Return the set's age at each of :data:`POINTS`, since its exposure."""
        return {point: (getattr(self, f"{point}_ns") - self.stamp_ns) / 1e6 for point in POINTS}


class LatencyMatcher:
    """Joins what the hull server says of a set with what the filter knows, whichever comes first."""

    def __init__(self) -> None:
        self._hulls: OrderedDict[int, HullTimes] = OrderedDict()
        self._answers: OrderedDict[int, tuple[int, int]] = OrderedDict()

    def forget(self) -> None:
        """Drop the halves that wait: stamps begin anew, and may be those of earlier sets."""
        self._hulls.clear()
        self._answers.clear()

    def left_hull(self, times: HullTimes) -> SetLatency | None:
        """Take the hull server's times of a set; returns it once both halves are known."""
        _keep(self._hulls, times.stamp_ns, times)
        return self._joined(times.stamp_ns)

    def answered(self, stamp_ns: int, fitted_ns: int, published_ns: int) -> SetLatency | None:
        """Take when the filter had a set's fit and had published its joint state; as :meth:`left_hull`."""
        _keep(self._answers, stamp_ns, (fitted_ns, published_ns))
        return self._joined(stamp_ns)

    def _joined(self, stamp_ns: int) -> SetLatency | None:
        if stamp_ns not in self._hulls or stamp_ns not in self._answers:
            return None
        times, answer = self._hulls.pop(stamp_ns), self._answers.pop(stamp_ns)
        return SetLatency(stamp_ns, times.received_ns, times.hull_ns, *answer)


def _keep(book: OrderedDict[int, T], stamp_ns: int, entry: T) -> None:
    book[stamp_ns] = entry
    while len(book) > SETS_KEPT:
        book.popitem(last=False)
