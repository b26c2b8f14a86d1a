"""Traces the outlines of a silhouette, samples them evenly, and finds the edge at each sample to a fraction of a
pixel.

An outline runs along cracks, the sides between a foreground and a background pixel, with the foreground on its right;
foreground pixels that touch in a corner belong together. Outer outlines and holes are treated alike. Every outline has
a crack along the top of some pixel, so testing the tops of all pixels finds every outline. A crack's corner has the
coordinates of the pixel to its lower right.

For a straight edge, the mask blurred by a Gaussian is the normal distribution of the distance from the edge, and its
gradient is perpendicular to the edge (the edge model of Canny, 1986). So one small window of pixels gives both place
and normal, without blurring the image.
"""

from __future__ import annotations

import math
from statistics import NormalDist

import numpy as np
import numpy.typing as npt

from capture_rig.kernel import kernel
from capture_rig.mask_levels import BACKGROUND, FOREGROUND, SHADOW_CANDIDATE

from ..bitset import lowest_bit

CORNER_PX = math.sqrt(0.5)  # from the middle of a crack to that of the next, around a corner; straight on it is 1
# Thresholds: chosen as those of contour_tracer.py.
RADIUS_PX, SHADOW_RADIUS_PX = 4, 2
PLACE_BLUR_PX, NORMAL_BLUR_PX = 1.0, 2.0  # narrow for the place (curved edges shift less), wide for the normal
LEAST_SLOPE = 0.6  # of a straight edge's gradient: less is a corner, or a thin or torn limb
MOST_FILLED = 0.95  # a pixel whose surroundings are filled more is not at an edge
STRETCH = 16  # words of a row that are tested together
QUANTILE_STEPS = 256
QUANTILES = np.array(
    [NormalDist().inv_cdf(min(max(n, 1), QUANTILE_STEPS - 1) / QUANTILE_STEPS) for n in range(QUANTILE_STEPS + 1)]
)
ONE = 1 << 20  # weights are whole numbers, whose sums are exact in any order, so that they vectorise


@kernel
def pick_contour_pixels(mask, box, scratch, limits, pixels):  # type: ignore[no-untyped-def]
    """Write foreground pixels u, v at equal distances along all outlines in a box to ``pixels`` (most, 2); return how
    many.

    mask (h, w) uint8, foreground above 127. box (left, top, right, bottom), left and right multiples of 8; outside is
    background. limits : shortest outline, and least distance, in pixels; the distance grows if ``pixels`` is too small.
    scratch : marks (H, W) uint8; ends, path and along as in :func:`_find_outlines`; filled (H + 2, W + 16) uint8.
    """
    (shortest_px, spacing_px), n, begin = limits, 0, 0
    _copy_box(mask, box, scratch.filled, scratch.marks)
    count, total = _find_outlines(box, scratch, shortest_px)
    step = max(spacing_px, total / pixels.shape[0])
    for outline in range(count):
        end = scratch.ends[outline]
        path, along = scratch.path[begin:end], scratch.along[begin:end]
        wanted = min(int(along[-1] / step), pixels.shape[0] - n)
        _spread(path, along, pixels[n : n + wanted])
        n, begin = n + wanted, end
    return n


