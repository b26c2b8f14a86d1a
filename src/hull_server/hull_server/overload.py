"""Decides which exposures all camera clients keep: as many frame sets a second as the graph answers in time.

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
import threading
from collections import deque
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from capture_rig.stamps import NS_PER_S
from mocap_packets.thinning import EVERY_FRAME, FrameDecimation, FrameSelector, nearest_fraction

# Thresholds: CLOCK_DRIFT: quartzes; the others chosen with the simulated graphs of test_hull_overload.py.
TARGET_S = 0.05  # a queue that stands for longer, and for longer than one set's period, is an overload
SETS = 8  # a decision: a burst fills a queue of four and delays as many; eight late ones are a standing queue
WINDOW_SETS = 32  # periods of kept sets: of fewer than SETS sets in it (slower, or starved, cameras) none is judged
MOST_SETS = 512  # that are remembered: three seconds of the fastest cameras
GROWTH = 0.005  # of the cameras' rate a second cubed: half of it is won back within five seconds
DECREASE = 0.9  # of the rate that was answered
FULL = 0.95  # largest utilisation of a stage; also the smallest ratio of limits that is worth another pattern
CLOCK_DRIFT = 1e-4  # between two machines' quartzes, at worst: the delay without a queue may grow so fast
DELAYED, DROPS = "sets wait", "sets are dropped"

LEAD_NS = 30_000_000  # from the newest stamp to a rule's first: it has reached every client by then
LONGEST_PAUSE_NS = 500_000_000  # in which nothing is kept while the queues run empty, when the rate falls
LONGEST_SILENCE_NS = 2 * NS_PER_S  # without a set: no exposure of the cameras may be one that is kept
LONGEST_WAIT_NS = 100_000_000  # for the last cameras of a set while the clients' machines are busy
LONGEST_GAP_NS = 10 * NS_PER_S  # after a longer one, as when footage begins again, the exposures are found anew
STAMPS_KEPT = 40  # of sets: the period of 60 Hz to 3e-4 where stamps jitter by a millisecond
LEAST_STAMPS = 9  # until a period is told
OFF_GRID = 0.24  # of a period: stamps farther from the grid (rms; random ones: 0.29) do not lie on it


@dataclass(eq=False)
class SetRecord:
    """A closed frame set: when it closed, went to the tracker, was answered (monotonic ns; 0: not yet).

    age_ns : when it closed. work_ns : how long carver and slicer worked on it.
    """

    stamp_ns: int
    closed_ns: int
    age_ns: int
    cameras: frozenset[str]
    work_ns: tuple[int, int] = (0, 0)
    handed_over_ns: int = 0
    answered_ns: int = 0
    dropped: bool = False

    def delay_ns(self, now_ns: int) -> int:
        """Return its time from exposure to answer; so far, while there is none."""
        return self.age_ns + (self.answered_ns or now_ns) - self.closed_ns


class ThinningControl:
    """Keeps the frame sets of one rig within what the graph answers in time; safe to call from any thread.

    Times called ``now_ns`` are monotonic. :meth:`update` is called about ten times a second; where it is never called,
    every frame is kept.
    """

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._selector = FrameSelector(lapse_ns=math.inf)
        self._stamps: deque[int] = deque(maxlen=STAMPS_KEPT)  # of sets since the exposures were sought anew
        self._offered_hz: float | None = None  # sets that the cameras take a second
        self._limit_hz, self._cause = math.inf, ""  # the most sets a second, and the sign of the last overload
        self._answered_hz = 0.0  # the throughput then
        self._published_ns: int | None = None
        self._changed_ns = self._fell_ns = 0
        self._sets: deque[SetRecord] = deque(maxlen=MOST_SETS)
        self._base_ns: float | None = None  # the delay without a queue, and when it was measured
        self._based_ns = 0
        self._settled_ns = 0  # sets of later stamps are processed at the present rate

    @property
    def rule(self) -> FrameDecimation:
        """The rule published last."""
        return self._selector.newest

    @property
    def summary(self) -> str:
        """What is thinned out, in words; empty while nothing is."""
        rule, offered_hz = self.rule, self._offered_hz
        if rule.keep == rule.of or offered_hz is None:
            return ""
        held = f"the graph holds {rule.fraction * offered_hz:.0f} Hz of {offered_hz:.0f}"
        return f"thinned to {rule.keep} of {rule.of}: {held} ({self._cause})"

    def deadline_ns(self, usual_ns: int) -> int:
        """Return how long a set waits for its last cameras: while sets are left out, until the next one is due."""
        rule = self.rule
        if rule.keep == rule.of:
            return usual_ns
        return max(usual_ns, min(round(rule.period_ns / rule.fraction), LONGEST_WAIT_NS))

    # --- what happens to frame sets ------------------------------------------------------------------------------

    def admits(self, stamp_ns: int, now_ns: int) -> bool:
        """Return whether a frame belongs to a set; False when its exposure is thinned out."""
        with self._lock:
            return self._selector.keeps(stamp_ns, now_ns)

    def add_closed(self, stamp_ns: int, frames: Iterable[str], age_ns: int, now_ns: int) -> None:
        """Add a frame set that has closed; ``age_ns`` since its exposure, on a clock that may be off."""
        with self._lock:
            if self._sets and not 0 < stamp_ns - self._sets[-1].stamp_ns < LONGEST_GAP_NS:
                self._restart(stamp_ns, now_ns)
            self._stamps.append(stamp_ns)
            self._sets.append(SetRecord(stamp_ns, now_ns, age_ns, frozenset(frames)))

    def add_work(self, stamp_ns: int, carver_ns: int, slicer_ns: int, handed_over_ns: int) -> None:
        """Add how long carver and slicer worked on a set, and when the tracker had it."""
        with self._lock:
            for each in self._sets:
                if each.stamp_ns == stamp_ns:
                    each.work_ns, each.handed_over_ns = (carver_ns, slicer_ns), handed_over_ns

    def add_answer(self, stamp_ns: int, now_ns: int) -> None:
        """Add the answer to a set, of the tracker or, without one, of the publisher: older sets will have none."""
        with self._lock:
            for each in self._sets:
                if not each.answered_ns and each.stamp_ns < stamp_ns:
                    each.dropped = True
                elif not each.answered_ns and each.stamp_ns == stamp_ns:
                    each.answered_ns = now_ns
                    self._update_base(each, now_ns)

    def _update_base(self, answered: SetRecord, now_ns: int) -> None:
        if answered.stamp_ns >= self._settled_ns:
            drifted_ns = math.inf if self._base_ns is None else self._base_ns + CLOCK_DRIFT * (now_ns - self._based_ns)
            self._base_ns, self._based_ns = min(answered.delay_ns(now_ns), drifted_ns), now_ns

    def _restart(self, stamp_ns: int, now_ns: int) -> None:
        """Start a new run of stamps, of other ages: until its exposures are known, every frame is kept."""
        self._stamps.clear()
        self._sets.clear()
        self._published_ns = self._base_ns = None
        self._settled_ns, self._changed_ns = stamp_ns, now_ns
        self._selector.update(replace(EVERY_FRAME, from_ns=stamp_ns), now_ns)

    # --- the rule ------------------------------------------------------------------------------------------------

    def update(self, now_ns: int) -> FrameDecimation | None:
        """Return the rule to publish: a new one, or the present one again; None when there is nothing to publish."""
        with self._lock:
            rule = self.rule
            if self._published_ns is None:
                return self._publish(rule, now_ns)
            grid, thins = find_exposures(self._stamps, rule), rule.keep < rule.of
            newest = self._sets[-1] if self._sets else None
            is_lost = grid is None and len(self._stamps) >= LEAST_STAMPS
            if thins and (is_lost or newest is None or now_ns - newest.closed_ns > LONGEST_SILENCE_NS):
                self._stamps.clear()  # the cameras' rate has changed, or they rest
                return self._publish(replace(EVERY_FRAME, from_ns=newest.stamp_ns if newest else 0), now_ns)
            due = thins and now_ns - self._published_ns >= NS_PER_S
            if grid is None or newest is None:
                return self._publish(rule, now_ns) if due else None
            self._offered_hz, limit_hz = grid.hz, self._limit_hz
            standing_ns = self._update_limit(grid.hz, now_ns)
            keep_of = nearest_fraction(self._limit_hz / grid.hz)
            if standing_ns or ((self._limit_hz != limit_hz or not thins) and keep_of != (rule.keep, rule.of)):
                return self._decimate(grid, keep_of, standing_ns, now_ns)
            if not due:
                return None
            # the same exposures, at the phase that the last stamps give: clocks drift
            patterns = rule.exposure_of(newest.stamp_ns) // rule.of
            phase_ns = grid.phase_ns + round(patterns * rule.of * grid.period_ns)
            return self._publish(replace(rule, phase_ns=phase_ns, period_ns=grid.period_ns), now_ns)

    def _decimate(self, grid: Exposures, keep_of: tuple[int, int], standing_ns: int, now_ns: int) -> FrameDecimation:
        """Make a rule; when a queue stands, nothing is kept until it is empty, and its delay is measured anew."""
        newest_ns = self._sets[-1].stamp_ns
        from_ns = resume_ns = newest_ns + LEAD_NS
        if standing_ns:
            from_ns, resume_ns = newest_ns, resume_ns + min(standing_ns, LONGEST_PAUSE_NS)
            self._base_ns = None
        self._settled_ns, self._changed_ns = resume_ns, now_ns
        # a camera of half the rate delivers at every second exposure: keep those that all deliver at
        whole = max(self._sets, key=lambda each: (len(each.cameras), each.stamp_ns))
        phase_ns = grid.phase_ns + round(round((whole.stamp_ns - grid.phase_ns) / grid.period_ns) * grid.period_ns)
        return self._publish(FrameDecimation(from_ns, resume_ns, phase_ns, grid.period_ns, *keep_of), now_ns)

    def _publish(self, rule: FrameDecimation, now_ns: int) -> FrameDecimation:
        self._selector.update(rule, now_ns)
        self._published_ns = now_ns
        return rule

    # --- the rate ------------------------------------------------------------------------------------------------

    def _update_limit(self, offered_hz: float, now_ns: int) -> int:
        """Adapt the limit to the last sets; return how long sets wait when a queue stands, otherwise 0."""
        rate_hz = self.rule.fraction * offered_hz
        span_ns = max(NS_PER_S, round(WINDOW_SETS / rate_hz * NS_PER_S))
        while len(self._sets) > 1 and now_ns - self._sets[0].closed_ns > span_ns:
            self._sets.popleft()
        if self._base_ns is None:
            return 0
        late_ns = self._base_ns + max(TARGET_S, 1.0 / rate_hz) * NS_PER_S
        recent = [each for each in self._sets if each.stamp_ns >= self._settled_ns]
        late = [each for each in recent if each.dropped or each.delay_ns(now_ns) > late_ns]
        judged = [each for each in recent if each.answered_ns or each in late][-SETS:]
        if len(judged) < SETS:
            return 0
        drops = sum(each.dropped for each in judged) > 1
        if drops or all(each in late for each in judged):
            self._cause = DROPS if drops else DELAYED
            self._decrease(rate_hz, next(each.closed_ns for each in judged if each in late), now_ns)
            delays_ns = [each.delay_ns(now_ns) for each in judged if not each.dropped]
            return max(round(max(delays_ns, default=0) - self._base_ns), 1)
        if self._limit_hz < math.inf and now_ns - self._changed_ns >= NS_PER_S:
            self._increase(rate_hz, offered_hz, now_ns)
        return 0

    def _decrease(self, rate_hz: float, since_ns: int, now_ns: int) -> None:
        """Lower the limit below what was answered since then; where too few answers came to tell, below half."""
        self._answered_hz, self._fell_ns = throughput_hz(self._sets, since_ns) or 0.5 * rate_hz, now_ns
        self._limit_hz = DECREASE * self._answered_hz

    def _increase(self, rate_hz: float, offered_hz: float, now_ns: int) -> None:
        """Raise the limit along the cubic that begins at the last fall and is level at what was answered then, but not
        beyond what the busiest stage can do, nor twice the rate."""
        growth, level_hz = GROWTH * offered_hz, self._answered_hz
        since_level_s = (now_ns - self._fell_ns) / NS_PER_S - math.cbrt((1.0 - DECREASE) * level_hz / growth)
        limit_hz = min(level_hz + growth * since_level_s**3, FULL * rate_hz / self._utilisation(), 2 * rate_hz)
        if limit_hz >= offered_hz:
            self._limit_hz = math.inf
        elif FULL * limit_hz > self._limit_hz:
            self._limit_hz = limit_hz

    def _utilisation(self) -> float:
        """Return the share of its time that the busiest stage worked on the last sets; more than 0.

        The tracker was at work since it had a set and had answered the one before.
        """
        busy_ns, span_ns = np.ones(3), 1
        for before, each in pairwise(each for each in self._sets if each.answered_ns):
            busy_ns += (*each.work_ns, each.answered_ns - max(each.handed_over_ns, before.answered_ns))
            span_ns += each.answered_ns - before.answered_ns
        return float(busy_ns.max()) / span_ns


def throughput_hz(sets: Iterable[SetRecord], since_ns: int) -> float:
    """Return how many whole sets a second the answers since then make: the frames of all but the first of them."""
    answers = sorted((s.answered_ns, s.cameras) for s in sets if s.answered_ns and s.answered_ns >= since_ns)
    if len(answers) < 2:
        return 0.0
    heard = frozenset[str]().union(*(cameras for _, cameras in answers))
    return sum(len(c) for _, c in answers[1:]) / len(heard) * NS_PER_S / max(answers[-1][0] - answers[0][0], 1)


# --- when the rig exposes: period and phase of its exposures, from the capture stamps of its sets


@dataclass(frozen=True)
class Exposures:
    """A grid of exposures: one at ``phase_ns``, and every ``period_ns``."""

    phase_ns: int
    period_ns: float

    @property
    def hz(self) -> float:
        return NS_PER_S / self.period_ns


def find_exposures(stamps_ns: Sequence[int], rule: FrameDecimation = EVERY_FRAME) -> Exposures | None:
    """Return the grid on which the stamps of sets lie; None while there are too few of them, or they lie on none.

    rule : under which they were kept; its grid is refined. Without one the usual step between two sets is a period.
    """
    if len(stamps_ns) < LEAST_STAMPS:
        return None
    phase_ns, period_ns = rule.phase_ns, rule.period_ns
    if rule.keep == rule.of:
        steps_ns = np.diff(stamps_ns).astype(float)
        phase_ns, period_ns = stamps_ns[-1], float(np.median(steps_ns))
        period_ns = float(steps_ns.sum() / np.rint(steps_ns / period_ns).sum())
    offsets_ns = np.array([stamp_ns - phase_ns for stamp_ns in stamps_ns], float)
    numbers = np.rint(offsets_ns / period_ns)
    # the line of stamps over exposure numbers (least squares)
    period_ns, first_ns = np.polyfit(numbers, offsets_ns, 1).tolist()
    left_ns = offsets_ns - period_ns * numbers - first_ns
    if np.sqrt(np.mean(left_ns**2)) > OFF_GRID * period_ns:
        return None
    return Exposures(phase_ns + round(first_ns), period_ns)
