"""The X84 rejection rule (thesis 4.3, eq. 4.11), one-sided and with a floor.

The thesis discards pairs with ``|e - med e| > 3.5 * 1.4826 MAD``. Two corrections: a distance BELOW the median is
never an outlier, so the rule is one-sided; and the median absolute deviation of a nearly perfect set is nearly zero
and would discard half of it, so the scale never falls below a floor of a few millimetres.
"""

from __future__ import annotations

import numpy as np
from numba import njit

CUT = 3.5  # standard deviations (Hampel et al., "Robust Statistics", 1986)
MAD_TO_SIGMA = 1.4826  # a Gaussian's standard deviation over its median absolute deviation
SIGMA_FLOOR_M = 0.005


@njit(cache=True)
def x84_threshold(distances, floor=SIGMA_FLOOR_M):
    """Largest distance (m) that is kept of ``distances`` (n,), in m; infinite for an empty set."""
    if distances.shape[0] == 0:
        return np.inf
    centre = np.median(distances)
    sigma = MAD_TO_SIGMA * np.median(np.abs(distances - centre))
    return centre + CUT * max(sigma, floor)


@njit(cache=True)
def x84_keep(distances, group, groups, floor, keep):
    """Apply the rule to each group on its own; groups outside 0..groups-1 are not kept.

    ``distances`` (n,) m, ``group`` (n,) int, ``keep`` (n,) bool is written; returns the number kept.
    """
    n = distances.shape[0]
    keep[:] = False
    members = np.empty(n)
    kept = 0
    for g in range(groups):
        count = 0
        for i in range(n):
            if group[i] == g:
                members[count] = distances[i]
                count += 1
        limit = x84_threshold(members[:count], floor)
        for i in range(n):
            if group[i] == g and distances[i] <= limit:
                keep[i] = True
                kept += 1
    return kept
