"""Joint limits as soft residuals of the fit, of the body's refinement and of the filter (compiled).

A residual is the part of an angle that lies beyond its range (`skeleton.ANGLE_LOW`, `ANGLE_HIGH`; elbows and knees stop
where forearm meets upper arm and calf meets thigh). Inside it is zero, so feasible poses are estimated exactly as
without limits. An elbow or knee that passes straight by more than a margin can also be described the other way round,
with the upper limb turned by pi about itself; it meets a limit only if that description is no better. (A limit in any
case would trap limbs whose upper part was turned the wrong way. The fit, which bends hinges the right way again
afterwards, sets no such limit at all: its margin is infinite.)

Joint rates are limited, too: a straight leg hardly shows the twist of its thigh, and a filter would take noise for
twists that no hip makes, which displace the foot as soon as the knee bends.
"""

from __future__ import annotations

import math

import numpy as np

from capture_rig.kernel import njit

from .kernels import HINGE_SLOT, SLOT_OF_JOINT_AXIS
from .rotations import excess_over_range, wrap_into_range
from .skeleton import ANGLE_HIGH, ANGLE_LOW, BALL_ANGLES, BALL_EULER_AXES, HINGE_ANGLES

# Thresholds: rates from kicks and throws in the literature, hips checked by the spinning kicks of python
# bench/people.py (35 rad/s lets some feet jump, 15 to 25 none); else judgement.
LIMIT_SD_RAD = 0.2  # of angles beyond their range
LARGEST_FLEXION = 2.6  # rad, where forearm meets upper arm and calf meets thigh
FLATTEST = 0.2
"""Cosine of a limb's second angle below which its first and third turn about almost the same axis: no limit there."""
NECK_SD, NECK_PITCH = 0.25, 0.1  # rad, of the head about its rest, forward of the torso's axis
NECK_SLOTS = (6, 7)
BALL_RATES = np.array((np.inf, np.inf, np.inf, 20.0, 20.0))
"""Largest rates of neck, shoulders and hips, rad/s. Kicks turn a hip at 15; throws turn a shoulder at more than 100."""
HINGE_RATES = np.array((50.0, 50.0, 45.0, 45.0))
"""Largest rates of elbows and knees, rad/s. Throws stretch an elbow at 40 (Fleisig et al. 1995), kicks a knee at 30."""


@njit(cache=True)
def add_joint_limits(RJ, hinges, hinge_margin, weight, H, g):
    """Add the excess of joints RJ (5, 3, 3) and hinges (4,) over their ranges, ``weight`` in 1/rad^2, to H and g.

    H (24, 24) += weight row' row, both triangles, and g (24,) -= weight row' excess. Returns the number of angles that
    are beyond their range; with ``weight`` 0 they are only counted.
    """
    first, excess, row, found = np.empty(5), np.empty(18), np.empty(3), 0
    joint_excess(RJ, hinges, hinge_margin, first, excess)
    for ball in range(5):
        for k in range(3):
            angle = BALL_ANGLES[ball, k]
            if angle < 0 or excess[angle] == 0.0:
                continue
            found += 1
            if weight > 0.0:
                angle_gradient(ball, RJ[ball], first[ball], k, row)
                add_row(SLOT_OF_JOINT_AXIS[ball], row, excess[angle], weight, H, g)
    for h in range(4):
        beyond = excess[HINGE_ANGLES[h]]
        if beyond != 0.0:
            found += 1
            H[HINGE_SLOT[h], HINGE_SLOT[h]] += weight
            g[HINGE_SLOT[h]] -= weight * beyond
    return found


@njit(cache=True)
def joint_excess(RJ, hinges, hinge_margin, first, excess):
    """Fill ``excess`` (18,) with the signed part of every angle beyond its range, rad; 0 where it is not defined.

    ``first`` (5,) : the first angle of each ball joint's chosen triple.
    """
    excess[:] = 0.0
    y, z = RJ[0, 1, 2], RJ[0, 2, 2]
    first[0] = math.atan2(-y, z)
    if y * y + z * z >= FLATTEST * FLATTEST:  # the neck's second angle cannot leave its range
        excess[0] = beyond_range(first[0], 0)
    values = np.empty(3)
    for ball in range(1, 5):
        ball_angles(ball, RJ[ball], values)
        first[ball] = values[0]
        sine = RJ[ball, 0, BALL_EULER_AXES[ball, 2]]
        flat = 1.0 - sine * sine < FLATTEST * FLATTEST
        for k in range(3):
            if k == 1 or not flat:
                excess[BALL_ANGLES[ball, k]] = beyond_range(values[k], BALL_ANGLES[ball, k])
        h = ball - 1
        sign, past = (-1.0 if h < 2 else 1.0), hyperextension(h, hinges, hinge_margin)
        if sign * hinges[h] > LARGEST_FLEXION:
            excess[HINGE_ANGLES[h]] = hinges[h] - sign * LARGEST_FLEXION
        elif past > 0.0 and not flipped_limb_fits_better(h, RJ, past):
            excess[HINGE_ANGLES[h]] = -sign * past


@njit(cache=True)
def hyperextension(hinge, hinges, margin):
    """Return by how much (rad) an elbow (hinge 0, 1) or knee (2, 3) exceeds the margin beyond straight."""
    return (hinges[hinge] if hinge < 2 else -hinges[hinge]) - margin


@njit(cache=True)
def flipped_limb_fits_better(hinge, RJ, past):
    """Return whether a limb, ``past`` (rad) straight, is less beyond its ranges when described the other way round."""
    turned = RJ[1 + hinge].copy()
    other = 2 if hinge < 2 else 1  # Ry(pi) turns x and z of an arm, Rz(pi) x and y of a leg
    for i in range(3):
        turned[i, 0] = -turned[i, 0]
        turned[i, other] = -turned[i, other]
    values = np.empty(3)
    return ball_angles(1 + hinge, turned, values) < ball_angles(1 + hinge, RJ[1 + hinge], values) + past


