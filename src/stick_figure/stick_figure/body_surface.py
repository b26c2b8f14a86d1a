"""The body's surface: tapered capsules fixed to the sticks, which silhouettes and hulls are compared with.

Radii and offsets follow the body's lengths and its build (`build.py`), and anatomy where it matters: the trunk is wider
than deep and lies in front of the line from hips to neck, the thigh bulges forward, the calf backward; feet point
forward of the ankles.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from capture_rig.kernel import kernel
from stick_figure.body import Body
from stick_figure.build import capsule_numbers


class BodySurface(NamedTuple):
    """Capsules as arrays: stick (k,) each is fixed to, start and end (k, 3) m in that stick's frame from its start,
    radii (k, 2) m at start and end."""

    stick: np.ndarray
    start: np.ndarray
    end: np.ndarray
    radii: np.ndarray

    @staticmethod
    def of(body: Body) -> BodySurface:
        """Return the surface of a body."""
        stick, numbers = capsule_numbers(body)
        start, end, radii = (np.ascontiguousarray(part) for part in np.split(numbers, [3, 6], axis=1))
        return BodySurface(stick, start, end, radii)


@kernel
def place_capsules(capsules, G, A, P, Q):
    """World ends P, Q (k, 3) of the capsules, from stick frames G (10, 3, 3) and stick starts A (10, 3)."""
    for k in range(capsules.stick.shape[0]):
        place_capsule(k, capsules, G, A, P, Q)


@kernel
def place_capsule(k, capsules, G, A, P, Q):
    """World ends P[k], Q[k] of one capsule."""
    j = capsules.stick[k]
    for i in range(3):
        P[k, i] = A[j, i]
        Q[k, i] = A[j, i]
        for q in range(3):
            P[k, i] += G[j, i, q] * capsules.start[k, q]
            Q[k, i] += G[j, i, q] * capsules.end[k, q]


@kernel
def nearest_capsule(x, y, z, P, Q, radii, capsule, along, distance):
    """Find the capsule nearest to each point (n,): its index, the place along its axis, and the signed distance (n,) m
    from its surface, negative inside. Branch-free inside, so it is vectorised."""
    distance[:] = np.inf
    for k in range(P.shape[0]):
        a0, a1, a2 = P[k, 0], P[k, 1], P[k, 2]
        d0, d1, d2 = Q[k, 0] - a0, Q[k, 1] - a1, Q[k, 2] - a2
        inverse = 1.0 / (d0 * d0 + d1 * d1 + d2 * d2)
        r0, dr = radii[k, 0], radii[k, 1] - radii[k, 0]
        for i in range(x.shape[0]):
            p, q, r = x[i] - a0, y[i] - a1, z[i] - a2
            u = (p * d0 + q * d1 + r * d2) * inverse
            u = u if u > 0.0 else 0.0
            u = u if u < 1.0 else 1.0
            p -= u * d0
            q -= u * d1
            r -= u * d2
            e = np.sqrt(p * p + q * q + r * r) - (r0 + u * dr)
            nearer = e < distance[i]
            distance[i] = e if nearer else distance[i]
            along[i] = u if nearer else along[i]
            capsule[i] = k if nearer else capsule[i]
