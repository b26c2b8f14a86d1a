"""Frame sets: one silhouette a camera, all of one instant (thesis 6.2; tolerance and deadline are ours).

A set is identified by capture stamp: all stamps of a set lie within the tolerance of each other. A set closes the
moment its last camera has come, or when its deadline has passed since its first arrival. A camera that lacks is not
waited for once it has delivered a later stamp, for stamps may not go back; nor where it is known to have no frame of
that instant; nor, where the collector may give up, once several sets in a row have waited for it in vain, until it is
heard again. Sets leave in stamp order; a frame that comes after its set has left is late: counted, never mixed into
another set.

A stamp that leaps by more than a quarter of a second is put to the vote, so that one camera with a wrong clock cannot
silence the others: such frames wait as a candidate timeline, and the rig moves to it when more cameras deliver there
than in the present one (footage or a bag started again, a pause). Otherwise they are dropped and counted. A camera
that merely lags, its own stamps going on, is late: it has no vote while most cameras still meet in sets.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import Generic, TypeVar

# --- One run of capture stamps: the frame sets that are open in it, and which frames may still join.

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

    def __init__(
        self, names: tuple[str, ...], tolerance_ns: int, deadline_ns: int, max_open: int, give_up: int
    ) -> None:
        self.names, self.give_up = names, give_up
        self.tolerance_ns, self.deadline_ns, self.max_open = tolerance_ns, deadline_ns, max_open
        self.open: list[OpenSet[T]] = []
        self.head_ns: int | None = None  # the latest stamp taken
        self.last_stamp_ns: dict[str, int] = {}  # of each camera that has delivered
        self._last_closed_ns: int | None = None
        self._absent_ns: dict[str, int] = {}  # the latest instant of which each camera is known to have no frame
        self._in_vain = dict.fromkeys(names, 0)  # sets in a row that waited for each camera and left without it

    def refusal(self, camera: str, stamp_ns: int) -> str | None:
        """Why a frame cannot be taken: DUPLICATE, BACKWARDS or LATE; None when it can."""
        self._in_vain[camera] = 0  # heard, if late: it is waited for again
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

    def note_absence(self, camera: str, stamp_ns: int) -> None:
        """Wait for no frame of this camera at this instant: it is known that there is none."""
        self._absent_ns[camera] = stamp_ns

    def is_complete(self, candidate: OpenSet[T]) -> bool:
        return len(candidate.frames) == len(self.names)

    def close_due(self, now_ns: int) -> list[OpenSet[T]]:
        """Take out the sets that wait for nobody or are past their deadline; none overtakes an older one."""
        closing = 0
        for index, candidate in enumerate(self.open):
            expired = now_ns - candidate.opened_ns >= self.deadline_ns
            if expired or (closing == index and not self._is_awaited(candidate)):
                closing = index + 1
        return self._close(max(closing, len(self.open) - self.max_open))

    def close_all(self) -> list[OpenSet[T]]:
        return self._close(len(self.open))

    def next_deadline_ns(self) -> int | None:
        return min(s.opened_ns for s in self.open) + self.deadline_ns if self.open else None

    def _is_awaited(self, candidate: OpenSet[T]) -> bool:
        """Return whether a camera that the set lacks may still deliver its frame."""
        return any(self._is_camera_awaited(name, candidate) for name in self.names)

    def _is_camera_awaited(self, camera: str, candidate: OpenSet[T]) -> bool:
        if camera in candidate.frames or 0 < self.give_up <= self._in_vain[camera]:
            return False
        last_ns, absent_ns = self.last_stamp_ns.get(camera), self._absent_ns.get(camera)
        passed = last_ns is not None and last_ns >= candidate.stamp_ns + self.tolerance_ns
        return not passed and (absent_ns is None or abs(absent_ns - candidate.stamp_ns) > self.tolerance_ns)

    def _close(self, count: int) -> list[OpenSet[T]]:
        closed, self.open = self.open[:count], self.open[count:]
        for each in closed:
            self._last_closed_ns = each.stamp_ns
            for name in self.names:
                self._in_vain[name] += self._is_camera_awaited(name, each)
        return closed


LEAP_NS = 250_000_000
LEAP_TOLERANCES = 10  # a leap is at least five frame periods, so that slow cameras do not leap with every frame
MOST_LAG_NS = 5_000_000_000  # what is farther behind has another clock
LAG_NS = 4_000_000_000  # cameras may lag for so long after most of them met in a set: clients that start, starved, do
VOTE_TOLERANCES = 4  # two frame periods: time for every live camera to be heard in one timeline or the other


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

    @classmethod
    def of_instant(cls, stamp_ns: int, frames: dict[str, T], missing: tuple[str, ...] = ()) -> FrameSet[T]:
        """Frames that all have the same stamp."""
        return cls(stamp_ns, frames, dict.fromkeys(frames, stamp_ns), missing)

    @property
    def spread_ns(self) -> int:
        """Latest minus earliest capture stamp of the set."""
        return max(self.stamps_ns.values()) - min(self.stamps_ns.values())


@dataclass
class Counters:
    """What became of every frame and set, since the start.

    frames = those in sets + late + duplicate + backwards + ahead + those still waiting. ``missing`` counts the gaps
    in incomplete sets; ``restarts`` how often the stamps of the rig went back.
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


