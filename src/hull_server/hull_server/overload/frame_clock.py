"""When the rig exposes: period and phase of its exposures, from the capture stamps that arrive."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, replace

import numpy as np

from mocap_packets.thinning import EVERY_FRAME, FrameDecimation

# Thresholds: chosen with the simulated graphs of test_hull_thinning_control.py, test_hull_frame_clock.py.
STAMPS_KEPT = 40  # of each camera: the period of 60 Hz to 3e-4 where stamps jitter by a millisecond
LEAST_STEPS = 8  # between neighbouring stamps, until a period is told
LOW_PERCENTILE = 10.0  # of the steps: cameras that lose frames or have half the rate make longer ones
LONGEST_STEP = 8  # periods: a longer gap tells nothing
OFF_GRID = 0.24  # of a period: stamps farther from the grid (rms; random ones: 0.29) do not lie on it


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
