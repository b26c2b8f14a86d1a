"""The covariance of the EKF's state, kept symmetric and positive: correction, bounds, repair.

P (48, 48) belongs to the error vector of `state`: the 24 slots of the pose's tangent before those of its velocity.
"""

from __future__ import annotations

import math

import numpy as np

from capture_rig.kernel import njit
from capture_rig.small_matrices import symmetrise
from stick_figure import kernels

N = 24
# Thresholds: rounding from arithmetic.
SMALLEST_VARIANCE = 1e-12
"""Eigenvalues below this (1 micrometre, 1 microradian) are rounding, not knowledge."""


def positive_definite(P: np.ndarray) -> np.ndarray:
    """P (n, n) made symmetric, with its eigenvalues raised where rounding spoilt them."""
    eigenvalues, vectors = np.linalg.eigh(P)
    mended = (vectors * np.maximum(eigenvalues, SMALLEST_VARIANCE)) @ vectors.T
    return 0.5 * (mended + mended.T)


def reset_slots(
    P: np.ndarray, slots: np.ndarray, pose_variance: np.ndarray, velocity_variance: np.ndarray
) -> np.ndarray:
    """P (48, 48) that knows nothing about these tangent slots but the given variances (n,) of pose and velocity."""
    both = np.concatenate([slots, 24 + slots])
    P = P.copy()
    P[both, :] = P[:, both] = 0.0
    P[both, both] = np.concatenate([pose_variance, velocity_variance])
    return P


@njit(cache=True)
def joseph(P, G, L):
    """(I - K H) P (I - K H)' + K R K' for the gain K = G H' R^-1, with L = H' R^-1 H (24, 24) on the pose, P (48, 48).

    Joseph's form, because a sum of two squares stays symmetric and positive whatever the rounding of K;
    the thesis's (I - K H) P (Table 5.7) is right only for the exact gain and loses both over a few thousand sets.
    Here K H = [G L, 0] and K R K' = G L G'.
    """
    KH = np.dot(G, L)
    T = P - np.dot(KH, P[:N])  # (I - K H) P
    out = np.dot(G - T[:, :N], KH.T)
    out += T
    symmetrise(out)
    return out


@njit(cache=True)
def cap_joints(P, sd_cap):
    """Shrinks P (48, 48), in place, until no joint's pose has an sd above ``sd_cap`` (rad) about any axis.

    The twist of a straight limb is not observable, and without a bound its variance grows until the linearisation
    means nothing. The joint's error is shrunk along the uncertain axis only (a congruence, so P stays positive
    definite), and what is known about the other axes is kept.
    """
    cap = sd_cap * sd_cap
    for ball in range(5):
        slots = kernels.SLOT_OF_JOINT_AXIS[ball]
        axes = 2 if slots[2] < 0 else 3
        total = 0.0
        for k in range(axes):
            total += P[slots[k], slots[k]]
        if total > cap:
            _cap_ball(P, slots[:axes], cap)
    for slot in kernels.HINGE_SLOT:
        if P[slot, slot] > cap:
            shrink = math.sqrt(cap / P[slot, slot])
            P[slot, :] *= shrink
            P[:, slot] *= shrink


@njit(cache=True)
def _cap_ball(P, slots, cap):
    n = len(slots)
    block = np.empty((n, n))
    for a in range(n):
        for b in range(n):
            block[a, b] = P[slots[a], slots[b]]
    variances, axes = np.linalg.eigh(block)
    if variances[-1] <= cap:
        return
    shrink = np.zeros((n, n))
    for k in range(n):
        factor = math.sqrt(cap / max(variances[k], cap))
        for a in range(n):
            for b in range(n):
                shrink[a, b] += factor * (axes[a, k] * axes[b, k])
    _turn_rows(P, slots, shrink)
    _turn_rows(P.T, slots, shrink)
    for a in range(n):
        for b in range(a):
            P[slots[b], slots[a]] = P[slots[a], slots[b]]


@njit(cache=True)
def _turn_rows(P, slots, shrink):
    before = np.empty(len(slots))
    for c in range(P.shape[1]):
        for a in range(len(slots)):
            before[a] = P[slots[a], c]
        for a in range(len(slots)):
            P[slots[a], c] = (shrink[a] * before).sum()


@njit(cache=True)
def negate(P, slot):
    """Change the sign of one slot of the state, in place."""
    P[slot, :] *= -1.0
    P[:, slot] *= -1.0
