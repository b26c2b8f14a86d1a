"""The foot point of every data point on the stick figure: the nearest point of the nearest stick.

Thesis Algorithm 2, step 3. (The text of its section 4.3 looks for the closest LINE first and falls back on end points;
that picks another stick for one point in five and contradicts Algorithm 2 and figure 4.4. This is Algorithm 2.)
"""

from __future__ import annotations

import numpy as np
from numba import njit

STICKS = 10


@njit(cache=True)
def foot_points(points, A, B, stick, along, feet, squared):
    """Project ``points`` (n, 3) onto all sticks from ``A`` to ``B`` (10, 3) and keep the nearest projection.

    Writes ``stick`` (n,) int, ``along`` (n,) in [0, 1] from A to B (clamped), ``feet`` (n, 3) and ``squared`` (n,),
    the squared distance; all in the frame and unit of the points.
    """
    stick[:] = 0
    along[:] = 0.0
    squared[:] = np.inf
    x, y, z = columns(points)
    for j in range(STICKS):
        prefer_stick(j, x, y, z, A[j], B[j], stick, along, squared)
    place_feet(A, B, stick, along, feet)


@njit(cache=True)
def columns(points):
    """The coordinates of ``points`` (n, 3) as three contiguous arrays (n,)."""
    n = points.shape[0]
    x, y, z = np.empty(n), np.empty(n), np.empty(n)
    for i in range(n):
        x[i], y[i], z[i] = points[i, 0], points[i, 1], points[i, 2]
    return x, y, z


@njit(cache=True)
def prefer_stick(j, x, y, z, start, end, stick, along, squared):
    """Move to stick ``j`` every point that is nearer to it than ``squared`` says; branch-free, so it is vectorised."""
    a0, a1, a2 = start[0], start[1], start[2]
    d0, d1, d2 = end[0] - a0, end[1] - a1, end[2] - a2
    length2 = d0 * d0 + d1 * d1 + d2 * d2
    inverse = 1.0 / length2 if length2 > 0.0 else 0.0
    for i in range(x.shape[0]):
        p, q, r = x[i] - a0, y[i] - a1, z[i] - a2
        u = (p * d0 + q * d1 + r * d2) * inverse
        u = u if u > 0.0 else 0.0
        u = u if u < 1.0 else 1.0
        p -= u * d0
        q -= u * d1
        r -= u * d2
        distance2 = p * p + q * q + r * r
        nearer = distance2 < squared[i]
        squared[i] = distance2 if nearer else squared[i]
        along[i] = u if nearer else along[i]
        stick[i] = j if nearer else stick[i]


@njit(cache=True)
def place_feet(A, B, stick, along, feet):
    """The foot points (n, 3) at ``along`` of their sticks."""
    for i in range(stick.shape[0]):
        j, u = stick[i], along[i]
        for k in range(3):
            feet[i, k] = A[j, k] + u * (B[j, k] - A[j, k])
