"""Watches what becomes of the frame sets, and says which exposures all clients shall keep."""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Iterable
from dataclasses import dataclass, replace

import numpy as np

from mocap_packets.thinning import EVERY_FRAME, FrameDecimation, FrameSelector, nearest_fraction

from .load_control import NS_PER_S, LoadControl

# Thresholds: chosen with the simulated graphs of test_hull_thinning_control.py, test_hull_frame_clock.py.
REFRESH_NS = NS_PER_S  # a rule in force is published again, with the phase that the last stamps give: clocks drift
LEAD_NS = 30_000_000  # from the newest stamp to a rule's first: it has reached every client by then
LONGEST_PAUSE_NS = 500_000_000  # in which nothing is kept while the queues run empty, when the rate falls
LONGEST_SILENCE_NS = 2 * NS_PER_S  # without a set: no exposure of the cameras may be one that is kept
LONGEST_WAIT_NS = 100_000_000  # for the last cameras of a set while the clients' machines are busy
LONGEST_GAP_NS = 10 * NS_PER_S  # after a longer one, as when footage begins again, the exposures are found anew
STAMPS_KEPT = 40  # of each camera: the period of 60 Hz to 3e-4 where stamps jitter by a millisecond
LEAST_STEPS = 8  # between neighbouring stamps, until a period is told
LOW_PERCENTILE = 10.0  # of the steps: cameras that lose frames or have half the rate make longer ones
LONGEST_STEP = 8  # periods: a longer gap tells nothing
OFF_GRID = 0.24  # of a period: stamps farther from the grid (rms; random ones: 0.29) do not lie on it


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


# --- when the rig exposes: period and phase of its exposures, from the capture stamps that arrive


@dataclass(frozen=True)
class Exposures:
    """A grid of exposures: one at ``phase_ns``, and every ``period_ns``."""

    phase_ns: int
    period_ns: float

    @property
    def hz(self) -> float:
        return 1e9 / self.period_ns


class FrameClock:
    """Estimates the exposures' grid from the stamps of all cameras, thinned or not."""

    def __init__(self) -> None:
        self.off_grid = False  # at the last estimate, there were stamps enough, and they lay on no grid
        self._stamps: dict[str, deque[int]] = {}

    def add(self, camera: str, stamp_ns: int) -> None:
        """Take the stamp of a frame."""
        stamps = self._stamps.setdefault(camera, deque(maxlen=STAMPS_KEPT))
        if stamps and not 0 < stamp_ns - stamps[-1] < 1_000_000_000:
            stamps.clear()
        stamps.append(stamp_ns)

    def forget(self) -> None:
        """Forget all stamps: the cameras' rate may have changed."""
        self._stamps.clear()

    def estimate(self, rule: FrameDecimation = EVERY_FRAME) -> Exposures | None:
        """Return the grid that the stamps lie on; None while there are too few of them, or they lie on none.

        rule : under which they were kept; its grid is refined. Without one the period is that of the fastest camera.
        """
        self.off_grid = False
        if rule.keep < rule.of:
            return self._refined(Exposures(rule.phase_ns, rule.period_ns))
        if sum(len(stamps) - 1 for stamps in self._stamps.values()) < LEAST_STEPS:
            return None
        steps = np.concatenate([np.diff(stamps) for stamps in self._stamps.values()])
        shortest_ns = float(np.percentile(steps, LOW_PERCENTILE))
        counts = np.rint(steps / shortest_ns)
        fits = (counts <= LONGEST_STEP) & (np.abs(steps - counts * shortest_ns) < OFF_GRID * shortest_ns)
        if fits.sum() < LEAST_STEPS:
            return None
        period_ns = float(steps[fits].sum() / counts[fits].sum())
        newest_ns = max(stamps[-1] for stamps in self._stamps.values())
        return self._refined(Exposures(newest_ns, period_ns))

    def _refined(self, grid: Exposures) -> Exposures | None:
        """Return the line of stamps over exposure numbers (least squares); None where they do not lie on the grid."""
        if not self._stamps:
            return None
        offsets_ns = np.concatenate([[s - grid.phase_ns for s in stamps] for stamps in self._stamps.values()])
        # cameras that run freely expose up to half a period apart: centre the grid between them (circular mean)
        turns = np.exp(2j * np.pi * (offsets_ns / grid.period_ns))
        shift_ns = float(np.angle(turns.mean()) / (2 * np.pi) * grid.period_ns)
        numbers = np.rint((offsets_ns - shift_ns) / grid.period_ns)
        residuals_ns = offsets_ns - numbers * grid.period_ns
        if len(numbers) < LEAST_STEPS or np.ptp(numbers) == 0:
            return None
        slope_ns, at_mean_ns = np.polyfit(numbers - numbers.mean(), residuals_ns, 1)
        left_ns = residuals_ns - at_mean_ns - slope_ns * (numbers - numbers.mean())
        self.off_grid = bool(np.sqrt(np.mean(left_ns**2)) > OFF_GRID * grid.period_ns)
        if self.off_grid:
            return None
        period_ns = grid.period_ns + float(slope_ns)
        phase_ns = grid.phase_ns + round(float(at_mean_ns - slope_ns * numbers.mean()))
        return replace(grid, phase_ns=phase_ns, period_ns=period_ns)
