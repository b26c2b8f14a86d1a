"""Silhouettes' rims in the all-joints solve: every ray along a rim touches the flesh.

A visual hull of few cameras is much fatter than the body, and its surface and centerline with it. The rays that bound
it are not: each one grazes the body's own surface, to a fraction of a pixel, at a place along it that only the figure
can tell (contour generators: Kutulakos & Seitz, IJCV 2000; the "bounding edges" of Cheung, Baker & Kanade, CVPR 2003).
So the residual is the distance between ray and flesh, along the rim's normal:

    e = n . (q - c) - r,    c on a capsule's axis and q on the ray, where they pass each other nearest

which is zero when the capsule of radius r shows its own rim there. The ray belongs to the capsule that explains it
best: nearest across the ray, on the right side of it, and not outside the stretch where the ray touches the hull.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from .point_factor import STICKS
from .surface_factor import LINE, spread_lines

REACH = 12  # row after three directions with their offsets
CAPSULE, ALONG, DISTANCE, SEPARATION = range(4)
PARALLEL_M2 = 1e-12  # keeps an axis that the ray sees as a point from dividing by zero


@njit(cache=True)
def add_contour_residuals(contour_rays, capsules, P, Q, match, weight, t0, A, axes, H, g):
    """Add every ray's distance ``match.distance`` to its capsule, with ``weight`` (n,) 1/m^2, to upper H and g."""
    capsule, along, distance, _ = match
    squares, pulls = np.zeros((STICKS, LINE, LINE)), np.zeros((STICKS, LINE))
    line = np.empty(LINE)
    for i in range(capsule.shape[0]):
        k, u, w = capsule[i], along[i], weight[i]
        c0 = P[k, 0] + u * (Q[k, 0] - P[k, 0])
        c1 = P[k, 1] + u * (Q[k, 1] - P[k, 1])
        c2 = P[k, 2] + u * (Q[k, 2] - P[k, 2])
        line[0], line[1], line[2] = contour_rays.normals[0, i], contour_rays.normals[1, i], contour_rays.normals[2, i]
        line[3] = c1 * line[2] - c2 * line[1]
        line[4] = c2 * line[0] - c0 * line[2]
        line[5] = c0 * line[1] - c1 * line[0]
        j = capsules.stick[k]
        for p in range(LINE):
            a = w * line[p]
            pulls[j, p] += a * distance[i]
            for q in range(LINE):
                squares[j, p, q] += a * line[q]
    spread_lines(squares, pulls, t0, A, axes, H, g)


@njit(cache=True, error_model="numpy")
def match_contour_rays(contour_rays, P, Q, radii, slack, match):
    """The capsule that explains each ray best, into ``match`` = capsule, along, distance and misfit (n,).

    ``along`` is the position on the capsule's axis, ``distance`` (m) is e above, ``misfit`` (m) adds what is off along
    the rim and beyond ``slack`` (m) from the stretch where the ray touches the hull.
    """
    n = match[0].shape[0]
    rows, best = np.empty((13, n)), np.empty((4, n))
    for i in range(n):
        for m, across in enumerate((contour_rays.normals, contour_rays.tangents, contour_rays.directions)):
            offset = 0.0
            for j in range(3):
                rows[4 * m + j, i] = across[j, i]
                offset += across[j, i] * contour_rays.points[j, i]
            rows[4 * m + 3, i] = offset
        rows[REACH, i] = contour_rays.half_lengths[i] + slack
        best[SEPARATION, i] = np.inf
    for k in range(P.shape[0]):
        match_capsule(k, P[k], Q[k], radii[k, 0], radii[k, 1] - radii[k, 0], rows, best)
    for i in range(n):
        match[0][i], match[1][i] = int(best[CAPSULE, i]), best[ALONG, i]
        match[2][i], match[3][i] = best[DISTANCE, i], np.sqrt(best[SEPARATION, i])


@njit(cache=True, error_model="numpy")  # a check for zero would keep it from being vectorised
def match_capsule(k, start, end, r0, dr, rows, best):
    """Offer one capsule to all rays. Two arrays, ``rows`` (13, n) to read and ``best`` (4, n) to improve: more of them,
    and the compiler could not tell that they do not overlap."""
    P0, P1, P2 = start[0], start[1], start[2]
    s0, s1, s2 = end[0] - P0, end[1] - P1, end[2] - P2
    number = float(k)
    for i in range(rows.shape[1]):
        # the axis as the ray sees it: across the rim (a, p), along it (b, q), in depth (c, s)
        a = rows[0, i] * P0 + rows[1, i] * P1 + rows[2, i] * P2 - rows[3, i]
        b = rows[4, i] * P0 + rows[5, i] * P1 + rows[6, i] * P2 - rows[7, i]
        c = rows[8, i] * P0 + rows[9, i] * P1 + rows[10, i] * P2 - rows[11, i]
        p = rows[0, i] * s0 + rows[1, i] * s1 + rows[2, i] * s2
        q = rows[4, i] * s0 + rows[5, i] * s1 + rows[6, i] * s2
        s = rows[8, i] * s0 + rows[9, i] * s1 + rows[10, i] * s2
        u = -(a * p + b * q) / (p * p + q * q + PARALLEL_M2)
        u = u if u > 0.0 else 0.0
        u = u if u < 1.0 else 1.0
        across = -(a + u * p) - (r0 + u * dr)
        aside = b + u * q
        depth = abs(c + u * s) - rows[REACH, i]
        depth = depth if depth > 0.0 else 0.0
        squared = across * across + aside * aside + depth * depth
        better = squared < best[SEPARATION, i]
        best[CAPSULE, i] = number if better else best[CAPSULE, i]
        best[ALONG, i] = u if better else best[ALONG, i]
        best[DISTANCE, i] = across if better else best[DISTANCE, i]
        best[SEPARATION, i] = squared if better else best[SEPARATION, i]


@njit(cache=True)
def contour_weights(separation, information, gate, weight):
    """Geman-McClure weights (n,) of the rays, 1/m^2, from their ``information`` (n,) 1/m^2."""
    for i in range(separation.shape[0]):
        ratio = 1.0 + (separation[i] / gate) ** 2
        weight[i] = information[i] / (ratio * ratio)
