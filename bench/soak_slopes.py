"""Trends of what a process holds over hours, with confidence: samples of one process are anything but independent.

The slope is Theil and Sen's (the median of all pairs' slopes), which a few leaps do not move. Its 95 % confidence
interval comes from a block bootstrap of the residuals (Kuensch, Annals of Statistics 1989): whole blocks are drawn, so
that what lasts for minutes in the samples lasts for minutes in the resamples, too.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.stats import theilslopes

BIN_S = 60.0  # samples are reduced to medians of a minute: faults and motion come and go within it
BLOCK_S = 600.0  # longer than a fault, its recovery and the calm after it (docs/faults.md)
RESAMPLES, CONFIDENCE_PERCENT = 400, (2.5, 97.5)
WARM_UP_S = 600.0  # left out after a process's start: kernels are loaded, buffers and caches fill
LEAST_BINS = 10
FLAT_SHARE_PER_DAY = 0.1  # growth that is allowed: a tenth of what is held, in a day


@dataclass(frozen=True)
class Trend:
    """Growth per hour with its 95 % interval, of a quantity with this typical size; ``hours`` were looked at."""

    per_hour: float
    low: float
    high: float
    typical: float
    hours: float

    @property
    def verdict(self) -> str:
        """ "flat" when the interval has zero in it, else which way it goes; "slight" below FLAT_SHARE_PER_DAY."""
        if not np.isfinite(self.per_hour):
            return "too short"
        if self.low <= 0.0 <= self.high:
            return "flat"
        slight = 24.0 * max(abs(self.low), abs(self.high)) <= FLAT_SHARE_PER_DAY * self.typical
        return f"{'slight ' if slight else ''}{'growth' if self.per_hour > 0 else 'fall'}"


def trend(unix_s: np.ndarray, values: np.ndarray, seed: int = 0) -> Trend:
    """Return the trend of values (N,) at instants (N,), s; NaN where there are fewer than LEAST_BINS minutes."""
    bins = ((unix_s - unix_s[0]) // BIN_S).astype(int) if len(unix_s) else np.zeros(0, int)
    minutes = np.unique(bins)
    if len(minutes) < LEAST_BINS:
        typical = float(np.median(values)) if len(values) else np.nan
        return Trend(np.nan, np.nan, np.nan, typical, len(minutes) * BIN_S / 3600.0)
    hours = minutes * BIN_S / 3600.0
    medians = np.array([np.median(values[bins == minute]) for minute in minutes])
    slope, intercept = theilslopes(medians, hours)[:2]
    residuals = medians - intercept - slope * hours
    rng, block = np.random.default_rng(seed), min(round(BLOCK_S / BIN_S), len(minutes) // 2)
    slopes = []
    for _ in range(RESAMPLES):
        starts = rng.integers(0, len(minutes) - block + 1, -(-len(minutes) // block))
        drawn = np.concatenate([residuals[start : start + block] for start in starts])[: len(minutes)]
        slopes.append(theilslopes(slope * hours + drawn, hours)[0])
    low, high = np.percentile(slopes, CONFIDENCE_PERCENT)
    return Trend(float(slope), float(low), float(high), float(np.median(medians)), float(hours[-1] - hours[0]))
