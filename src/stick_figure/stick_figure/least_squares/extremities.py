"""Hands and feet turn: two nuisance angles each at wrists and ankles, marginalised in the fit.

The stick figure ends at finger tips and ankles, and its pose has no angles of wrists and feet. Silhouettes show their
surfaces; held stiff, these would pull the forearm and the calf along. So hands turn about the wrist and feet about the
ankle by two small angles each, which are solved for with the pose and eliminated from its equations (Schur complement):
a hand's outline moves the arm only by the part that no turn of the hand explains. Without data they stay straight. The
hands' tips turn with them.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from capture_rig.kernel import kernel, njit
from capture_rig.rigid import rotation_exp

from ..body_surface import CAPSULES, EXTREMITY_CAPSULES, EXTREMITY_STICKS
from .normal_equations import CHAIN_COLUMNS, ENDS, add_capsule, fill_moments, pose_columns

COUNT, ANGLES = 4, 2  # left and right hand, left and right foot; angles of each
CAPSULE, STICK = np.array(EXTREMITY_CAPSULES), np.array(EXTREMITY_STICKS)
STIFF = np.setdiff1d(np.arange(CAPSULES), EXTREMITY_CAPSULES)  # the others
AXES = np.array([[0, 2], [0, 2], [1, 2], [1, 2]])
"""Two axes of the stick's frame each: hands bend across the forearm, feet nod and turn."""

# Thresholds: 0.35 rad, what wrists use in daily life (Ryu et al. 1991), was too little, as turned forearms move the
# hand, too: mean error of 66 people of python models/random_people.py 15.9 mm; of 0.7 rad 15.2, of 1.0 rad 15.1.
TURN_SD = 1.0  # rad, of hands and feet about straight
RAYS_PER_INDEPENDENT_SAMPLE = 200.0  # the noise model: a set's rays, 1e7 / m^2, are worth six independent of 1 cm
LARGEST_TURN = TURN_SD
STIFF_SD = 1e-6  # rad, of hands and feet of a body that is the stick figure


class Extremities(NamedTuple):
    """Hands and feet: turns (4, 2) rad, and their back-substitution from a step of the pose: back (4, 2, 1 +
    CHAIN_COLUMNS), slots (4, CHAIN_COLUMNS) of the tangent, used (4,) of them. information : of straight, 1/rad^2."""

    turns: np.ndarray
    back: np.ndarray
    slots: np.ndarray
    used: np.ndarray
    information: float


@njit(cache=True)
def straight_extremities(information):
    """Return hands and feet that are straight."""
    back, slots = np.zeros((COUNT, ANGLES, 1 + CHAIN_COLUMNS)), np.zeros((COUNT, CHAIN_COLUMNS), np.int64)
    return Extremities(np.zeros((COUNT, ANGLES)), back, slots, np.zeros(COUNT, np.int64), information)


@njit(cache=True)
def turn_extremities(ends, posed):
    """Turn hands and feet of a model that was posed with straight ones: their capsules, and the hands' tips."""
    pivot, point = np.empty(3), np.empty(3)
    for e in range(COUNT):
        k, j = CAPSULE[e], STICK[e]
        if ends.turns[e, 0] == 0.0 and ends.turns[e, 1] == 0.0:
            continue
        R = _turn(e, posed, ends.turns)
        _pivot(e, posed, pivot)
        _turn_about(R, pivot, posed.P[k], point)
        _turn_about(R, pivot, posed.Q[k], point)
        if e < 2:
            _turn_about(R, pivot, posed.B[j], point)


@njit(cache=True)
def turned_frame(e, posed, turns):
    """Return the frame (3, 3) in the world of an extremity's stick, turned as the extremity is."""
    return _turn(e, posed, turns) @ posed.G[STICK[e]]


@njit(cache=True)
def _turn(e, posed, turns):
    """Return the rotation (3, 3), world frame, of an extremity from straight."""
    R, w, j = np.empty((3, 3)), np.empty(3), STICK[e]
    for i in range(3):
        w[i] = turns[e, 0] * posed.G[j, i, AXES[e, 0]] + turns[e, 1] * posed.G[j, i, AXES[e, 1]]
    rotation_exp(w[0], w[1], w[2], R)
    return R