@njit(cache=True)
def beyond_range(value, angle):
    """Return the signed part of an angle's value beyond its range, rad."""
    return max(value - ANGLE_HIGH[angle], 0.0) + min(value - ANGLE_LOW[angle], 0.0)


@njit(cache=True)
def ball_angles(ball, R, values):
    """Fill ``values`` (3,) with angles a, b, c of R = Rx(a) Rj(b) Rk(c), of the two triples the one less out of range.

    Returns the excess over the ranges, summed over the three, rad.
    """
    j, k = BALL_EULER_AXES[ball, 1], BALL_EULER_AXES[ball, 2]
    sign = 1.0 if j == 1 else -1.0
    a = math.atan2(-sign * R[j, k], R[k, k])
    b = math.atan2(sign * R[0, k], math.hypot(R[j, k], R[k, k]))
    c = math.atan2(-sign * R[0, j], R[0, 0])
    cost = math.inf
    for cover in range(2):
        if cover == 1:
            a, b, c = a + math.pi, math.pi - b, c + math.pi
        first = wrap_into_range(a, BALL_ANGLES[ball, 0])
        middle = wrap_into_range(b, BALL_ANGLES[ball, 1])
        last = wrap_into_range(c, BALL_ANGLES[ball, 2])
        beyond = excess_over_range((first, middle, last), BALL_ANGLES[ball])
        if beyond < cost:
            cost = beyond
            values[0], values[1], values[2] = first, middle, last
    return cost


@njit(cache=True)
def angle_gradient(ball, R, first, angle, row):
    """Fill ``row`` (3,) with the derivative of a ball joint's angle (0, 1, 2) with respect to its rotation vector.

    The rotation vector (torso axes) of rates a', b', c' is a' ex + b' m + c' l, with m = Rx(a) ej and l = R ek; m is
    perpendicular to both others. The neck has two axes, of which the first alone can leave its range.
    """
    if ball == 0:
        square = R[1, 2] ** 2 + R[2, 2] ** 2
        row[0], row[1], row[2] = 1.0, -R[0, 2] * R[1, 2] / square, 0.0
        return
    j, k = BALL_EULER_AXES[ball, 1], BALL_EULER_AXES[ball, 2]
    sine = R[0, k]
    square = 1.0 - sine * sine
    if angle == 0:
        row[0], row[1], row[2] = 1.0, -sine * R[1, k] / square, -sine * R[2, k] / square
    elif angle == 2:
        row[0], row[1], row[2] = 0.0, R[1, k] / square, R[2, k] / square
    elif j == 1:
        row[0], row[1], row[2] = 0.0, math.cos(first), math.sin(first)
    else:
        row[0], row[1], row[2] = 0.0, -math.sin(first), math.cos(first)


@njit(cache=True)
def add_row(slots, row, excess, weight, H, g):
    """Add one residual with derivative ``row`` (3,) at ``slots`` (3,); -1 where there is none."""
    for p in range(3):
        if slots[p] < 0:
            continue
        g[slots[p]] -= weight * row[p] * excess
        for q in range(3):
            if slots[q] >= 0:
                H[slots[p], slots[q]] += weight * row[p] * row[q]


@njit(cache=True)
def add_neck_rest(R_neck, weight, H, g):
    """Pull the head's direction to its rest, NECK_PITCH rad forward of the torso's axis, weight in 1/rad^2.

    It keeps a head that no datum shows from folding into the torso.
    """
    rest0, rest2 = np.sin(NECK_PITCH), np.cos(NECK_PITCH)
    d0, d1, d2 = R_neck[0, 2], R_neck[1, 2], R_neck[2, 2]
    c0, c1, c2 = d1 * rest2, d2 * rest0 - d0 * rest2, -d1 * rest0  # direction x rest
    sine = np.sqrt(c0 * c0 + c1 * c1 + c2 * c2)
    if sine == 0.0:
        return
    angle = np.arctan2(sine, d0 * rest0 + d2 * rest2)
    for k in range(2):
        H[NECK_SLOTS[k], NECK_SLOTS[k]] += weight
    g[NECK_SLOTS[0]] += weight * (angle * c0 / sine)
    g[NECK_SLOTS[1]] += weight * (angle * c1 / sine)


@njit(cache=True)
def limit_rates(velocity):
    """Clip the rates of joints in the pose's velocity (24,) to their limits, in place."""
    for ball in range(5):
        square = 0.0
        for slot in SLOT_OF_JOINT_AXIS[ball]:
            if slot >= 0:
                square += velocity[slot] ** 2
        if square > BALL_RATES[ball] ** 2:
            for slot in SLOT_OF_JOINT_AXIS[ball]:
                if slot >= 0:
                    velocity[slot] *= BALL_RATES[ball] / math.sqrt(square)
    for h in range(4):
        slot = HINGE_SLOT[h]
        velocity[slot] = min(max(velocity[slot], -HINGE_RATES[h]), HINGE_RATES[h])


@njit(cache=True)
def stop_at_straight(before, hinges, velocity):
    """Stop elbows and knees at straight where a motion from ``before`` (4,) rad passes it; their rates become 0."""
    for h in range(4):
        straight = max(hyperextension(h, before, 0.0), 0.0)  # one that was past it already goes no farther
        if hyperextension(h, hinges, 0.0) > straight:
            hinges[h] = straight if h < 2 else -straight
            velocity[HINGE_SLOT[h]] = 0.0
