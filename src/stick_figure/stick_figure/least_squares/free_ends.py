"""Hands and feet turn: two more angles each at wrists and ankles, known to the fit alone.

The stick figure ends at finger tips and ankles, and its pose says nothing about wrists and feet. Their surfaces are
what silhouettes show of them; held stiff, they would pull the forearm and the calf along. So hands turn about the
wrist and feet about the ankle by two small angles each, which are solved for with the pose and eliminated from its
equations (Schur complement): a hand's outline moves the arm only by what no turn of the hand explains. Without data
they stay straight. The hand tips follow.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from capture_rig.kernel import kernel, njit
from capture_rig.rigid import rotation_exp

from ..body_surface import CAPSULES, END_CAPSULES, END_STICKS
from .normal_equations import CHAIN_COLUMNS, ENDS, add_capsule, fill_moments, pose_columns

COUNT, ANGLES = 4, 2  # left and right hand, left and right foot; angles of each
CAPSULE, STICK = np.array(END_CAPSULES), np.array(END_STICKS)
STIFF = np.setdiff1d(np.arange(CAPSULES), END_CAPSULES)  # the others
AXES = np.array([[0, 2], [0, 2], [1, 2], [1, 2]])  # of the stick's frame: the hand bends across the forearm, the foot
# Thresholds: TURN_SD wider than the range of daily movement (Ryu et al. 1991), as forearms turn, too: of 0.35, 0.7
# and 1 rad the best on 66 people of python models/random_people.py; CORRELATED from the noise model: the rays of a set
# are worth six independent ones of a centimetre; else judgement.
# nods and turns
TURN_SD = 1.0
"""How far hands and feet are from where an average one points, rad. Wrists bend by 0.35 (Ryu et al. 1991 find 40
degrees used), and a forearm that turns about itself takes the hand's way, 0.2 off its axis, around with it. The rays
decide: a prior of 0.35 left forearms and calves pulled along (66 people of `models/random_people.py`, mean error of all
points: 15.9 mm; 0.7: 15.2; 1.0: 15.1)."""
CORRELATED = 200.0  # rays that count as one independent one: a set's are 1e7 / m^2, and worth six of a centimetre
LARGEST_TURN = TURN_SD
STIFF_SD = 1e-6  # rad, of the ends of a body that is the stick figure


class FreeEnds(NamedTuple):
    """turns (4, 2) rad, and how they follow from a step of the pose: back (4, 2, 1 + CHAIN_COLUMNS), slots (4,
    CHAIN_COLUMNS) of the tangent, used (4,) of them. ``information`` : of the turns about straight, 1/rad^2."""

    turns: np.ndarray
    back: np.ndarray
    slots: np.ndarray
    used: np.ndarray
    information: float


@njit(cache=True)
def straight_ends(information):
    """Return ends that are straight."""
    back, slots = np.zeros((COUNT, ANGLES, 1 + CHAIN_COLUMNS)), np.zeros((COUNT, CHAIN_COLUMNS), np.int64)
    return FreeEnds(np.zeros((COUNT, ANGLES)), back, slots, np.zeros(COUNT, np.int64), information)


@njit(cache=True)
def turn_ends(ends, placed):
    """Turn hands and feet of a figure that was placed straight: their capsules, and the hands' tips."""
    pivot, point = np.empty(3), np.empty(3)
    for e in range(COUNT):
        k, j = CAPSULE[e], STICK[e]
        if ends.turns[e, 0] == 0.0 and ends.turns[e, 1] == 0.0:
            continue
        R = _turn(e, placed, ends.turns)
        _pivot(e, placed, pivot)
        _turn_about(R, pivot, placed.P[k], point)
        _turn_about(R, pivot, placed.Q[k], point)
        if e < 2:
            _turn_about(R, pivot, placed.B[j], point)


@njit(cache=True)
def turned_frame(e, placed, turns):
    """Return the frame (3, 3) of an end's stick, turned as the end is, in the world."""
    return _turn(e, placed, turns) @ placed.G[STICK[e]]


@njit(cache=True)
def _turn(e, placed, turns):
    """Return the rotation (3, 3), world frame, of an end from straight."""
    R, w, j = np.empty((3, 3)), np.empty(3), STICK[e]
    for i in range(3):
        w[i] = turns[e, 0] * placed.G[j, i, AXES[e, 0]] + turns[e, 1] * placed.G[j, i, AXES[e, 1]]
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
def _pivot(e, placed, pivot):
    """pivot (3,) <- the wrist, where the hand's capsule starts, or the ankle."""
    for i in range(3):
        pivot[i] = placed.P[CAPSULE[e], i] if e < 2 else placed.B[STICK[e], i]


@kernel
def end_of_capsule(k):
    """Return the number of the end that capsule k is; -1 of any other."""
    for e in range(COUNT):
        if CAPSULE[e] == k:
            return e
    return -1


@njit(cache=True)
def turn_columns(e, placed, M, second):
    """Fill M (6 or 8, 2 or more) with the derivatives of an end's capsule, world, with respect to its turns; those of
    its end begin at row ``second``."""
    k, pivot = CAPSULE[e], np.empty(3)
    _pivot(e, placed, pivot)
    for a in range(ANGLES):
        axis = placed.G[STICK[e], :, AXES[e, a]]
        for end in range(2):
            place, row = placed.P[k] if end == 0 else placed.Q[k], second * end
            x, y, z = place[0] - pivot[0], place[1] - pivot[1], place[2] - pivot[2]
            M[row, a] = axis[1] * z - axis[2] * y
            M[row + 1, a] = axis[2] * x - axis[0] * z
            M[row + 2, a] = axis[0] * y - axis[1] * x


@njit(cache=True)
def add_free_end(sums, e, placed, ends, H, g):
    """Add the sums of one end's capsule to the equations of the pose, its turns eliminated."""
    k = CAPSULE[e]
    M, T = np.zeros((2 * ENDS, CHAIN_COLUMNS)), np.zeros((2 * ENDS, ANGLES))
    work, V = np.empty((2 * ENDS + 1, 2 * ENDS)), np.empty((2 * ENDS, 2 * ENDS))
    n = pose_columns(k, placed, M, ends.slots[e])
    add_capsule(sums, k, M, ends.slots[e], n, work, H, g)
    ends.used[e] = n
    turn_columns(e, placed, T, ENDS)
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
def follow(ends, step, scale):
    """Turn the ends as a step (24,) of the pose, of which ``scale`` is taken, leaves them."""
    for e in range(COUNT):
        for a in range(ANGLES):
            change = ends.back[e, a, 0]
            for m in range(ends.used[e]):
                change -= ends.back[e, a, 1 + m] * step[ends.slots[e, m]]
            turn = ends.turns[e, a] + scale * change
            ends.turns[e, a] = min(max(turn, -LARGEST_TURN), LARGEST_TURN)
