"""The outlines of a silhouette, followed between its pixels, and points evenly along them.

An outline runs on cracks, the edges between a foreground and a background pixel, with the foreground on its right;
foreground pixels that touch in a corner belong together. Outer outlines and those of holes are treated alike. Every
outline has a crack that runs along the top of a pixel, so looking at these finds them all.

A corner has the coordinates of the pixel to the lower right of it.
"""

from __future__ import annotations

import math
from statistics import NormalDist

import numpy as np
import numpy.typing as npt

from capture_rig.mask_levels import BACKGROUND, FOREGROUND

from ..kernel import kernel

CORNER_PX = math.sqrt(0.5)  # from the middle of a crack to that of the next, around a corner; straight on it is 1


@kernel
def pick_contour_pixels(mask, box, scratch, rules, pixels):  # type: ignore[no-untyped-def]
    """Write foreground pixels, u and v, at equal distances along all outlines in a box to ``pixels`` (most, 2); return
    how many.

    mask (h, w) uint8, nonzero is foreground. box (left, top, right, bottom), left and right multiples of 8: what lies
    outside counts as background. rules : outlines shorter than the first, in pixels, are left out; the distance is the
    second, or as much more as the size of ``pixels`` asks for.
    scratch : marks (H, W) uint8, none of which equals stamp; ends, path and along as :func:`_find_outlines` says.
    """
    (shortest_px, spacing_px), n, begin = rules, 0, 0
    count, total = _find_outlines(mask, box, scratch, shortest_px)
    step = max(spacing_px, total / pixels.shape[0])
    for outline in range(count):
        end = scratch.ends[outline]
        path, along = scratch.path[begin:end], scratch.along[begin:end]
        wanted = min(int(along[-1] / step), pixels.shape[0] - n)
        _spread(path, along, pixels[n : n + wanted])
        n, begin = n + wanted, end
    return n


@kernel
def _find_outlines(mask, box, scratch, shortest_px):  # type: ignore[no-untyped-def]
    """Write the outlines' foreground pixels one behind the other to ``path`` (m, 2), the distance up to the end of each
    pixel's crack to ``along`` (m,), and where each outline ends to ``ends``; return how many, and their length."""
    (left, top, right, bottom), words = box, mask.view(np.uint64)
    count, total, begin = 0, 0.0, 0
    for v in range(top, bottom):
        for word in range(left // 8, right // 8):
            above = words[v - 1, word] if v > top else np.uint64(0)
            if words[v, word] & ~above == 0:
                continue
            for u in range(8 * word, 8 * word + 8):
                is_top = mask[v, u] != 0 and (v == top or mask[v - 1, u] == 0)
                if is_top and scratch.marks[v, u] != scratch.stamp:
                    end = _follow(mask, box, scratch, u, v, begin)
                    if scratch.along[end - 1] >= shortest_px:
                        total += scratch.along[end - 1]
                        scratch.ends[count] = begin = end
                        count += 1
    return count, total


@kernel
def _follow(mask, box, scratch, u, v, n):  # type: ignore[no-untyped-def]
    """Append the outline along the top of a pixel to ``path`` and ``along``; return the new number of rows. Pixels that
    it runs along the top of are marked.

    No branches, as the way is not foreseeable.
    """
    x, y, dx, dy, length = u, v, 1, 0, 0.0
    while True:
        # the foreground pixel to the right of this crack
        inside_u, inside_v = x + (dx - dy - 1) // 2, y + (dx + dy - 1) // 2
        scratch.path[n, 0], scratch.path[n, 1] = inside_u, inside_v
        if dx == 1:
            scratch.marks[inside_v, inside_u] = scratch.stamp
        # ahead to the left there is foreground: turn left; to the right there is none: turn right
        x, y = x + dx, y + dy
        left = _filled(mask, box, x + (dx + dy - 1) // 2, y + (dy - dx - 1) // 2)
        right = _filled(mask, box, x + (dx - dy - 1) // 2, y + (dx + dy - 1) // 2)
        straight, turn = right & (1 - left), left - (1 - left) * (1 - right)
        dx, dy = straight * dx + turn * dy, straight * dy - turn * dx
        length += CORNER_PX + straight * (1.0 - CORNER_PX)
        scratch.along[n] = length
        n += 1
        if x == u and y == v and dx == 1:
            return n


@kernel
def _filled(mask, box, u, v):  # type: ignore[no-untyped-def]
    """1 for foreground, else 0."""
    left, top, right, bottom = box
    inside = (np.uint64(u - left) < np.uint64(right - left)) & (np.uint64(v - top) < np.uint64(bottom - top))
    return np.int64(mask[np.uint64(v * inside), np.uint64(u * inside)] != 0) & np.int64(inside)


@kernel
def _spread(path, along, pixels):  # type: ignore[no-untyped-def]
    """Fill in pixels of a path at equal distances."""
    step = along[-1] / max(pixels.shape[0], 1)
    crack = 0
    for n in range(pixels.shape[0]):
        while along[crack] < (n + 0.5) * step:
            crack += 1
        pixels[n, 0], pixels[n, 1] = path[crack, 0], path[crack, 1]


# --- Where exactly a silhouette's edge runs at a pixel, and which way it faces, from the pixels around it.
#
# For a straight edge, the mask blurred by a Gaussian is the normal distribution of the distance from the edge, and its
# gradient points across the edge (the edge model of Canny, 1986). So one look at a small window gives both, without an
# image being blurred.

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