class FrameSetCollector(Generic[T]):
    """Sorts frames of several cameras into frame sets. Times are nanoseconds; ``arrival_ns`` is a monotonic clock.

    tolerance_ns : stamps of one set differ by at most this much (half a frame period).
    deadline_ns : how long after its first frame arrived a set waits for the others.
    max_open : at most this many sets are open at once; the oldest is closed beyond that.
    give_up : a camera for which so many sets in a row have waited in vain is not waited for until it is heard; 0: it
        always is. Which set its first frame then joins depends on when it arrives; a replay that must repeat itself
        tells instead which frames there are not (:meth:`note_absence`).
    """

    def __init__(
        self, camera_names: Iterable[str], *, tolerance_ns: int, deadline_ns: int, max_open: int = 8, give_up: int = 0
    ) -> None:
        self.names = tuple(sorted(camera_names))
        self.tolerance_ns, self.deadline_ns, self.max_open, self.give_up = tolerance_ns, deadline_ns, max_open, give_up
        self.counters = Counters()
        self._leap_ns = max(LEAP_NS, LEAP_TOLERANCES * tolerance_ns)
        self._present = self._new_timeline()
        self._candidate: Timeline[T] | None = None
        self._candidate_since_ns = 0
        self._met_ns: int | None = None  # the last arrival at which most cameras had met in a set, or the first one
        self._stamp_ns: dict[str, int] = {}  # the last stamp of each camera, in whatever timeline
        self._present_voters: set[str] = set()  # cameras last heard in the present since the candidate began

    def add(self, camera: str, stamp_ns: int, frame: T, arrival_ns: int) -> list[FrameSet[T]]:
        """Take one frame; return the sets that this closes, oldest first. KeyError for an unknown camera."""
        if camera not in self.names:
            raise KeyError(camera)
        self.counters.frames += 1
        self._met_ns = arrival_ns if self._met_ns is None else self._met_ns
        timeline = self._timeline_of(camera, stamp_ns, arrival_ns)
        self._stamp_ns[camera] = stamp_ns
        refusal = timeline.refusal(camera, stamp_ns) if timeline else self._misfit(camera, stamp_ns)
        if timeline and not refusal:
            timeline.take(camera, stamp_ns, frame, arrival_ns)
        else:
            self._count(refusal)
        return self.poll(arrival_ns)

    def note_absence(self, camera: str, stamp_ns: int, now_ns: int) -> list[FrameSet[T]]:
        """Take it that a camera has no frame of this instant; return the sets that this closes. KeyError as above."""
        if camera not in self.names:
            raise KeyError(camera)
        self._present.note_absence(camera, stamp_ns)
        return self.poll(now_ns)

    def poll(self, now_ns: int) -> list[FrameSet[T]]:
        """Close the sets that wait for nobody or are past their deadline; none overtakes an older one."""
        closed = self._emit_all(now_ns)
        if any(2 * len(each.frames) > len(self.names) for each in closed):
            self._met_ns = now_ns
        return closed

    def _emit_all(self, now_ns: int) -> list[FrameSet[T]]:
        closed = self._vote(now_ns)
        return closed + self._emit(self._present.close_due(now_ns))

    def wait(self, deadline_ns: int) -> None:
        """Let sets, also those that are open, wait for their last cameras for so long from now on."""
        self.deadline_ns = deadline_ns
        for timeline in (self._present, self._candidate):
            if timeline is not None:
                timeline.deadline_ns = deadline_ns

    def next_deadline_ns(self) -> int | None:
        """Return when :meth:`poll` is due next, on the clock of ``arrival_ns``; None while nothing is open."""
        deadlines = [self._present.next_deadline_ns(), None if self._candidate is None else self._vote_due_ns()]
        return min((d for d in deadlines if d is not None), default=None)

    def flush(self) -> list[FrameSet[T]]:
        """Close every open set, complete or not: the end of a recording."""
        closed = self._emit(self._present.close_all())
        if self._candidate is not None:
            self._settle(self._candidate)
            closed += self._emit(self._present.close_all())
        return closed

    def _new_timeline(self) -> Timeline[T]:
        return Timeline(self.names, self.tolerance_ns, self.deadline_ns, self.max_open, self.give_up)

    def _timeline_of(self, camera: str, stamp_ns: int, arrival_ns: int) -> Timeline[T] | None:
        """Return the timeline that the stamp is near to; a new candidate when there is none yet."""
        if self._is_near(self._present, stamp_ns):
            self._present_voters.add(camera)
            return self._present
        if self._is_lagging(camera, stamp_ns, arrival_ns):
            return None
        if self._candidate is None:
            self._candidate, self._candidate_since_ns = self._new_timeline(), arrival_ns
            self._present_voters.clear()
        if not self._is_near(self._candidate, stamp_ns):
            return None
        self._present_voters.discard(camera)
        return self._candidate

    def _is_lagging(self, camera: str, stamp_ns: int, arrival_ns: int) -> bool:
        """Return whether a frame comes late in the present timeline, and no new one begins with it."""
        if self._candidate is not None and camera in self._candidate.last_stamp_ns:
            return False
        last_ns, head_ns = self._stamp_ns.get(camera), self._present.head_ns
        if last_ns is None or head_ns is None or not last_ns < stamp_ns < head_ns < stamp_ns + MOST_LAG_NS:
            return False
        return self._met_ns is not None and arrival_ns - self._met_ns < LAG_NS

    def _is_near(self, timeline: Timeline[T], stamp_ns: int) -> bool:
        if timeline.head_ns is None:
            return True
        tail_ns = timeline.open[0].stamp_ns if timeline.open else timeline.head_ns
        return tail_ns - self._leap_ns <= stamp_ns <= timeline.head_ns + self._leap_ns

    def _vote_due_ns(self) -> int:
        return self._candidate_since_ns + self.deadline_ns + VOTE_TOLERANCES * self.tolerance_ns

    def _vote(self, now_ns: int) -> list[FrameSet[T]]:
        """Choose present or candidate: at once when all cameras are in one candidate set, else when it is due."""
        candidate = self._candidate
        if candidate is None:
            return []
        unanimous = any(map(candidate.is_complete, candidate.open))
        if not (unanimous or now_ns >= self._vote_due_ns() or len(candidate.open) > self.max_open):
            return []
        return self._settle(candidate, unanimous)

    def _settle(self, candidate: Timeline[T], unanimous: bool = False) -> list[FrameSet[T]]:
        self._candidate = None
        candidate_voters = candidate.last_stamp_ns.keys() - self._present_voters
        if unanimous or len(candidate_voters) > len(self._present_voters):
            closed = self._emit(self._present.close_all())
            if candidate.open[0].stamp_ns < (self._present.head_ns or 0):
                self._count("restarts")
            self._present = candidate
            return closed
        for lost in candidate.open:
            for camera, stamp_ns in lost.stamps_ns.items():
                self._count(self._misfit(camera, stamp_ns))
        return []

    def _misfit(self, camera: str, stamp_ns: int) -> str:
        """Return what is wrong with a frame whose stamp is far from the present timeline."""
        if self._present.head_ns is None or stamp_ns > self._present.head_ns:
            return "ahead"
        last = self._present.last_stamp_ns.get(camera)
        return LATE if last is None or stamp_ns > last else BACKWARDS

    def _count(self, name: str | None) -> None:
        if name is not None:
            setattr(self.counters, name, getattr(self.counters, name) + 1)

    def _emit(self, closed: list[OpenSet[T]]) -> list[FrameSet[T]]:
        return [self._frame_set(each) for each in closed]

    def _frame_set(self, closed: OpenSet[T]) -> FrameSet[T]:
        missing = tuple(name for name in self.names if name not in closed.frames)
        self.counters.missing += len(missing)
        self._count("incomplete" if missing else "complete")
        return FrameSet(
            stamp_ns=closed.stamp_ns,
            frames={name: closed.frames[name] for name in self.names if name in closed.frames},
            stamps_ns={name: closed.stamps_ns[name] for name in self.names if name in closed.stamps_ns},
            missing=missing,
        )