@kernel
def _turn_about(R, pivot, place, old):
    """place (3,) <- turned about the pivot."""
    for i in range(3):
        old[i] = place[i] - pivot[i]
    for i in range(3):
        place[i] = pivot[i] + R[i, 0] * old[0] + R[i, 1] * old[1] + R[i, 2] * old[2]


@kernel
def _pivot(e, posed, pivot):
    """pivot (3,) <- the wrist, where the hand's capsule starts, or the ankle."""
    for i in range(3):
        pivot[i] = posed.P[CAPSULE[e], i] if e < 2 else posed.B[STICK[e], i]


@kernel
def extremity_of_capsule(k):
    """Return the extremity (0 to 3) that capsule k is, or -1."""
    for e in range(COUNT):
        if CAPSULE[e] == k:
            return e
    return -1


@njit(cache=True)
def turn_columns(e, posed, M, second):
    """Fill M (6 or 8, 2 or more) with the derivatives of an extremity's capsule, world, with respect to its turns;
    those of the capsule's end begin at row ``second``."""
    k, pivot = CAPSULE[e], np.empty(3)
    _pivot(e, posed, pivot)
    for a in range(ANGLES):
        axis = posed.G[STICK[e], :, AXES[e, a]]
        for end in range(2):
            place, row = posed.P[k] if end == 0 else posed.Q[k], second * end
            x, y, z = place[0] - pivot[0], place[1] - pivot[1], place[2] - pivot[2]
            M[row, a] = axis[1] * z - axis[2] * y
            M[row + 1, a] = axis[2] * x - axis[0] * z
            M[row + 2, a] = axis[0] * y - axis[1] * x


@njit(cache=True)
def add_extremity(sums, e, posed, ends, H, g):
    """Add the sums of one extremity's capsule to the equations of the pose, its turns eliminated."""
    k = CAPSULE[e]
    M, T = np.zeros((2 * ENDS, CHAIN_COLUMNS)), np.zeros((2 * ENDS, ANGLES))
    work, V = np.empty((2 * ENDS + 1, 2 * ENDS)), np.empty((2 * ENDS, 2 * ENDS))
    n = pose_columns(k, posed, M, ends.slots[e])
    add_capsule(sums, k, M, ends.slots[e], n, work, H, g)
    ends.used[e] = n
    turn_columns(e, posed, T, ENDS)
    fill_moments(sums, k, V)
    VT = V @ T
    own, coupled, pull = T.T @ VT, M.T @ VT, np.empty(ANGLES)
    for a in range(ANGLES):
        own[a, a] += ends.information
        pull[a] = -ends.information * ends.turns[e, a]
        for q in range(3):
            pull[a] += T[q, a] * sums.pulls[k, 0, q] + T[3 + q, a] * sums.pulls[k, 1, q]
    determinant = own[0, 0] * own[1, 1] - own[0, 1] * own[1, 0]
    for c in range(n + 1):
        p, q = (pull[0], pull[1]) if c == 0 else (coupled[c - 1, 0], coupled[c - 1, 1])
        ends.back[e, 0, c] = (own[1, 1] * p - own[0, 1] * q) / determinant
        ends.back[e, 1, c] = (own[0, 0] * q - own[1, 0] * p) / determinant
    for m in range(n):
        slot = ends.slots[e, m]
        g[slot] -= coupled[m, 0] * ends.back[e, 0, 0] + coupled[m, 1] * ends.back[e, 1, 0]
        for other in range(m, n):
            less = coupled[m, 0] * ends.back[e, 0, 1 + other] + coupled[m, 1] * ends.back[e, 1, 1 + other]
            H[min(slot, ends.slots[e, other]), max(slot, ends.slots[e, other])] -= less


@njit(cache=True)
def back_substitute(ends, step, scale):
    """Update the turns for ``scale`` times a step (24,) of the pose."""
    for e in range(COUNT):
        for a in range(ANGLES):
            change = ends.back[e, a, 0]
            for m in range(ends.used[e]):
                change -= ends.back[e, a, 1 + m] * step[ends.slots[e, m]]
            turn = ends.turns[e, a] + scale * change
            ends.turns[e, a] = min(max(turn, -LARGEST_TURN), LARGEST_TURN)
