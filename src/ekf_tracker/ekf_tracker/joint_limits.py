"""Where joints can go, as soft residuals of the update (compiled).

A residual is the part of an angle that lies beyond its range (`stick_figure.skeleton`), and there is none inside: poses
that people can take are estimated exactly as without limits. An elbow or knee that passes straight by more than a
margin can also be described the other way round, with the upper limb turned by pi about itself; it meets a limit only
if that description is no better. (A limit in any case would trap limbs whose upper part was turned the wrong way.)
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from stick_figure.kernels import HINGE_SLOT, SLOT_OF_JOINT_AXIS
from stick_figure.rotations import wrap_into_range
from stick_figure.skeleton import ANGLE_HIGH, ANGLE_LOW, BALL_ANGLES, BALL_EULER_AXES

FLATTEST = 0.2
"""Cosine of a limb's second angle below which its first and third turn about almost the same axis: no limit there."""


@njit(cache=True)
def add_joint_limits(RJ, hinges, hinge_margin, weight, information, gradient):
    """Adds the residuals' information, ``weight`` in 1/rad^2, at the joints RJ (5, 3, 3) and hinges (4,).

    information (24, 24) += weight row' row and gradient (24,) -= weight row' excess. Returns the number of angles that
    are beyond their range; with ``weight`` 0 they are only counted.
    """
    found, row, values = _neck(RJ[0], weight, information, gradient), np.empty(3), np.empty(3)
    for ball in range(1, 5):
        _angles(ball, RJ[ball], values)
        for k in range(3):
            excess = _excess(values[k], BALL_ANGLES[ball, k])
            if excess != 0.0 and _row(ball, RJ[ball], values[0], k, row):
                _add(SLOT_OF_JOINT_AXIS[ball], row, excess, weight, information, gradient)
                found += 1
        past = hyperextension(ball - 1, hinges, hinge_margin)
        if past > 0.0 and not flipped_limb_fits_better(ball - 1, RJ, past):
            slot = HINGE_SLOT[ball - 1]
            information[slot, slot] += weight
            gradient[slot] -= weight * (past if ball < 3 else -past)
            found += 1
    return found


@njit(cache=True)
def hyperextension(hinge, hinges, margin):
    """How much further (rad) than the margin an elbow (hinge 0, 1) or knee (2, 3) is bent the wrong way."""
    return (hinges[hinge] if hinge < 2 else -hinges[hinge]) - margin


@njit(cache=True)
def flipped_limb_fits_better(hinge, RJ, past):
    """Whether a limb, ``past`` (rad) straight, is less beyond its ranges when it is described the other way round."""
    turned = RJ[1 + hinge].copy()
    other = 2 if hinge < 2 else 1  # Ry(pi) turns x and z of an arm, Rz(pi) x and y of a leg
    for i in range(3):
        turned[i, 0] = -turned[i, 0]
        turned[i, other] = -turned[i, other]
    values = np.empty(3)
    return _angles(1 + hinge, turned, values) < _angles(1 + hinge, RJ[1 + hinge], values) + past


@njit(cache=True)
def _excess(value, slot):
    return max(value - ANGLE_HIGH[slot], 0.0) + min(value - ANGLE_LOW[slot], 0.0)


@njit(cache=True)
def _angles(ball, R, values):
    """values (3,) <- angles a, b, c of R = Rx(a) Rj(b) Rk(c), of the two equal triples the one less out of range.

    Returns by how much it is, summed over the three, rad.
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
        beyond = abs(_excess(first, BALL_ANGLES[ball, 0])) + abs(_excess(middle, BALL_ANGLES[ball, 1]))
        beyond += abs(_excess(last, BALL_ANGLES[ball, 2]))
        if beyond < cost:
            cost = beyond
            values[0], values[1], values[2] = first, middle, last
    return cost


@njit(cache=True)
def _row(ball, R, a, angle, row):
    """row (3,) <- derivative of an angle with respect to the joint's rotation vector; False where it is not defined.

    The rotation vector (torso axes) of rates a', b', c' is a' ex + b' m + c' l, with m = Rx(a) ej and l = R ek; m is
    perpendicular to both others.
    """
    j, k = BALL_EULER_AXES[ball, 1], BALL_EULER_AXES[ball, 2]
    if angle == 1:
        row[0] = 0.0
        row[1], row[2] = (math.cos(a), math.sin(a)) if j == 1 else (-math.sin(a), math.cos(a))
        return True
    sine = R[0, k]
    square = 1.0 - sine * sine
    if square < FLATTEST * FLATTEST:
        return False
    if angle == 0:
        row[0], row[1], row[2] = 1.0, -sine * R[1, k] / square, -sine * R[2, k] / square
    else:
        row[0], row[1], row[2] = 0.0, R[1, k] / square, R[2, k] / square
    return True


@njit(cache=True)
def _neck(R, weight, information, gradient):
    """The neck Rx(a) Ry(b), which has two axes: its second angle cannot leave the range, its first can."""
    x, y, z = R[0, 2], R[1, 2], R[2, 2]
    square = y * y + z * z
    excess = _excess(math.atan2(-y, z), 0)
    if excess == 0.0 or square < FLATTEST * FLATTEST:
        return 0
    row = np.array([1.0, -x * y / square, 0.0])
    _add(SLOT_OF_JOINT_AXIS[0], row, excess, weight, information, gradient)
    return 1


@njit(cache=True)
def _add(slots, row, excess, weight, information, gradient):
    for p in range(3):
        if slots[p] < 0:
            continue
        gradient[slots[p]] -= weight * row[p] * excess
        for q in range(3):
            if slots[q] >= 0:
                information[slots[p], slots[q]] += weight * row[p] * row[q]
