"""Watches what becomes of the frame sets, and says which exposures all clients shall keep."""

from __future__ import annotations

import threading
from collections.abc import Iterable
from dataclasses import replace

from mocap_packets.thinning import EVERY_FRAME, FrameDecimation, FrameSelector, nearest_fraction

from .frame_clock import Exposures, FrameClock
from .load_control import NS_PER_S, LoadControl

# Thresholds: chosen with the simulated graphs of test_hull_thinning_control.py, test_hull_frame_clock.py.
REFRESH_NS = NS_PER_S  # a rule in force is published again, with the phase that the last stamps give: clocks drift
LEAD_NS = 30_000_000  # from the newest stamp to a rule's first: it has reached every client by then
LONGEST_PAUSE_NS = 500_000_000  # in which nothing is kept while the queues run empty, when the rate falls
LONGEST_SILENCE_NS = 2 * NS_PER_S  # without a set: no exposure of the cameras may be one that is kept
LONGEST_WAIT_NS = 100_000_000  # for the last cameras of a set while the clients' machines are busy
LONGEST_GAP_NS = 10 * NS_PER_S  # after a longer one, as when footage begins again, the exposures are found anew


class ThinningControl:
    """Keeps the frame sets of one rig within what the graph answers in time; safe to call from any thread.

    Times called ``now_ns`` are monotonic. :meth:`update` is called about ten times a second.
    """

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._clock, self._load = FrameClock(), LoadControl()
        self._selector = FrameSelector(lapse_ns=None)
        self._whole = (0, 0)  # the most cameras of a set under the present rule, and its stamp
        self._newest_ns: int | None = None  # the stamp of the last set
        self._closed_ns = 0  # when it closed
        self._published_ns: int | None = None
        self._offered_hz: float | None = None

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
        return f"thinned to {rule.keep} of {rule.of}: {held} ({self._load.cause})"

    def deadline_ns(self, usual_ns: int) -> int:
        """Return how long a set waits for its last cameras: while sets are left out, until the next one is due."""
        rule = self.rule
        if rule.keep == rule.of:
            return usual_ns
        return max(usual_ns, min(round(rule.period_ns / rule.fraction), LONGEST_WAIT_NS))

    # --- what happens --------------------------------------------------------------------------------------------

    def admits(self, camera: str, stamp_ns: int, now_ns: int) -> bool:
        """Add a frame; False when its exposure is thinned out, so that it belongs to no set."""
        with self._lock:
            if not self._selector.keeps(stamp_ns, now_ns):
                return False
            self._clock.add(camera, stamp_ns)
            return True

    def add_closed(self, stamp_ns: int, frames: Iterable[str], age_ns: int, now_ns: int) -> None:
        """Add a frame set that has closed, ``age_ns`` after its exposure."""
        with self._lock:
            if self._newest_ns is not None and not 0 < stamp_ns - self._newest_ns < LONGEST_GAP_NS:
                self._restart(stamp_ns, now_ns)
            self._newest_ns, self._closed_ns, cameras = stamp_ns, now_ns, frozenset(frames)
            self._whole = max(self._whole, (len(cameras), stamp_ns))
            self._load.add_closed(stamp_ns, cameras, age_ns, now_ns)

    def add_work(self, stage: int, took_ns: int, now_ns: int) -> None:
        """Add the time that a stage (0: carver, 1: slicer) worked on a set."""
        with self._lock:
            self._load.add_work(stage, took_ns, now_ns)

    def add_handed_over(self, stamp_ns: int, now_ns: int) -> None:
        """Add a set that the tracker has from now on."""
        with self._lock:
            self._load.add_handed_over(stamp_ns, now_ns)

    def add_answer(self, stamp_ns: int, now_ns: int) -> None:
        """Add the tracker's answer to a set; without a tracker, the publication of its products."""
        with self._lock:
            self._load.add_answer(stamp_ns, now_ns)

    # --- the rule ------------------------------------------------------------------------------------------------

    def update(self, now_ns: int) -> FrameDecimation | None:
        """Return the rule to publish: a new one, or the present one again; None when there is nothing to publish."""
        with self._lock:
            rule = self.rule
            if self._published_ns is None:
                return self._publish(rule, now_ns)
            grid = self._clock.estimate(rule)
            thins = rule.keep < rule.of
            if thins and (self._clock.off_grid or now_ns - self._closed_ns > LONGEST_SILENCE_NS):
                self._clock.forget()  # the cameras' rate has changed, or they rest
                return self._publish(replace(EVERY_FRAME, from_ns=self._newest_ns or 0), now_ns)
            due = thins and now_ns - self._published_ns >= REFRESH_NS
            if grid is None or self._newest_ns is None:
                return self._publish(rule, now_ns) if due else None
            self._offered_hz = grid.hz
            changed = self._load.update(grid.hz, rule.fraction * grid.hz, now_ns)
            fraction = nearest_fraction(self._load.limit_hz / grid.hz)
            if self._load.standing_ns or ((changed or rule.keep == rule.of) and fraction != (rule.keep, rule.of)):
                return self._decimate(grid, fraction, now_ns)
            if not due:
                return None
            patterns = rule.exposure_of(self._newest_ns) // rule.of
            phase_ns = grid.phase_ns + round(patterns * rule.of * grid.period_ns)
            return self._publish(replace(rule, phase_ns=phase_ns, period_ns=grid.period_ns), now_ns)

    def _decimate(self, grid: Exposures, fraction: tuple[int, int], now_ns: int) -> FrameDecimation:
        """Make a rule; when a queue stands, nothing is kept until it is empty."""
        assert self._newest_ns is not None
        from_ns = resume_ns = self._newest_ns + LEAD_NS
        if self._load.standing_ns:
            from_ns, resume_ns = self._newest_ns, resume_ns + min(self._load.standing_ns, LONGEST_PAUSE_NS)
        self._load.settle(resume_ns, now_ns)
        # a camera of half the rate delivers at every second exposure: keep those that all deliver at
        exposures = round((self._whole[1] - grid.phase_ns) / grid.period_ns)
        phase_ns = grid.phase_ns + round(exposures * grid.period_ns)
        self._whole = (0, 0)
        return self._publish(FrameDecimation(from_ns, resume_ns, phase_ns, grid.period_ns, *fraction), now_ns)

    def _publish(self, rule: FrameDecimation, now_ns: int) -> FrameDecimation:
        self._selector.update(rule, now_ns)
        self._published_ns = now_ns
        return rule

    def _restart(self, stamp_ns: int, now_ns: int) -> None:
        """Start a new run of stamps: until its exposures are known, every frame is kept."""
        self._clock.forget()
        self._published_ns = None
        self._load.restart(stamp_ns, now_ns)
        self._selector.update(replace(EVERY_FRAME, from_ns=stamp_ns), now_ns)
