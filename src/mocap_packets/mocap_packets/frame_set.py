"""Frame sets: one silhouette a camera, all of one instant (thesis 6.2; tolerance and deadline are ours).

A set is identified by capture stamp: all stamps of a set lie within the tolerance of each other. A set closes when its
last camera has arrived, or when its deadline has passed since its first arrival. It does not wait for a missing camera
that has delivered a later stamp, as stamps may not go back; nor for one that is known to have no frame of that instant;
nor, if the collector may give up, for one that several sets in a row have missed, until its next frame. Sets leave in
stamp order; a frame that arrives after its set has left is late: counted, never mixed into another set.

The rig's time is the median of its cameras' newest stamps, so that a single camera never moves it. A frame more than a
quarter of a second ahead of the rig's time, or behind its own camera's last frame, is a jump and is held for two frame
periods. When the median has jumped (footage or a bag started again, a pause, a clock that was set) the collector resets
to the held frames; else they are dropped and counted. A camera that lags with increasing stamps is late, not a jump.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import Generic, NamedTuple, TypeVar

T = TypeVar("T")

TIME_JUMP_NS = 250_000_000
JUMP_TOLERANCES = 10  # a jump is at least five frame periods, so that slow cameras do not jump with every frame
HELD_TOLERANCES = 4  # two frame periods, in which every live camera sends a frame
NEVER_NS = -(2**62)


@dataclass(frozen=True)
class FrameSet(Generic[T]):
    """The frames of one instant, cameras in name order.

    stamp_ns : the mean of the capture stamps in the set, the time of results from all of them. missing : expected
    cameras that delivered nothing in time.
    """

    stamp_ns: int
    frames: dict[str, T]
    stamps_ns: dict[str, int]
    missing: tuple[str, ...]

    @classmethod
    def of_instant(cls, stamp_ns: int, frames: dict[str, T], missing: tuple[str, ...] = ()) -> FrameSet[T]:
        """Frames that all have the same stamp."""
        return cls(stamp_ns, frames, dict.fromkeys(frames, stamp_ns), missing)

    @classmethod
    def of_stamps(cls, stamps_ns: dict[str, int], frames: dict[str, T], missing: tuple[str, ...] = ()) -> FrameSet[T]:
        """Frames of cameras with a stamp each."""
        return cls(sum(stamps_ns.values()) // len(stamps_ns), frames, stamps_ns, missing)

    @property
    def spread_ns(self) -> int:
        """Latest minus earliest capture stamp of the set."""
        return max(self.stamps_ns.values()) - min(self.stamps_ns.values())


@dataclass
class Counters:
    """Counts of frames and sets by their fate, since the start.

    frames = in sets + late + duplicate + backwards + ahead + still waiting. ``missing`` counts the gaps in incomplete
    sets; ``restarts`` the jumps back of the rig's time.
    """

    frames: int = 0
    complete: int = 0
    incomplete: int = 0
    missing: int = 0
    late: int = 0
    duplicate: int = 0
    backwards: int = 0
    ahead: int = 0
    restarts: int = 0


class Arrival(NamedTuple, Generic[T]):
    """A frame that has come."""

    camera: str
    stamp_ns: int
    frame: T
    arrival_ns: int


class OpenSet(dict[str, Arrival[T]]):
    """Frames of one instant that have arrived so far, by camera."""

    @property
    def opened_ns(self) -> int:
        return next(iter(self.values())).arrival_ns

    @property
    def stamp_ns(self) -> int:
        return min(each.stamp_ns for each in self.values())

    def spread_with(self, stamp_ns: int) -> int:
        stamps_ns = [stamp_ns, *(each.stamp_ns for each in self.values())]
        return max(stamps_ns) - min(stamps_ns)


class FrameSetCollector(Generic[T]):
    """Sorts frames of several cameras into frame sets. Times are nanoseconds; ``arrival_ns`` is a monotonic clock.

    tolerance_ns : stamps of one set differ by at most this much (half a frame period).
    deadline_ns : how long after its first frame arrived a set waits for the others; may be changed at any time.
    max_open : at most this many sets are open at once; the oldest is closed beyond that.
    give_up : sets in a row without a camera after which sets no longer wait for it, until its next frame; 0: never.
        Which set its next frame joins depends on when it arrives; a deterministic replay declares absent frames
        instead (:meth:`add_absence`).
    """

    def __init__(
        self, camera_names: Iterable[str], *, tolerance_ns: int, deadline_ns: int, max_open: int = 8, give_up: int = 0
    ) -> None:
        self.names = tuple(sorted(camera_names))
        self.tolerance_ns, self.deadline_ns, self.max_open, self.give_up = tolerance_ns, deadline_ns, max_open, give_up
        self.counters = Counters()
        self._jump_ns = max(TIME_JUMP_NS, JUMP_TOLERANCES * tolerance_ns)
        self._time_ns = 0  # of the rig; set by its first frame
        self._newest: dict[str, Arrival[T]] = {}  # of each camera, jumps included
        self._held: list[Arrival[T]] = []  # in no set, or not yet
        self._begin()

    def _begin(self) -> None:
        """Reset; stamps may repeat."""
        self._open: list[OpenSet[T]] = []
        self._last_ns = dict.fromkeys(self.names, NEVER_NS)  # the last stamp of each camera that was not a jump
        self._absent_ns = dict.fromkeys(self.names, NEVER_NS)  # the latest instant known to be without its frame
        self._last_closed_ns = self._last_set_ns = NEVER_NS
        self._missed_count = dict.fromkeys(self.names, 0)  # sets in a row that waited for each camera in vain

    # --- frames in, sets out

    def add(self, camera: str, stamp_ns: int, frame: T, arrival_ns: int) -> list[FrameSet[T]]:
        """Add one frame; return the sets that this closes, oldest first. KeyError for an unknown camera."""
        self._check(camera)
        self.counters.frames += 1
        self._newest[camera] = Arrival(camera, stamp_ns, frame, arrival_ns)
        self._held.append(self._newest[camera])
        return self.poll(arrival_ns)

    def add_absence(self, camera: str, stamp_ns: int, now_ns: int) -> list[FrameSet[T]]:
        """Wait for no frame of a camera at an instant; return the sets that this closes. KeyError as above."""
        self._check(camera)
        self._absent_ns[camera] = stamp_ns
        return self.poll(now_ns)

    def poll(self, now_ns: int) -> list[FrameSet[T]]:
        """Close the sets that wait for no camera or are past their deadline; none overtakes an older one."""
        closed = self._update_time(now_ns) if self._held else []
        due = 0
        for index, candidate in enumerate(self._open):
            expired = now_ns - candidate.opened_ns >= self.deadline_ns
            if expired or (due == index and not any(self._is_awaited(name, candidate) for name in self.names)):
                due = index + 1
        return closed + self._close(max(due, len(self._open) - self.max_open))

    def next_deadline_ns(self) -> int | None:
        """Return when :meth:`poll` is due next, on the clock of ``arrival_ns``; None while nothing is open."""
        due = [each.opened_ns + self.deadline_ns for each in self._open]
        return min(due + [each.arrival_ns + self._held_for_ns for each in self._held[:1]], default=None)

    def flush(self) -> list[FrameSet[T]]:
        """Close every open set, complete or not: the end of a recording."""
        closed = self._update_time(self._held[0].arrival_ns + self._held_for_ns) if self._held else []
        return closed + self._close(len(self._open))

    # --- the rig's time

    def _check(self, camera: str) -> None:
        if camera not in self.names:
            raise KeyError(camera)

    @property
    def _held_for_ns(self) -> int:
        return self.deadline_ns + HELD_TOLERANCES * self.tolerance_ns

    def _jumps(self, new: Arrival[T]) -> bool:
        """Return whether a frame is far ahead of the rig's time, or far behind its camera's last (or the oldest open
        set)."""
        last_ns = self._last_ns[new.camera]
        if last_ns == NEVER_NS:
            last_ns = min([self._time_ns, *(each.stamp_ns for each in self._open[:1])])
        return max(last_ns - new.stamp_ns, new.stamp_ns - self._time_ns) > self._jump_ns

    def _update_time(self, now_ns: int) -> list[FrameSet[T]]:
        """Update the rig's time from the held frames, add those that do not jump, and drop the others after the hold.

        The rig's time jumps when all cameras' frames do, or at the end of the hold when those of most active ones do.
        """
        due_ns, was_ns = self._held[0].arrival_ns + self._held_for_ns, self._time_ns
        over = now_ns >= due_ns or len(self._held) > self.max_open * len(self.names)
        heard = [n for n in self._newest.values() if n.arrival_ns >= min(now_ns, due_ns) - self._held_for_ns]
        votes = sorted(n.stamp_ns if self._jumps(n) else max(n.stamp_ns, was_ns) for n in heard)
        middle = votes[(len(votes) - 1) // 2], votes[len(votes) // 2]
        time_ns = min(middle, key=lambda vote: abs(vote - was_ns))
        closed: list[FrameSet[T]] = []
        if abs(time_ns - was_ns) <= self._jump_ns:
            self._time_ns = time_ns
        elif over or all(map(self._jumps, self._newest.values())):
            closed = self._close(len(self._open))
            if time_ns < was_ns:
                self.counters.restarts += 1
                self._begin()
            self._time_ns = time_ns
        held, self._held = self._held, []
        for each in held:
            if not self._jumps(each):
                self._add_here(each)
            elif not over:
                self._held.append(each)
            elif each.stamp_ns > self._time_ns:
                self.counters.ahead += 1
            elif self._last_ns[each.camera] == NEVER_NS:
                self.counters.late += 1
            else:
                self.counters.backwards += 1
        return closed

    def _add_here(self, new: Arrival[T]) -> None:
        """Add a frame to the open set nearest in time, or to a new one; count a frame that no set can hold."""
        last_ns, self._missed_count[new.camera] = self._last_ns[new.camera], 0
        if new.stamp_ns <= last_ns:
            self.counters.duplicate += new.stamp_ns == last_ns
            self.counters.backwards += new.stamp_ns < last_ns
            return
        if new.stamp_ns <= self._last_closed_ns + self.tolerance_ns:
            self.counters.late += 1
            return
        others = (each for each in self._open if new.camera not in each)
        joined = min(others, key=lambda each: each.spread_with(new.stamp_ns), default=None)
        if joined is None or joined.spread_with(new.stamp_ns) > self.tolerance_ns:
            joined = OpenSet()
            self._open.append(joined)
        joined[new.camera] = new
        self._open.sort(key=lambda each: each.stamp_ns)
        self._last_ns[new.camera] = new.stamp_ns

    def _is_awaited(self, camera: str, candidate: OpenSet[T]) -> bool:
        """Return whether a camera may still deliver its frame of a set."""
        if camera in candidate or 0 < self.give_up <= self._missed_count[camera]:
            return False
        passed = self._last_ns[camera] >= candidate.stamp_ns + self.tolerance_ns
        return not passed and abs(self._absent_ns[camera] - candidate.stamp_ns) > self.tolerance_ns

    def _close(self, count: int) -> list[FrameSet[T]]:
        closed, self._open = self._open[:count], self._open[count:]
        return [self._frame_set(each) for each in closed]

    def _frame_set(self, closed: OpenSet[T]) -> FrameSet[T]:
        for name in self.names:
            self._missed_count[name] += self._is_awaited(name, closed)
        there = [name for name in self.names if name in closed]
        missing = tuple(name for name in self.names if name not in closed)
        self.counters.missing += len(missing)
        self.counters.complete += not missing
        self.counters.incomplete += bool(missing)
        stamps_ns = {name: closed[name].stamp_ns for name in there}
        made = FrameSet.of_stamps(stamps_ns, {name: closed[name].frame for name in there}, missing)
        self._last_closed_ns = closed.stamp_ns
        # stamps rise even if a camera's next frame comes so soon that two sets overlap in time
        self._last_set_ns = max(made.stamp_ns, self._last_set_ns + 1)
        return replace(made, stamp_ns=self._last_set_ns)
