"""Where exactly a silhouette's edge runs at a pixel, and which way it faces, from the pixels around it.

For a straight edge, the mask blurred by a Gaussian is the normal distribution of the distance from the edge, and its
gradient points across the edge (the edge model of Canny, 1986). So one look at a small window gives both, without an
image being blurred.
"""

from __future__ import annotations

import math
from statistics import NormalDist

import numpy as np
import numpy.typing as npt

from capture_rig.mask_levels import BACKGROUND, FOREGROUND

from ..kernel import kernel

RADIUS_PX, DOUBT_RADIUS_PX = 4, 2
PLACE_BLUR_PX, NORMAL_BLUR_PX = 1.0, 2.0  # a narrow blur for the place (curved edges shift less), a wide one to turn by
LEAST_SLOPE = 0.6  # of the gradient that a straight edge would have: less is a corner, or a thin or torn limb
MOST_FILLED = 0.95  # a pixel whose surroundings are filled beyond this is not at an edge
QUANTILE_STEPS = 256
QUANTILES = np.array(
    [NormalDist().inv_cdf(min(max(n, 1), QUANTILE_STEPS - 1) / QUANTILE_STEPS) for n in range(QUANTILE_STEPS + 1)]
)
ONE = 1 << 20  # weights are whole numbers: sums of those are exact in any order, so they may be done in parallel


def weights() -> npt.NDArray[np.int32]:
    """(3, 2 r + 1, 2 r + 1) weights of the pixels of a window, in units of 1 / ONE: a Gaussian for the place, sum 1;
    and for the normal, a Gaussian times the distance to the right, and times that downward."""
    steps = np.arange(-RADIUS_PX, RADIUS_PX + 1.0)
    squared = np.square(steps)[:, None] + np.square(steps)
    place, turn = (np.exp(-0.5 * squared / sigma**2) for sigma in (PLACE_BLUR_PX, NORMAL_BLUR_PX))
    turn /= turn.sum()
    return np.rint(ONE * np.stack([place / place.sum(), turn * steps, turn * steps[:, None]])).astype(np.int32)


@kernel
def find_edge(mask, u, v, weights):  # type: ignore[no-untyped-def]
    """Whether there is an edge, and its nearest point u, v and outward normal, pixels.

    The window around (u, v), a foreground pixel, must lie in the mask (h, w).
    """
    window = mask[v - RADIUS_PX : v + RADIUS_PX + 1, u - RADIUS_PX : u + RADIUS_PX + 1]
    filled, across, down = 0, 0, 0
    for j in range(2 * RADIUS_PX + 1):
        for i in range(2 * RADIUS_PX + 1):
            ones = -np.int32(window[j, i] != 0)
            filled += ones & weights[0, j, i]
            across += ones & weights[1, j, i]
            down += ones & weights[2, j, i]
    share, slope = filled / ONE, max(math.hypot(across, down), 1.0) / ONE
    if not 1.0 - MOST_FILLED < share < MOST_FILLED:
        return False, (0.0, 0.0, 0.0, 0.0)
    offset, straight = PLACE_BLUR_PX * normal_quantile(share), NORMAL_BLUR_PX / math.sqrt(2 * math.pi)
    right, below = -across / (ONE * slope), -down / (ONE * slope)  # of the normal
    return slope >= LEAST_SLOPE * straight, (u + offset * right, v + offset * below, right, below)


@kernel
def doubt_around(levels, u, v):  # type: ignore[no-untyped-def]
    """The share of doubtful pixels, neither background nor foreground, around (u, v) in a silhouette as sent."""
    size, doubtful = 2 * DOUBT_RADIUS_PX + 1, 0
    left, top = u - DOUBT_RADIUS_PX, v - DOUBT_RADIUS_PX
    window = levels[top : top + size, left : left + size]
    for j in range(size):
        for i in range(size):
            doubtful += (window[j, i] != BACKGROUND) & (window[j, i] != FOREGROUND)
    return doubtful / size**2


@kernel
def normal_quantile(share):  # type: ignore[no-untyped-def]
    """The value that a standard normal variable is below with this probability, 0.05 to 0.95."""
    row = int(share * QUANTILE_STEPS)
    return QUANTILES[row] + (share * QUANTILE_STEPS - row) * (QUANTILES[row + 1] - QUANTILES[row])
