"""The body's surface: tapered capsules fixed to the sticks, which silhouettes and hulls are compared with.

Radii and offsets are round fractions of an average adult's stature; on a rendered body most of them meet the surface
within a centimetre. They follow anatomy where it matters: the trunk is wider than deep and lies in front of the line
from hips to neck, the thigh bulges forward, the calf backward; feet point forward of the ankles.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from capture_rig.kernel import kernel
from stick_figure.body import Body
from stick_figure.skeleton import (
    HEAD,
    L_CALF,
    L_FOREARM,
    L_THIGH,
    L_UPPER_ARM,
    R_CALF,
    R_FOREARM,
    R_THIGH,
    R_UPPER_ARM,
    STICK_AXIS,
    STICK_SIGN,
)

TORSO_CAPSULES = 3  # the first ones of the table: both sides and the spine
# of the stature, unless said otherwise
_SIDE, _CHEST_FORWARD, _PELVIS_FORWARD = 0.27, 0.008, 0.011  # the sides' place: of half the shoulders' width
_CHEST_RADIUS, _PELVIS_RADIUS, _SPINE_RADII = 0.068, 0.065, (0.062, 0.072)
_SHOULDER_DROP, _NECK_DROP = 0.007, 0.027  # sides and spine end this far below shoulders and neck
_GIRDLE_BACK, _GIRDLE_RISE, _GIRDLE_DROP, _GIRDLE_RADII = -0.007, 0.014, 0.007, (0.046, 0.043)
_HEAD_RADII, _CHIN_FORWARD, _CHIN, _CROWN = (0.045, 0.052), 0.014, 0.35, 0.052  # the chin's height: of the stick
# sticks: (start, end) as fractions of the stick, offsets (of legs forward, of arms to the back of the hand: relaxed
# fingers bend to the palm, so that the wrist lies off the line from elbow to finger tips) and radii over the stature
_LIMBS = (
    ((L_UPPER_ARM, R_UPPER_ARM), (0.0, 0.92), (0.0, 0.0), (0.034, 0.026)),
    ((L_FOREARM, R_FOREARM), (0.0, 0.57), (0.0, 0.008), (0.026, 0.016)),
    ((L_FOREARM, R_FOREARM), (0.62, 0.925), (0.009, 0.003), (0.018, 0.014)),
    ((L_THIGH, R_THIGH), (0.22, 0.93), (0.017, 0.003), (0.057, 0.037)),
    ((L_CALF, R_CALF), (0.16, 0.94), (-0.017, -0.006), (0.039, 0.023)),
)
_OFFSET = {L_FOREARM: (2, 1.0), R_FOREARM: (2, -1.0)}  # the axis of a stick's frame that points there; else forward
_FOOT_RADII, _HEEL, _TOE, _SOLE = (0.019, 0.022), -0.015, 0.08, (0.021, 0.017)


class BodySurface(NamedTuple):
    """Capsules as arrays: stick (k,) each is fixed to, start and end (k, 3) m in that stick's frame from its start,
    radii (k, 2) m at start and end."""

    stick: np.ndarray
    start: np.ndarray
    end: np.ndarray
    radii: np.ndarray

    @staticmethod
    def of(body: Body) -> BodySurface:
        """Return the surface of a body of average build."""
        capsules = [*_torso(body), *_girdle(body), _head(body), *_limbs(body), *_feet(body)]
        stick, start, end, radii = zip(*capsules, strict=True)
        return BodySurface(
            np.array(stick), np.array(start, float), np.array(end, float), np.array(radii) * body.stature
        )


def _torso(body: Body) -> list[tuple]:
    H, h, y = body.stature, body.half_lengths[0], _SIDE * body.half_shoulder_width
    shoulders, neck = (1.0 + body.shoulder_height_ratio) * h - _SHOULDER_DROP * H, 1.9 * h - _NECK_DROP * H
    chest, pelvis = _CHEST_FORWARD * H, _PELVIS_FORWARD * H
    sides = [(0, (chest, s * y, shoulders), (pelvis, s * y, 0.0), (_CHEST_RADIUS, _PELVIS_RADIUS)) for s in (1.0, -1.0)]
    return [*sides, (0, (pelvis, 0.0, neck), (pelvis, 0.0, 0.0), _SPINE_RADII)]


def _girdle(body: Body) -> list[tuple]:
    """From the foot of the neck to each shoulder."""
    H, w, height = body.stature, body.half_shoulder_width, (1.0 + body.shoulder_height_ratio) * body.half_lengths[0]
    inner, outer = (_GIRDLE_BACK * H, 0.3 * w, height + _GIRDLE_RISE * H), (0.0, 0.9 * w, height - _GIRDLE_DROP * H)
    return [(0, _to_side(inner, s), _to_side(outer, s), _GIRDLE_RADII) for s in (1.0, -1.0)]


def _head(body: Body) -> tuple:
    length, H = body.lengths[HEAD], body.stature
    return HEAD, (_CHIN_FORWARD * H, 0.0, _CHIN * length), (0.0, 0.0, length - _CROWN * H), _HEAD_RADII


def _limbs(body: Body) -> list[tuple]:
    capsules = []
    for sticks, extent, offset, radii in _LIMBS:
        for stick in sticks:
            ends = np.zeros((2, 3))
            axis, sign = _OFFSET.get(stick, (0, 1.0))
            ends[:, axis] = sign * np.array(offset) * body.stature
            ends[:, STICK_AXIS[stick]] = np.array(extent) * STICK_SIGN[stick] * body.lengths[stick]
            capsules.append((stick, tuple(ends[0]), tuple(ends[1]), radii))
    return capsules


def _feet(body: Body) -> list[tuple]:
    H = body.stature
    return [
        (
            calf,
            (_HEEL * H, 0.0, -body.lengths[calf] - _SOLE[0] * H),
            (_TOE * H, 0.0, -body.lengths[calf] - _SOLE[1] * H),
            _FOOT_RADII,
        )
        for calf in (L_CALF, R_CALF)
    ]


def _to_side(point: tuple[float, float, float], side: float) -> tuple[float, float, float]:
    return point[0], side * point[1], point[2]


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
