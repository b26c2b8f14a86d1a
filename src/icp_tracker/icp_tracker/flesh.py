"""The flesh around the sticks: tapered capsules fixed to them, so that a hull's voxels can be compared with a body.

Radii and offsets are round fractions of an average adult's stature; on a rendered body they meet the surface within a
centimetre. The torso is three capsules side by side, wider than deep, which is what shows its heading; feet point
forward of the ankles.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit

from stick_figure.body import Body
from stick_figure.skeleton import HEAD, STICK_AXIS, STICK_SIGN

TORSO_CAPSULES = 3  # the first ones of the table
_CHEST_RADIUS, _PELVIS_RADIUS, _SPINE_RADIUS, _SIDE = 0.063, 0.066, 0.062, 0.45
_SHOULDER_DROP, _NECK_DROP = 0.03, 0.02  # the torso's capsules end this far below shoulders and neck
_HEAD_RADII, _HEAD_START, _CROWN = (0.045, 0.052), 0.25, 0.05
# stick: (start, end) as fractions of the stick, (radius at start, radius at end) over the stature
_LIMBS = {
    2: ((0.0, 1.0), (0.033, 0.025)), 3: ((0.0, 1.0), (0.033, 0.025)),
    6: ((0.0, 0.85), (0.025, 0.020)), 7: ((0.0, 0.85), (0.025, 0.020)),
    4: ((0.1, 1.0), (0.050, 0.034)), 5: ((0.1, 1.0), (0.050, 0.034)),
    8: ((0.0, 1.0), (0.034, 0.024)), 9: ((0.0, 1.0), (0.034, 0.024)),
}  # fmt: skip
_FOOT_RADIUS, _HEEL, _TOE, _SOLE = 0.020, -0.02, 0.09, 0.018
_CALVES = (8, 9)


class Flesh(NamedTuple):
    """Capsules as arrays: stick (k,) each is fixed to, start and end (k, 3) m in that stick's frame from its start,
    radii (k, 2) m at start and end."""

    stick: np.ndarray
    start: np.ndarray
    end: np.ndarray
    radii: np.ndarray

    @staticmethod
    def of(body: Body) -> Flesh:
        """The flesh of a body of average build."""
        capsules = [*_torso(body), _head(body), *_limbs(body), *_feet(body)]
        stick, start, end, radii = zip(*capsules, strict=True)
        return Flesh(np.array(stick), np.array(start, float), np.array(end, float), np.array(radii) * body.stature)


def _torso(body: Body) -> list[tuple]:
    H, h, y = body.stature, body.half_lengths[0], _SIDE * body.half_shoulder_width
    shoulders = (1.0 + body.shoulder_height_ratio) * h - _SHOULDER_DROP * H
    neck = 1.9 * h - _NECK_DROP * H
    sides = [(0, (0.0, s * y, shoulders), (0.0, s * y, 0.0), (_CHEST_RADIUS, _PELVIS_RADIUS)) for s in (1.0, -1.0)]
    return [*sides, (0, (0.0, 0.0, neck), (0.0, 0.0, 0.0), (_SPINE_RADIUS, _PELVIS_RADIUS))]


def _head(body: Body) -> tuple:
    length = body.lengths[HEAD]
    return HEAD, (0.0, 0.0, _HEAD_START * length), (0.0, 0.0, length - _CROWN * body.stature), _HEAD_RADII


def _limbs(body: Body) -> list[tuple]:
    capsules = []
    for stick, (extent, radii) in _LIMBS.items():
        along = np.zeros((2, 3))
        along[:, STICK_AXIS[stick]] = np.array(extent) * STICK_SIGN[stick] * body.lengths[stick]
        capsules.append((stick, tuple(along[0]), tuple(along[1]), radii))
    return capsules


def _feet(body: Body) -> list[tuple]:
    H = body.stature
    return [
        (
            calf,
            (_HEEL * H, 0.0, -body.lengths[calf] - _SOLE * H),
            (_TOE * H, 0.0, -body.lengths[calf] - _SOLE * H),
            (_FOOT_RADIUS, _FOOT_RADIUS),
        )
        for calf in _CALVES
    ]


@njit(cache=True)
def place_flesh(flesh, G, A, P, Q):
    """World ends P, Q (k, 3) of the capsules, from stick frames G (10, 3, 3) and stick starts A (10, 3)."""
    for k in range(flesh.stick.shape[0]):
        j = flesh.stick[k]
        for i in range(3):
            P[k, i] = A[j, i]
            Q[k, i] = A[j, i]
            for q in range(3):
                P[k, i] += G[j, i, q] * flesh.start[k, q]
                Q[k, i] += G[j, i, q] * flesh.end[k, q]


@njit(cache=True)
def nearest_flesh(x, y, z, P, Q, radii, capsule, along, distance):
    """The capsule nearest to each point (n,): its index, the position along its axis, and the signed distance to its
    surface (m, negative inside). Branch-free inside, so it is vectorised."""
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
