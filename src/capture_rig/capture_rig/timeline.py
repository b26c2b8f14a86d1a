"""One run of capture stamps: the frame sets that are open in it, and which frames may still join."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Generic, TypeVar

T = TypeVar("T")

DUPLICATE, BACKWARDS, LATE = "duplicate", "backwards", "late"


@dataclass
class OpenSet(Generic[T]):
    """Frames of one instant that have arrived so far; ``opened_ns`` is the arrival of the first."""

    opened_ns: int
    frames: dict[str, T] = field(default_factory=dict)
    stamps_ns: dict[str, int] = field(default_factory=dict)

    @property
    def stamp_ns(self) -> int:
        return min(self.stamps_ns.values())

    def spread_with(self, stamp_ns: int) -> int:
        stamps = [*self.stamps_ns.values(), stamp_ns]
        return max(stamps) - min(stamps)


class Timeline(Generic[T]):
    """The open sets in stamp order. Stamps never go back: not a camera's own, not past a set that has left."""

    def __init__(self, camera_count: int, tolerance_ns: int, deadline_ns: int, max_open: int) -> None:
        self.camera_count = camera_count
        self.tolerance_ns, self.deadline_ns, self.max_open = tolerance_ns, deadline_ns, max_open
        self.open: list[OpenSet[T]] = []
        self.head_ns: int | None = None  # the latest stamp taken
        self.last_stamp_ns: dict[str, int] = {}  # of each camera that has delivered
        self._last_closed_ns: int | None = None

    def refusal(self, camera: str, stamp_ns: int) -> str | None:
        """Why a frame cannot be taken: DUPLICATE, BACKWARDS or LATE; None when it can."""
        last = self.last_stamp_ns.get(camera)
        if last is not None and stamp_ns == last:
            return DUPLICATE
        if last is not None and stamp_ns < last:
            return BACKWARDS
        if self._last_closed_ns is not None and stamp_ns <= self._last_closed_ns + self.tolerance_ns:
            return LATE
        return None

    def take(self, camera: str, stamp_ns: int, frame: T, arrival_ns: int) -> None:
        """Put a frame that is not refused into the open set nearest in time, or into one of its own."""
        near = [s for s in self.open if camera not in s.frames and s.spread_with(stamp_ns) <= self.tolerance_ns]
        if near:
            joined = min(near, key=lambda s: s.spread_with(stamp_ns))
        else:
            joined = OpenSet(arrival_ns)
            self.open.append(joined)
        joined.frames[camera], joined.stamps_ns[camera] = frame, stamp_ns
        self.open.sort(key=lambda s: s.stamp_ns)
        self.last_stamp_ns[camera] = stamp_ns
        self.head_ns = stamp_ns if self.head_ns is None else max(self.head_ns, stamp_ns)

    def is_complete(self, candidate: OpenSet[T]) -> bool:
        return len(candidate.frames) == self.camera_count

    def close_due(self, now_ns: int) -> list[OpenSet[T]]:
        """Take out the sets that are complete or past their deadline; a complete one never overtakes an older one."""
        closing = 0
        for index, candidate in enumerate(self.open):
            expired = now_ns - candidate.opened_ns >= self.deadline_ns
            if expired or (closing == index and self.is_complete(candidate)):
                closing = index + 1
        return self._close(max(closing, len(self.open) - self.max_open))

    def close_all(self) -> list[OpenSet[T]]:
        return self._close(len(self.open))

    def next_deadline_ns(self) -> int | None:
        return min(s.opened_ns for s in self.open) + self.deadline_ns if self.open else None

    def _close(self, count: int) -> list[OpenSet[T]]:
        closed, self.open = self.open[:count], self.open[count:]
        if closed:
            self._last_closed_ns = closed[-1].stamp_ns
        return closed
