"""Decides how many frame sets a second the graph is given: as many as it answers in time.

Congestion control of a queue, by its delay. The delay of a set is its time from exposure to answer. A queue stands
when every one of the last sets came later than sets do while nothing queues (Nichols & Jacobson 2012: a burst leaves
the minimum as it is); a full queue drops sets. Then the rate falls to a share of what was answered (multiplicative
decrease, Chiu & Jain 1989; to the measured throughput: Mascolo et al. 2001) and nothing is kept until the queues are
empty, so that the delay without a queue is measured anew (Cardwell et al. 2016). From there the rate grows slowly up to
what was answered and quickly beyond (Ha, Rhee & Xu 2008), but not beyond what the busiest stage can do (utilisation
law). Torn sets alone lower nothing: frames that a network loses are lost at any rate.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Iterable
from dataclasses import dataclass

from capture_rig.stamps import NS_PER_S

# Thresholds: CLOCK_DRIFT: quartzes; the others chosen with the simulated graphs of test_hull_thinning_control.py.
TARGET_S = 0.05  # a queue that stands longer than this, or than one set's period, is an overload
SETS = 8  # that are judged: twice what a queue of four keeps of a burst
DROPPED = 0.15  # of them, dropped: one that a burst overflows is no overload
DECREASE = 0.9  # of the rate that was answered
GROWTH = 0.005  # of the cameras' rate a second cubed: half of it is won back within five seconds
FEWER = 4.0  # times fewer sets may come than are kept (slower cameras), or they come too seldom to judge: no rise
MOST_RISE = 2.0  # at once
FULL = 0.95  # of its time, the most that a stage is given to do
SPAN_S = 1.0  # over which throughput and work are measured, and between two changes
LEAST_HZ = 3.0
CLOCK_DRIFT = 1e-4  # between two machines' quartzes, at worst: the delay without a queue may grow so fast
DELAYED, DROPS = "sets wait", "sets are dropped"


@dataclass
class SetRecord:
    """A closed frame set: when it closed and was answered (monotonic ns), and its age when it closed."""

    stamp_ns: int
    closed_ns: int
    age_ns: int
    cameras: frozenset[str]
    answered_ns: int | None = None
    dropped: bool = False

    def delay_ns(self, now_ns: int) -> int:
        """Return its time from exposure to answer; so far, while there is none."""
        return self.age_ns + (self.answered_ns or now_ns) - self.closed_ns


class LoadControl:
    """The rate of frame sets that the graph is given, from what became of the last ones.

    limit_hz : the most sets a second; infinite while there is no overload.
    cause, standing_ns : sign of the last overload, and how long sets then waited.
    Times called ``now_ns`` are monotonic. Sets close in the order of their stamps.
    """

    def __init__(self) -> None:
        self.limit_hz, self.cause, self.standing_ns = math.inf, "", 0
        self._sets: deque[SetRecord] = deque()
        self._base_ns: float | None = None  # the delay without a queue
        self._based_ns = 0
        self._settled_ns = 0  # sets of later stamps are processed at the present rate
        self._changed_ns = self._fell_ns = 0
        self._answered_hz = 0.0  # the throughput at the last fall
        self._work: deque[tuple[int, int, int]] = deque()  # when, stage, how long it took
        self._handed_over: dict[int, int] = {}  # sets that the tracker has: stamp, since when
        self._last_answer_ns = 0

    # --- what happens to frame sets ------------------------------------------------------------------------------

    def add_closed(self, stamp_ns: int, cameras: frozenset[str], age_ns: int, now_ns: int) -> None:
        """Add a frame set that has closed; ``age_ns`` since its exposure, on a clock that may be off."""
        self._sets.append(SetRecord(stamp_ns, now_ns, age_ns, cameras))

    def add_work(self, stage: int, took_ns: int, now_ns: int) -> None:
        """Add the time that a stage worked on a set."""
        self._work.append((now_ns, stage, took_ns))

    def add_handed_over(self, stamp_ns: int, now_ns: int) -> None:
        """Add a set that the tracker has from now on."""
        self._handed_over[stamp_ns] = now_ns

    def add_answer(self, stamp_ns: int, now_ns: int) -> None:
        """Add the answer to a set: older ones without one will not be answered.

        The tracker was at work since it had the set and had answered the one before.
        """
        for each in self._sets:
            if each.answered_ns is None and each.stamp_ns < stamp_ns:
                each.dropped = True
            elif each.answered_ns is None and each.stamp_ns == stamp_ns:
                each.answered_ns = now_ns
                self._update_base(each, now_ns)
        given_ns = self._handed_over.pop(stamp_ns, None)
        if given_ns is not None:
            self.add_work(-1, now_ns - max(given_ns, self._last_answer_ns), now_ns)
        self._handed_over = {stamp: since for stamp, since in self._handed_over.items() if stamp > stamp_ns}
        self._last_answer_ns = now_ns

    def _update_base(self, answered: SetRecord, now_ns: int) -> None:
        if answered.stamp_ns < self._settled_ns:
            return
        delay_ns = answered.delay_ns(now_ns)
        drift_ns = CLOCK_DRIFT * (now_ns - self._based_ns)
        self._base_ns = delay_ns if self._base_ns is None else min(delay_ns, self._base_ns + drift_ns)
        self._based_ns = now_ns

    def settle(self, stamp_ns: int, now_ns: int) -> None:
        """Take sets from ``stamp_ns`` on as processed at a new rate."""
        if self.standing_ns:
            self._base_ns = None
        self._settled_ns, self._changed_ns, self.standing_ns = stamp_ns, now_ns, 0

    def restart(self, stamp_ns: int, now_ns: int) -> None:
        """Forget the sets so far: stamps begin anew here, perhaps with those of earlier sets, and so do ages."""
        self._sets.clear()
        self._handed_over.clear()
        self._base_ns = None
        self.settle(stamp_ns, now_ns)

    # --- the decision --------------------------------------------------------------------------------------------

    def update(self, offered_hz: float, rate_hz: float, now_ns: int) -> bool:
        """Judge the last sets; True when :attr:`limit_hz` has changed.

        offered_hz, rate_hz : the sets that the cameras take a second, and those of them that are kept.
        """
        span_ns = round(max(SPAN_S, FEWER * SETS / rate_hz) * NS_PER_S)
        while self._sets and now_ns - self._sets[0].closed_ns > span_ns:
            self._sets.popleft()
        while self._work and now_ns - self._work[0][0] > SPAN_S * NS_PER_S:
            self._work.popleft()
        judged = self._judged(rate_hz, now_ns)
        if len(judged) < SETS or self._base_ns is None:
            return False
        limit_hz = self.limit_hz
        drops = sum(each.dropped for _, each in judged) > DROPPED * SETS
        if drops or all(late for late, _ in judged):
            self.cause = DROPS if drops else DELAYED
            delays_ns = [each.delay_ns(now_ns) for _, each in judged if not each.dropped]
            self.standing_ns = max(round(max(delays_ns, default=0) - self._base_ns), 1)
            since_ns = next(each.closed_ns for late, each in judged if late)
            self._answered_hz, self._fell_ns = throughput_hz(self._sets, since_ns), now_ns
            if self._answered_hz == 0.0:  # too few answers of a burst tell no throughput: half of what was kept
                self._answered_hz = 0.5 * rate_hz
            self.limit_hz = max(DECREASE * self._answered_hz, LEAST_HZ)
        elif limit_hz < math.inf and now_ns - self._changed_ns >= SPAN_S * NS_PER_S:
            stages_hz = FULL * rate_hz / max(self._utilisation(), 1e-3)
            grown_hz = min(self._grown_hz(offered_hz, now_ns), stages_hz, MOST_RISE * rate_hz)
            if grown_hz >= offered_hz:
                self.limit_hz = math.inf
            elif FULL * grown_hz > limit_hz:  # a smaller rise is not worth another pattern of exposures
                self.limit_hz = grown_hz
        return self.limit_hz != limit_hz

    def _judged(self, rate_hz: float, now_ns: int) -> list[tuple[bool, SetRecord]]:
        """Return the last sets at the present rate, and whether each is late; without an answer, from then on."""
        late_ns = (self._base_ns or 0.0) + max(TARGET_S, 1.0 / rate_hz) * NS_PER_S
        recent = [each for each in self._sets if each.stamp_ns >= self._settled_ns]
        judged = [(each.dropped or each.delay_ns(now_ns) > late_ns, each) for each in recent]
        return [(late, each) for late, each in judged if late or each.answered_ns][-SETS:]

    def _grown_hz(self, offered_hz: float, now_ns: int) -> float:
        """Return the rate on the cubic that begins at the last fall and is level at what was answered then."""
        growth = GROWTH * offered_hz
        level_s = math.cbrt((1.0 - DECREASE) * self._answered_hz / growth)
        return self._answered_hz + growth * ((now_ns - self._fell_ns) / NS_PER_S - level_s) ** 3

    def _utilisation(self) -> float:
        """Return the share of the last second that the busiest stage worked."""
        stages = {stage for _, stage, _ in self._work}
        busy_ns = (sum(took for _, each, took in self._work if each == stage) for stage in stages)
        return max(busy_ns, default=0) / (SPAN_S * NS_PER_S)


def throughput_hz(sets: Iterable[SetRecord], since_ns: int) -> float:
    """Return how many whole sets a second the answers since then make: the frames of all but the first of them."""
    answered = sorted(
        (s for s in sets if s.answered_ns and s.answered_ns >= since_ns), key=lambda s: s.answered_ns or 0
    )
    if len(answered) < 2:
        return 0.0
    heard = frozenset[str]().union(*(each.cameras for each in answered))
    span_ns = (answered[-1].answered_ns or 0) - (answered[0].answered_ns or 0)
    return sum(len(each.cameras) for each in answered[1:]) / len(heard) * NS_PER_S / max(span_ns, 1)
