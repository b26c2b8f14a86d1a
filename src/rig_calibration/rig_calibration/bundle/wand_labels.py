"""Which bright spot is which marker of the wand.

Markers on a line at positions s_i appear on a line of the image at u_i = (a s_i + b) / (c s_i + 1): with four and more
the cross ratio tells whether spots are a wand, with three the spacing does, because the far end of a wand of that
length cannot be much farther away than the near end: z_far / z_near = 1 + c (s_far - s_near), from s_near counted.
"""

from __future__ import annotations

from itertools import combinations

import numpy as np

from .rigid import Array

MAX_BLOBS = 10
OFF_LINE = 0.02  # of the wand's length in the image: a spot farther from the line is no marker
OFF_PLACE = 0.02  # likewise along the line
DEEPEST = 1.6  # far end over near end, in distance: a wand seen from less than twice its length away is refused


def label_markers(points: Array, marks_m: Array) -> Array | None:
    """Rows of ``points`` (n, 2), undistorted, brightest first, that are the markers at ``marks_m`` (k,), in that order.

    None when no k of them can be the wand. Of a wand that looks the same from both ends, either order.
    """
    best, chosen = np.inf, None
    for rows in combinations(range(min(len(points), MAX_BLOBS)), len(marks_m)):
        along = _on_a_line(points[list(rows)])
        if along is None:
            continue
        order = np.asarray(rows)[np.argsort(along)]
        for candidate, u in ((order, np.sort(along)), (order[::-1], np.sort(-along))):
            cost = _cost(u, marks_m)
            if cost < best - 1e-12:
                best, chosen = cost, candidate
    return chosen


def _on_a_line(points: Array) -> Array | None:
    """(k,) places along the line through the points; None when they lie on none, or coincide."""
    centred = points - points.mean(0)
    _, _, axes = np.linalg.svd(centred, full_matrices=True)
    along, across = centred @ axes[0], centred @ axes[1]
    length = np.ptp(along)
    return along if length > 0 and np.abs(across).max() <= OFF_LINE * length else None


def _cost(u: Array, marks_m: Array) -> float:
    """How unlike a wand: the places' misfit and the depth that they imply; infinite when it cannot be one.

    Both ``u`` and ``marks_m`` rise.
    """
    s = (marks_m - marks_m[0]) / (marks_m[-1] - marks_m[0])
    u = (u - u[0]) / (u[-1] - u[0])
    if len(s) == 2:
        return 0.0
    # u = (a s) / (c s + 1) with u(1) = 1: a = 1 + c, hence u - s = c s (1 - u), and 1 + c = z_far / z_near
    weight = (s * (1 - u))[1:-1]
    c = float(weight @ (u - s)[1:-1] / (weight @ weight))
    if not 1 / DEEPEST <= 1 + c <= DEEPEST:
        return np.inf
    misfit = float(np.abs((1 + c) * s / (c * s + 1) - u).max())
    return misfit / OFF_PLACE + abs(np.log(1 + c)) if misfit <= OFF_PLACE else np.inf