@kernel
def _find_outlines(box, scratch, shortest_px):  # type: ignore[no-untyped-def]
    """Find all outlines in a box; return how many, and their length.

    Writes their foreground pixels to ``path`` (m, 2), the distance up to the end of each pixel's crack to ``along``
    (m,), and the row at which each outline ends to ``ends``.
    """
    (left, top, right, bottom), words = box, scratch.filled.view(np.uint64)
    count, total, begin = 0, 0.0, 0
    for v in range(top, bottom):
        for first in range(left // 8, right // 8, STRETCH):
            last = min(first + STRETCH, right // 8)
            row, above, any_ = words[v + 1, first + 1 : last + 1], words[v, first + 1 : last + 1], np.uint64(0)
            for word in range(row.size):  # no branch inside: the compiler does several words at a time
                any_ |= row[word] & ~above[word]
            if any_ == 0:
                continue
            for word in range(row.size):
                tops = row[word] & ~above[word]
                while tops:
                    u = 8 * (first + word) + (lowest_bit(tops) >> 3)
                    tops &= tops - np.uint64(1)
                    if scratch.marks[v, u] == 0:
                        end = _trace(scratch, u, v, begin)
                        if scratch.along[end - 1] >= shortest_px:
                            total += scratch.along[end - 1]
                            scratch.ends[count] = begin = end
                            count += 1
    return count, total


@kernel
def _trace(scratch, u, v, n):  # type: ignore[no-untyped-def]
    """Append the outline along the top of a pixel to ``path`` and ``along``; return the new number of rows.

    Marks the pixels along whose top it runs. Has no branches, which could not be predicted.
    """
    x, y, dx, dy, length = u, v, 1, 0, 0.0
    while True:
        # the foreground pixel to the right of this crack
        inside_u, inside_v = x + (dx - dy - 1) // 2, y + (dx + dy - 1) // 2
        scratch.path[n, 0], scratch.path[n, 1] = inside_u, inside_v
        if dx == 1:
            scratch.marks[inside_v, inside_u] = 1
        # ahead to the left there is foreground: turn left; to the right there is none: turn right
        x, y = x + dx, y + dy
        left = _filled(scratch.filled, x + (dx + dy - 1) // 2, y + (dy - dx - 1) // 2)
        right = _filled(scratch.filled, x + (dx - dy - 1) // 2, y + (dx + dy - 1) // 2)
        straight, turn = right & (1 - left), left - (1 - left) * (1 - right)
        dx, dy = straight * dx + turn * dy, straight * dy - turn * dx
        length += CORNER_PX + straight * (1.0 - CORNER_PX)
        scratch.along[n] = length
        n += 1
        if x == u and y == v and dx == 1:
            return n


@kernel
def _filled(filled, u, v):  # type: ignore[no-untyped-def]
    """Return 1 for foreground, else 0."""
    return np.int64(filled[np.uint64(v + 1), np.uint64(u + 8)])


@kernel
def _copy_box(mask, box, filled, marks):  # type: ignore[no-untyped-def]
    """Write the box of a mask, 1 for foreground, in a margin of background: pixel (u, v) at row v + 1, column u + 8;
    clear the marks (H, W) there."""
    left, top, right, bottom = box
    filled[top, left + 7 : right + 9] = 0
    filled[bottom + 1, left + 7 : right + 9] = 0
    for v in range(top, bottom):
        row, pixels = filled[v + 1, left + 7 : right + 9], mask[v, left:right]
        row[0], row[row.size - 1] = 0, 0
        for u in range(pixels.size):
            row[u + 1] = pixels[u] > SHADOW_CANDIDATE
        own = marks[v, left:right]
        for u in range(own.size):
            own[u] = 0


@kernel
def _spread(path, along, pixels):  # type: ignore[no-untyped-def]
    """Sample a path at equal distances into ``pixels``."""
    step = along[-1] / max(pixels.shape[0], 1)
    crack = 0
    for n in range(pixels.shape[0]):
        while along[crack] < (n + 0.5) * step:
            crack += 1
        pixels[n, 0], pixels[n, 1] = path[crack, 0], path[crack, 1]


def weights() -> npt.NDArray[np.int32]:
    """Return the weights (3, 2 r + 1, 2 r + 1) of a window's pixels, in units of 1 / ONE.

    For the place a Gaussian of sum 1; for the normal a Gaussian times the distance to the right, and downward.
    """
    steps = np.arange(-RADIUS_PX, RADIUS_PX + 1.0)
    squared = np.square(steps)[:, None] + np.square(steps)
    place, turn = (np.exp(-0.5 * squared / sigma**2) for sigma in (PLACE_BLUR_PX, NORMAL_BLUR_PX))
    turn /= turn.sum()
    return np.rint(ONE * np.stack([place / place.sum(), turn * steps, turn * steps[:, None]])).astype(np.int32)


@kernel
def find_edge(mask, u, v, weights):  # type: ignore[no-untyped-def]
    """Return whether there is an edge near foreground pixel (u, v), and its nearest point and outward normal, pixels.

    The window around (u, v) must lie in the mask (h, w).
    """
    window = mask[v - RADIUS_PX : v + RADIUS_PX + 1, u - RADIUS_PX : u + RADIUS_PX + 1]
    filled, across, down = 0, 0, 0
    for j in range(2 * RADIUS_PX + 1):
        for i in range(2 * RADIUS_PX + 1):
            ones = -np.int32(window[j, i] > SHADOW_CANDIDATE)
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
def shadow_share(levels, u, v):  # type: ignore[no-untyped-def]
    """Return the share of pixels around (u, v) that are neither background nor foreground."""
    size, count = 2 * SHADOW_RADIUS_PX + 1, 0
    left, top = u - SHADOW_RADIUS_PX, v - SHADOW_RADIUS_PX
    window = levels[top : top + size, left : left + size]
    for j in range(size):
        for i in range(size):
            count += (window[j, i] != BACKGROUND) & (window[j, i] != FOREGROUND)
    return count / size**2


@kernel
def normal_quantile(share):  # type: ignore[no-untyped-def]
    """Return the quantile of the standard normal distribution, for shares of 0.05 to 0.95."""
    row = int(share * QUANTILE_STEPS)
    return QUANTILES[row] + (share * QUANTILE_STEPS - row) * (QUANTILES[row + 1] - QUANTILES[row])
