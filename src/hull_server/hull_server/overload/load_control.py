"""Decides how many frame sets a second the graph is given: as many as it answers in time.

What shows an overload, over the last third of a second:
- sets wait: even the fastest was answered, or had its last camera, much later than sets are when nothing queues
  (a standing queue, as CoDel sees it: Nichols & Jacobson 2012; a burst leaves the minimum as it is);
- whole sets are dropped, by the hull server's queue or the tracker's;
- sets are torn: live cameras are missing from most of them, and not always the same one.

The rate then falls at once, to what was answered. It rises after a calm second, as far as the measured load says that
there is room, or a little, as a trial; a rate that failed is tried again after a wait that doubles with each failure.
Where fewer frames do not help, the cause is another one (a clock that was set, a bad network), and they all return.
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass

NS_PER_S = 1_000_000_000
WINDOW_S, WINDOW_SETS = 0.35, 8  # what is judged: so long, but so many sets at least
CALM_S = 1.0  # without a sign of overload before the rate rises
RAISE_S = 0.5  # between two rises into measured room: the load is known again after one window
STANDING_S = 0.05  # a queue that stands so long, or for one set's period, is an overload
DROPPED, TORN = 0.1, 0.5  # shares of the sets that show an overload: packet loss alone seldom reaches either
HELPED = 0.95  # of the age, or of the missing frames, is left after a fall that helped, or less
IN_VAIN = 3  # falls in a row that do not help: the cause is another one
CERTAIN_SDS = 3.0  # more frames are missing than the network usually loses, of so few: by chance once in minutes
LEARN_S = 5.0  # in which the usual loss is learned: several falls, each of which shows within a second
SILENT_SETS = 5  # a camera missing from so many sets in a row is gone, and tears none
FULL = 0.85  # of the processor or of a stage: above, a measured load promises no room
TRIAL = 1.1  # a trial's rate over the present one; squared after each that held
MOST_RISE = 2.0  # into measured room, at once
LEAST_LOAD = 0.01
LOWEST, HIGHEST = 0.5, 0.95  # one fall of the rate
MARGIN = 0.95  # of the rate that was answered
LEAST_HZ = 3.0
STARVED_HZ = 10.0  # few frames alone lower the rate no further: on a full machine it rises again by trials only
HELD_S = 2.0  # a rise that shows no overload for so long has held: a queue that is 5 % too slow stands by then
PROVEN_S = 10.0  # ... and for so long for good: a fall within it makes the next trial wait longer
FIRST_WAIT_S, LONGEST_WAIT_S = 1.0, 60.0  # before a trial; it doubles with every trial that fails
SOON_S = 4.0  # the longest wait before a trial well below the rate that failed
LIGHTER = 0.8  # a load a set below this share of what it was at a failure is another load
REMEMBERED_S = 60.0  # the shortest delay within this is that without a queue
DELAYED, LATE, DROPS, TEARS = "sets wait", "frames come late", "sets are dropped", "sets are torn"
STARVED = "few frames come"


@dataclass
class SetRecord:
    """A closed frame set: when it closed (monotonic ns), its age then, its cameras and the live ones that it lacks."""

    stamp_ns: int
    closed_ns: int
    age_ns: int
    cameras: int
    lacks: frozenset[str]
    answered_ns: int | None = None
    dropped: bool = False

    @property
    def delay_ns(self) -> int | None:
        return None if self.answered_ns is None else self.answered_ns - self.closed_ns


class Shortest:
    """The smallest of the values of the last minute or so."""

    def __init__(self) -> None:
        self._parts: deque[tuple[int, int]] = deque()  # start of a sixth of that time, smallest within it

    def add(self, value: int, now_ns: int) -> None:
        part_ns = round(REMEMBERED_S / 6 * NS_PER_S)
        if not self._parts or now_ns - self._parts[-1][0] >= part_ns:
            self._parts.append((now_ns, value))
        else:
            self._parts[-1] = (self._parts[-1][0], min(self._parts[-1][1], value))
        while now_ns - self._parts[0][0] > 7 * part_ns:
            self._parts.popleft()

    def excess(self, value: int) -> int:
        """Return by how much a value exceeds the smallest; 0 where there is none."""
        return max(value - min((smallest for _, smallest in self._parts), default=value), 0)


class Throughput:
    """Counts what is done at one rate, up to a second back."""

    def __init__(self) -> None:
        self._done: deque[int] = deque()
        self._since_ns: int | None = None

    def begin(self, now_ns: int) -> None:
        """Take note that there is something to do from now on; only the first call counts."""
        if self._since_ns is None:
            self._since_ns = now_ns

    def add(self, now_ns: int) -> None:
        self._done.append(now_ns)
        while now_ns - self._done[0] > NS_PER_S:
            self._done.popleft()

    def share(self, rate_hz: float, span_s: float, now_ns: int) -> float:
        """Return how much was done in the last ``span_s`` of so much a second; 1 before anything could be done."""
        from_ns = max(now_ns - round(span_s * NS_PER_S), now_ns if self._since_ns is None else self._since_ns)
        expected = rate_hz * (now_ns - from_ns) / NS_PER_S
        return sum(done > from_ns for done in self._done) / expected if expected >= WINDOW_SETS / 2 else 1.0


class LoadControl:
    """The rate of frame sets that the graph is given, from what became of the last ones.

    limit_hz : the most sets a second; infinite while there is no overload. ``cause``, ``standing_ns``: what showed the
    last overload, and how long sets then waited.
    All times are monotonic nanoseconds. Frame sets are told of in the order of their stamps.
    """

    def __init__(self) -> None:
        self.limit_hz = math.inf
        self.cause, self.standing_ns = "", 0
        self._sets: deque[SetRecord] = deque()
        self._closings, self._answers = Throughput(), Throughput()
        self._open: dict[int, SetRecord] = {}  # not answered yet, by stamp
        self._absent: dict[str, int] = {}
        self._delay, self._age = Shortest(), Shortest()
        self._settled_ns = 0  # sets of later stamps are processed at the present rate
        self._changed_ns = 0
        self._raised_from_hz: float | None = None  # while the last rise is on trial
        self._step = TRIAL
        self._rose = False  # the last change was a rise, and it is not proven yet
        self._failed_hz = math.inf  # the rate that was too much last
        self._failed_load = 0.0  # the load a set when a rise failed: what it promised is not to be believed
        self._wait_s = FIRST_WAIT_S
        self._before: dict[str, tuple[float, int]] = {}  # cause -> how bad it was, and falls that did not help
        self._usual_loss = 0.0  # the share of frames that is missing whatever the rate: the network loses them
        self._learned_ns = 0

    # --- what happens to frame sets ------------------------------------------------------------------------------

    def closed(self, stamp_ns: int, cameras: frozenset[str], missing: frozenset[str], age_ns: int, now_ns: int) -> None:
        """Take a frame set that has closed; ``age_ns`` since its exposure, on a clock that may be off but not drift."""
        for camera in cameras:
            self._absent[camera] = 0
        for camera in missing:
            self._absent[camera] = self._absent.get(camera, 0) + 1
        lacks = frozenset(camera for camera in missing if self._absent[camera] < SILENT_SETS)
        record = SetRecord(stamp_ns, now_ns, age_ns, len(cameras), lacks)
        self._sets.append(record)
        self._open[stamp_ns] = record
        if stamp_ns >= self._settled_ns:
            self._closings.begin(now_ns)
            self._closings.add(now_ns)
            self._answers.begin(now_ns)
        if not missing:
            self._age.add(age_ns, now_ns)

    def answered(self, stamp_ns: int, now_ns: int) -> None:
        """Take note that a set was answered: older ones that were not will not be."""
        for older_ns in [stamp for stamp in self._open if stamp < stamp_ns]:
            self._open.pop(older_ns).dropped = True
        record = self._open.pop(stamp_ns, None)
        if record is not None:
            record.answered_ns = now_ns
            if stamp_ns >= self._settled_ns:
                self._answers.add(now_ns)
            self._delay.add(now_ns - record.closed_ns, now_ns)

    def begin_at(self, stamp_ns: int, now_ns: int) -> None:
        """Take note that the present limit is in force from this stamp on: earlier sets say nothing about it."""
        self._settled_ns, self._changed_ns = stamp_ns, now_ns
        self._closings, self._answers = Throughput(), Throughput()

    def begin_anew(self, stamp_ns: int, now_ns: int) -> None:
        """Forget the sets so far: stamps begin anew here, perhaps with those of earlier sets, and so do ages."""
        self._sets.clear()
        self._open.clear()
        self._age = Shortest()
        self.begin_at(stamp_ns, now_ns)

    def closed_share(self, rate_hz: float, now_ns: int) -> float:
        """Return how many sets have closed at the present rate, over those that a rate makes one expect."""
        return self._closings.share(rate_hz, 1.0, now_ns)

    # --- the decision --------------------------------------------------------------------------------------------

    def decide(self, offered_hz: float, rate_hz: float, load: float, now_ns: int) -> bool:
        """Judge the last sets; True when :attr:`limit_hz` has changed.

        offered_hz, rate_hz : what the cameras take a second, and what is kept of it; load : busy share (0 to 1) of the
        busiest of the stages and the processor.
        """
        limit_hz, calm_s = self.limit_hz, (now_ns - self._changed_ns) / NS_PER_S
        if calm_s >= HELD_S and self._raised_from_hz is not None:
            self._raised_from_hz, self._step = None, min(self._step**2, MOST_RISE)
        if calm_s >= PROVEN_S and self._rose:
            self._rose, self._wait_s = False, max(self._wait_s / 2, FIRST_WAIT_S)
        recent = self._recent(rate_hz, now_ns)
        if len(recent) < WINDOW_SETS:
            return False
        cause = self._overload(recent, rate_hz, load)
        if load < FULL:  # on a full processor frames are missing because clients hardly get to run
            self._learn_loss(1.0 - present_share(recent), now_ns)
        if cause:
            self._fall(cause, recent, rate_hz, load, now_ns)
        elif self.limit_hz < math.inf:
            self._rise(offered_hz, rate_hz, load, calm_s)
        return self.limit_hz != limit_hz

    def starve(self, rate_hz: float, load: float, now_ns: int) -> bool:
        """Lower the limit where far fewer sets come than are kept: the clients hardly get to run.

        True when the limit has changed; not before the last change can show, which starved clients follow late.
        """
        if now_ns - self._changed_ns < CALM_S * NS_PER_S or rate_hz <= STARVED_HZ:
            return False
        self._fall(STARVED, [each for each in self._sets if each.stamp_ns >= self._settled_ns], rate_hz, load, now_ns)
        self.limit_hz = max(self.limit_hz, STARVED_HZ)
        return True

    def _recent(self, rate_hz: float, now_ns: int) -> list[SetRecord]:
        span_ns = round(max(WINDOW_S, 1.5 * WINDOW_SETS / max(rate_hz, LEAST_HZ)) * NS_PER_S)
        while self._sets and now_ns - self._sets[0].closed_ns > span_ns:
            self._open.pop(self._sets.popleft().stamp_ns, None)
        return [each for each in self._sets if each.stamp_ns >= self._settled_ns]

    def _overload(self, recent: list[SetRecord], rate_hz: float, load: float) -> str:
        """Name what shows an overload; empty when nothing does."""
        standing_ns = max(STANDING_S, 1.0 / rate_hz) * NS_PER_S
        delays = [each.delay_ns for each in recent if each.delay_ns is not None]
        ages = [each.age_ns for each in recent if not each.lacks]
        torn = [each.lacks for each in recent if each.lacks]
        lost, frames = 1.0 - present_share(recent), max(sum(s.cameras + len(s.lacks) for s in recent), 1)
        if sum(each.dropped for each in recent) > max(DROPPED * len(recent), 1):
            return DROPS
        # a delay without a busy stage is no queue: a set takes longer than it did, as with more people
        if load >= FULL and 2 * len(delays) >= WINDOW_SETS and self._delay.excess(min(delays)) > standing_ns:
            return DELAYED
        unusual = lost > self._usual_loss + CERTAIN_SDS * math.sqrt(self._usual_loss * (1 - self._usual_loss) / frames)
        if len(torn) > TORN * len(recent) and len(frozenset().union(*torn)) > 1 and unusual:
            if self._helps(TEARS, lost, load):
                return TEARS
            self._usual_loss = lost
        if 2 * len(ages) >= WINDOW_SETS and self._age.excess(min(ages)) > standing_ns:
            if self._helps(LATE, self._age.excess(min(ages)), load):
                return LATE
            self._age = Shortest()
        return ""

    def _learn_loss(self, lost: float, now_ns: int) -> None:
        """Follow the share of missing frames, slowly: an overload shows before it has become usual."""
        elapsed_s = min((now_ns - self._learned_ns) / NS_PER_S, WINDOW_S)
        self._usual_loss += (lost - self._usual_loss) * elapsed_s / LEARN_S
        self._learned_ns = now_ns

    def _helps(self, cause: str, badness: float, load: float) -> bool:
        """Return whether falls for this cause may still help; else undo what was done.

        On a busy machine what stays as bad is still an overload, but for ages that stay the same: a clock was set.
        """
        before, falls = self._before.pop(cause, (math.inf, 0))
        same = HELPED * before <= badness <= before / HELPED
        in_vain = badness >= HELPED * before if load < FULL else same and cause == LATE
        falls = falls + 1 if in_vain else 1
        if falls <= IN_VAIN:
            self._before[cause] = badness, falls
            return True
        self.limit_hz = math.inf
        return False

    def _fall(self, cause: str, recent: list[SetRecord], rate_hz: float, load: float, now_ns: int) -> None:
        """Lower the limit to what was answered; after a rise, to where that began."""
        delays = [each.delay_ns for each in recent if each.delay_ns is not None]
        newest = recent[-WINDOW_SETS:]
        age_ns = max((s.age_ns for s in newest), default=0)
        self.standing_ns = self._delay.excess(max(delays, default=0)) + self._age.excess(age_ns)
        self.cause, self._step = cause, TRIAL
        if self._rose or now_ns - self._changed_ns >= HELD_S * NS_PER_S:  # else it is the same trouble still
            self._failed_hz = rate_hz
        if self._rose:
            self._rose, self._wait_s = False, min(2 * self._wait_s, LONGEST_WAIT_S)
        if self._raised_from_hz is not None:
            self.limit_hz = self._raised_from_hz
            self._failed_load, self._raised_from_hz = load / rate_hz, None
            return
        span_s = WINDOW_S if cause == DROPS else 1.0  # what is dropped was too much by far, and may be new
        came = self._closings.share(rate_hz, span_s, now_ns) * present_share(recent)
        share = MARGIN * min(came, self._answers.share(rate_hz, span_s, now_ns))
        self.limit_hz = max(rate_hz * min(max(share, LOWEST), HIGHEST), LEAST_HZ)

    def _rise(self, offered_hz: float, rate_hz: float, load: float, calm_s: float) -> None:
        """Raise the limit into measured room, or by a trial."""
        unproven = self._raised_from_hz is not None
        target_hz = 0.0
        if calm_s >= (RAISE_S if unproven else CALM_S):
            self._before.clear()
            target_hz = rate_hz * min(FULL / max(load, LEAST_LOAD), MOST_RISE)
        if target_hz < TRIAL * rate_hz or load / rate_hz > LIGHTER * self._failed_load > 0.0:
            target_hz = self._trial_hz(rate_hz, calm_s)
        if target_hz > rate_hz:
            if rate_hz >= self._failed_hz:
                self._failed_hz = math.inf
            self._raised_from_hz, self._rose = self._raised_from_hz or rate_hz, True
            self.limit_hz = target_hz if target_hz < offered_hz else math.inf

    def _trial_hz(self, rate_hz: float, calm_s: float) -> float:
        """Return a rate to try: soon, half the way to what was too much; near that, a tenth more, after a wait."""
        if rate_hz < self._failed_hz < math.inf:
            middle_hz = min(math.sqrt(rate_hz * self._failed_hz), MOST_RISE * rate_hz)
            if middle_hz > TRIAL * rate_hz:
                return middle_hz if calm_s >= min(self._wait_s, SOON_S) else 0.0
            step = TRIAL
        else:
            step = self._step
        return step * rate_hz if calm_s >= self._wait_s and self._raised_from_hz is None else 0.0


def present_share(sets: list[SetRecord]) -> float:
    """Return the share of the live cameras' frames that came."""
    present = sum(each.cameras for each in sets)
    return present / max(present + sum(len(each.lacks) for each in sets), 1)
