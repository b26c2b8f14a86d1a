"""Watches what becomes of the frame sets, and says which exposures all clients shall keep."""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Iterable
from dataclasses import replace

from mocap_packets.thinning import EVERY_FRAME, FrameSelector, Thinning, nearest_fraction

from .busy_stages import BusyStages
from .frame_clock import Exposures, FrameClock
from .load_control import FULL, NS_PER_S, LoadControl

REFRESH_S = 1.0  # a rule in force is told again, with the phase that the last stamps give: clocks drift
LEAD_NS = 30_000_000  # from the newest stamp to a rule's first: it has reached every client by then
LONGEST_PAUSE_NS = 500_000_000  # in which nothing is kept while the queues run empty, when the rate falls
FEWEST, MOST, SEEN_S, LEAST_SETS = 0.6, 1.5, 0.5, 6  # of the sets of that time: else the cameras' rate has changed
LONGEST_GAP_NS = 10 * NS_PER_S  # after a longer one, as when footage begins again, the exposures are found anew
LAG_SPAN_NS = 300_000_000
NO_SETS, FEW_SETS = FEW = "no sets come", "far fewer sets come than are kept"
SETS_KEPT = 200
LOADS_KEPT = 5  # of the last half second


class ThinningControl:
    """Keeps the frame sets of one rig within what the graph answers in time; safe to call from any thread.

    Times called ``now_ns`` are monotonic. :meth:`update` is called about ten times a second.
    """

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._clock, self._load, self._busy = FrameClock(), LoadControl(), BusyStages()
        self._selector = FrameSelector(lapse_ns=None)
        self._closed: deque[tuple[int, int, int]] = deque(maxlen=SETS_KEPT)  # when, stamp, cameras
        self._lags: deque[tuple[int, int]] = deque(maxlen=SETS_KEPT)  # when a frame came, and how far behind the newest
        self._machine_loads: deque[float] = deque(maxlen=LOADS_KEPT)
        self.news = ""  # why every frame is kept again, when it is not for room
        self._head_ns = 0
        self._told_ns: int | None = None
        self._adopted_ns, self._settled_ns = 0, 0  # when the present rate was told, and its first stamp
        self._on_grid_ns = 0
        self._offered_hz: float | None = None

    @property
    def rule(self) -> Thinning:
        """The rule told last."""
        return self._selector.newest

    @property
    def summary(self) -> str:
        """What is thinned out, in words; empty while nothing is."""
        rule, offered_hz = self.rule, self._offered_hz
        if rule.keep == rule.of or offered_hz is None:
            return ""
        held = f"the graph holds {rule.fraction * offered_hz:.0f} Hz of {offered_hz:.0f}"
        return f"thinned to {rule.keep} of {rule.of}: {held} ({self._load.cause})"

    # --- what happens --------------------------------------------------------------------------------------------

    def admits(self, camera: str, stamp_ns: int, now_ns: int) -> bool:
        """Take note of a frame; False when its exposure is thinned out, so that it belongs to no set."""
        with self._lock:
            if not self._selector.keeps(stamp_ns, now_ns):
                return False
            self._clock.add(camera, stamp_ns)
            if self._closed and 0 < stamp_ns - self._closed[-1][1] < NS_PER_S:  # else another clock than the others'
                self._head_ns = max(self._head_ns, stamp_ns)
            self._lags.append((now_ns, self._head_ns - stamp_ns))
            return True

    def closed(self, stamp_ns: int, frames: Iterable[str], missing: Iterable[str], age_ns: int, now_ns: int) -> None:
        """Take note of a frame set that has closed, ``age_ns`` after its exposure."""
        with self._lock:
            if self._closed and not 0 < stamp_ns - self._closed[-1][1] < LONGEST_GAP_NS:
                self._begin_anew(stamp_ns, now_ns)
            self._head_ns = max(self._head_ns, stamp_ns)
            cameras = frozenset(frames)
            self._load.closed(stamp_ns, cameras, frozenset(missing), age_ns, now_ns)
            self._closed.append((now_ns, stamp_ns, len(cameras)))

    def hand_over(self, stamp_ns: int, now_ns: int) -> None:
        """Take note that the tracker has a set from now on."""
        with self._lock:
            self._busy.hand_over(stamp_ns, now_ns)

    def worked(self, carver_ns: int, slicer_ns: int, now_ns: int) -> None:
        """Take note of what carver and slicer took for a set."""
        with self._lock:
            self._busy.worked(carver_ns, slicer_ns, now_ns)

    def answered(self, stamp_ns: int, now_ns: int) -> None:
        """Take note of the tracker's answer to a set; without a tracker, of its products."""
        with self._lock:
            self._busy.answered(stamp_ns, now_ns)
            self._load.answered(stamp_ns, now_ns)

    # --- the rule ------------------------------------------------------------------------------------------------

    def update(self, machine_load: float, now_ns: int) -> Thinning | None:
        """Return the rule to tell: a new one, or the present one again; None when there is nothing to tell.

        machine_load : busy share (0 to 1) of this machine's processors since the last call.
        """
        with self._lock:
            rule = self.rule
            if self._told_ns is None:
                return self._tell(rule, now_ns)
            grid = self._clock.estimate(rule)
            self._machine_loads.append(machine_load)
            load = max(sum(self._machine_loads) / len(self._machine_loads), self._busy.share(now_ns))
            due = rule.keep < rule.of and now_ns - self._told_ns >= REFRESH_S * NS_PER_S
            lost = self._lost_cameras(now_ns)
            if lost in FEW and load >= FULL:  # the cameras go on, but their clients hardly get to run
                rate_hz = rule.fraction * NS_PER_S / rule.period_ns
                if grid is not None and self._load.starve(rate_hz, load, now_ns):
                    return self._adopt(grid, rate_hz, now_ns)
                return self._tell(rule, now_ns) if due else None
            if lost:
                self.news = lost
                self._clock.forget()
                return self._tell(replace(EVERY_FRAME, from_ns=self._head_ns + LEAD_NS), now_ns)
            if grid is None or self._load.closed_share(rule.fraction * grid.hz, now_ns) > MOST:
                return self._tell(rule, now_ns) if due else None  # the cameras' rate is not known, or not yet
            self._offered_hz, rate_hz = grid.hz, rule.fraction * grid.hz
            changed = self._load.decide(grid.hz, rate_hz, load, now_ns)
            if changed or (rule.keep == rule.of and nearest_fraction(self._load.limit_hz / grid.hz) != (1, 1)):
                return self._adopt(grid, rate_hz, now_ns)
            if not due:
                return None
            patterns = rule.exposure_of(self._head_ns) // rule.of
            phase_ns = grid.phase_ns + round(patterns * rule.of * grid.period_ns)
            return self._tell(replace(rule, phase_ns=phase_ns, period_ns=grid.period_ns), now_ns)

    def _adopt(self, grid: Exposures, rate_hz: float, now_ns: int) -> Thinning:
        """Make a rule of the present limit; when the rate falls, nothing is kept until the queues are empty."""
        self.news = ""
        keep, of = nearest_fraction(self._load.limit_hz / grid.hz)
        from_ns = resume_ns = self._head_ns + LEAD_NS
        if keep / of * grid.hz < rate_hz:
            lags = [lag for when, lag in self._lags if now_ns - when < LAG_SPAN_NS and lag < NS_PER_S]
            standing_ns = max(self._load.standing_ns, max(lags, default=0))  # in the server, in the slowest client
            from_ns, resume_ns = self._head_ns, resume_ns + min(standing_ns, LONGEST_PAUSE_NS)
        self._adopted_ns, self._settled_ns = now_ns, resume_ns
        self._load.begin_at(resume_ns, now_ns)
        # a camera of half the rate delivers at every second exposure: keep those that all deliver at
        whole_ns = max(self._closed, key=lambda closed: (closed[2], closed[1]))[1] if self._closed else grid.phase_ns
        phase_ns = grid.phase_ns + round(round((whole_ns - grid.phase_ns) / grid.period_ns) * grid.period_ns)
        return self._tell(Thinning(from_ns, resume_ns, phase_ns, grid.period_ns, keep, of), now_ns)

    def _tell(self, rule: Thinning, now_ns: int) -> Thinning:
        self._selector.follow(rule, now_ns)
        self._told_ns = now_ns
        return rule

    def _begin_anew(self, stamp_ns: int, now_ns: int) -> None:
        """Take up a new run of stamps: until its exposures are known, every frame is kept."""
        apart_s = (stamp_ns - self._closed[-1][1]) / NS_PER_S
        self.news = f"stamps went on {apart_s:.3f} s later" if apart_s > 0 else f"stamps went back by {-apart_s:.3f} s"
        self._clock.forget()
        self._closed.clear()
        self._head_ns, self._told_ns = stamp_ns, None
        self._load.begin_anew(stamp_ns, now_ns)
        self._selector.follow(replace(EVERY_FRAME, from_ns=stamp_ns), now_ns)

    def _lost_cameras(self, now_ns: int) -> str:
        """Say why the rule is not for these cameras, as when their rate has changed; empty while it is.

        Sets are counted by their stamps: an overload delays them, it does not move them.
        """
        rule = self.rule
        if not self._clock.off_grid:
            self._on_grid_ns = now_ns
        if rule.keep == rule.of or not self._closed:
            return ""
        hz = rule.fraction * NS_PER_S / rule.period_ns
        span_ns = round(max(SEEN_S, LEAST_SETS / hz) * NS_PER_S)
        newest_ns = self._closed[-1][1]
        if now_ns - max(self._closed[-1][0], self._adopted_ns) > span_ns + LONGEST_PAUSE_NS:
            return NO_SETS
        if now_ns - self._on_grid_ns > span_ns:
            return "the cameras' stamps lie on another grid"
        if newest_ns - max(self._settled_ns, self._closed[0][1]) < span_ns:
            return ""
        seen = sum(stamp > newest_ns - span_ns for _, stamp, _ in self._closed) / (hz * span_ns / NS_PER_S)
        if seen <= FEWEST:
            return FEW_SETS
        return f"{seen:.1f} times as many sets come as are kept" if seen >= MOST else ""
