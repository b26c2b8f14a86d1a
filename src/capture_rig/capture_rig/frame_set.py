"""Frame sets: one silhouette a camera, all of one instant (thesis 6.2; tolerance and deadline are ours).

A set is identified by capture stamp: all stamps of a set lie within the tolerance of each other. A set closes when
every expected camera has delivered, or when its deadline has passed since its first arrival. Sets leave in stamp
order; a frame that comes after its set has left is late: counted, never mixed into another set. A camera's stamps may
not go back; only when those of all cameras do (footage or a bag started again) does a new timeline begin.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import Generic, TypeVar

T = TypeVar("T")

RESTART_NS = 1_000_000_000


@dataclass(frozen=True)
class FrameSet(Generic[T]):
    """The frames of one instant, cameras in name order.

    stamp_ns : the earliest capture stamp in the set.
    missing : expected cameras that delivered nothing in time.
    """

    stamp_ns: int
    frames: dict[str, T]
    stamps_ns: dict[str, int]
    missing: tuple[str, ...]

    @property
    def spread_ns(self) -> int:
        """Latest minus earliest capture stamp of the set."""
        return max(self.stamps_ns.values()) - min(self.stamps_ns.values())


@dataclass
class Counters:
    """What became of every frame and set, since the start."""

    frames: int = 0
    complete: int = 0
    incomplete: int = 0
    missing: int = 0
    late: int = 0
    duplicate: int = 0
    backwards: int = 0
    restarts: int = 0


@dataclass
class _OpenSet(Generic[T]):
    opened_ns: int
    frames: dict[str, T] = field(default_factory=dict)
    stamps_ns: dict[str, int] = field(default_factory=dict)

    @property
    def stamp_ns(self) -> int:
        return min(self.stamps_ns.values())

    def spread_with(self, stamp_ns: int) -> int:
        stamps = [*self.stamps_ns.values(), stamp_ns]
        return max(stamps) - min(stamps)


class FrameSetCollector(Generic[T]):
    """Sorts frames of several cameras into frame sets. Times are nanoseconds; ``arrival_ns`` is a monotonic clock.

    tolerance_ns : stamps of one set differ by at most this much (half a frame period).
    deadline_ns : how long after its first frame arrived a set waits for the others.
    max_open : at most this many sets are open at once; the oldest is closed beyond that.
    """

    def __init__(self, camera_names: Iterable[str], *, tolerance_ns: int, deadline_ns: int, max_open: int = 8) -> None:
        self.names = tuple(sorted(camera_names))
        self.tolerance_ns, self.deadline_ns, self.max_open = tolerance_ns, deadline_ns, max_open
        self.counters = Counters()
        self._open: list[_OpenSet[T]] = []  # in stamp order
        self._last_closed_ns: int | None = None
        self._last_stamp_ns: dict[str, int] = {}
        self._gone_back: set[str] = set()

    def add(self, camera: str, stamp_ns: int, frame: T, arrival_ns: int) -> list[FrameSet[T]]:
        """Take one frame; return the sets that this closes, oldest first. KeyError for an unknown camera."""
        if camera not in self.names:
            raise KeyError(camera)
        self.counters.frames += 1
        closed = self.flush() if self._timeline_restarts(camera, stamp_ns) else []
        if not self._refused(camera, stamp_ns):
            self._last_stamp_ns[camera] = stamp_ns
            joined = self._set_for(camera, stamp_ns, arrival_ns)
            joined.frames[camera], joined.stamps_ns[camera] = frame, stamp_ns
            self._open.sort(key=lambda s: s.stamp_ns)
        return closed + self.poll(arrival_ns)

    def poll(self, now_ns: int) -> list[FrameSet[T]]:
        """Close the sets that are complete or past their deadline; a complete set never overtakes an older one."""
        closing = 0
        for index, candidate in enumerate(self._open):
            expired = now_ns - candidate.opened_ns >= self.deadline_ns
            complete = len(candidate.frames) == len(self.names)
            if expired or (complete and closing == index):
                closing = index + 1
        closing = max(closing, len(self._open) - self.max_open)
        return [self._close(self._open.pop(0)) for _ in range(closing)]

    def next_deadline_ns(self) -> int | None:
        """When :meth:`poll` is due next, on the clock of ``arrival_ns``; None while nothing is open."""
        return min(s.opened_ns for s in self._open) + self.deadline_ns if self._open else None

    def flush(self) -> list[FrameSet[T]]:
        """Close every open set, complete or not: the end of a recording."""
        return [self._close(self._open.pop(0)) for _ in range(len(self._open))]

    def _timeline_restarts(self, camera: str, stamp_ns: int) -> bool:
        """True when every camera that has delivered now stamps more than RESTART_NS behind its own last stamp."""
        last = self._last_stamp_ns.get(camera)
        if last is None or stamp_ns >= last - RESTART_NS:
            self._gone_back.discard(camera)
            return False
        self._gone_back.add(camera)
        if self._gone_back != set(self._last_stamp_ns):
            return False
        self.counters.restarts += 1
        self._gone_back.clear()
        self._last_stamp_ns.clear()
        self._last_closed_ns = None
        return True

    def _refused(self, camera: str, stamp_ns: int) -> bool:
        last = self._last_stamp_ns.get(camera)
        if last is not None and stamp_ns == last:
            self.counters.duplicate += 1
        elif last is not None and stamp_ns < last:
            self.counters.backwards += 1
        elif self._last_closed_ns is not None and stamp_ns <= self._last_closed_ns + self.tolerance_ns:
            self.counters.late += 1
        else:
            return False
        return True

    def _set_for(self, camera: str, stamp_ns: int, arrival_ns: int) -> _OpenSet[T]:
        near = [s for s in self._open if camera not in s.frames and s.spread_with(stamp_ns) <= self.tolerance_ns]
        if near:
            return min(near, key=lambda s: s.spread_with(stamp_ns))
        fresh: _OpenSet[T] = _OpenSet(arrival_ns)
        self._open.append(fresh)
        return fresh

    def _close(self, closing: _OpenSet[T]) -> FrameSet[T]:
        missing = tuple(name for name in self.names if name not in closing.frames)
        self.counters.missing += len(missing)
        if missing:
            self.counters.incomplete += 1
        else:
            self.counters.complete += 1
        self._last_closed_ns = closing.stamp_ns
        return FrameSet(
            stamp_ns=closing.stamp_ns,
            frames={name: closing.frames[name] for name in self.names if name in closing.frames},
            stamps_ns={name: closing.stamps_ns[name] for name in self.names if name in closing.stamps_ns},
            missing=missing,
        )
