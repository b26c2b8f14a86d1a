"""The filter's error state, 24 slots of the pose's tangent, then the same 24 of its velocity: how far to trust it.

Its covariance P (48, 48) is kept symmetric and positive: correction, bounds, repair.
"""

from __future__ import annotations

import math

import numpy as np

from capture_rig.kernel import njit
from capture_rig.small_matrices import symmetrise
from mocap_packets.fit import PART_OF_POINT
from mocap_packets.state import Tracking
from stick_figure import kernels
from stick_figure.skeleton import POINT_NAMES

POSE = slice(0, 24)
VELOCITY = slice(24, 48)
DIMENSION = 48
N = 24
# Thresholds: rounding from arithmetic.
SMALLEST_VARIANCE = 1e-12
"""What is below this (1 micrometre, 1 microradian) is rounding, not knowledge."""
_POINTS_OF_PART = np.bincount(PART_OF_POINT)


def per_slot(torso_position: float, torso_rotation: float, ball_joints: float, hinges: float) -> np.ndarray:
    """Return (24,) one number for every tangent slot, by the kind of its joint."""
    values = np.full(24, ball_joints)
    values[0:3] = torso_position
    values[3:6] = torso_rotation
    values[kernels.HINGE_SLOT] = hinges
    return values


def assess(
    accepted: np.ndarray, gated: np.ndarray, doubtful: np.ndarray, unmeasured_s: float, lost_after_s: float
) -> tuple[Tracking, str]:
    """Trust in the estimate, from the points used, left out, and doubtful (15,) and the seconds since any was used."""
    used, left_out = np.count_nonzero(accepted), np.count_nonzero(gated)
    if unmeasured_s > lost_after_s:
        return Tracking.LOST, f"no usable point for {unmeasured_s:.2f} s"
    if used == 0 and left_out == 0:
        return Tracking.DOUBTFUL, f"no visible point for {unmeasured_s:.2f} s"
    names = ", ".join(POINT_NAMES[i] for i in np.flatnonzero(gated)) if left_out else ""
    if left_out >= used:
        return Tracking.DOUBTFUL, f"{left_out} of {used + left_out} visible points contradict the prediction: {names}"
    if doubtful.all():
        return Tracking.DOUBTFUL, f"{used} points used, every part of the body may be elsewhere"
    if left_out:
        return Tracking.TRACKING, f"{used} points used, left out: {names}"
    return Tracking.TRACKING, f"{used} points used"


def doubtful_points(doubtful: np.ndarray, left_out: np.ndarray) -> np.ndarray:
    """Return (15,) bool: every point of the parts of the body that somebody doubts.

    Points (15,) that were measured as doubtful make their part so, and points that were left out of a limb: the limb
    is either where they are or where the filter has it. Of the trunk's seven points, half of them do.
    """
    doubts, misses = (np.bincount(PART_OF_POINT, weights=points) for points in (doubtful, left_out))
    return ((doubts > 0) | (2 * misses >= _POINTS_OF_PART))[PART_OF_POINT]


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
    """Shrinks P (48, 48), in place, until no joint's pose has an sd above ``sd_cap`` (rad) in any slot.

    The twist of a straight limb is not observable, and without a bound its variance grows until the linearisation
    means nothing. Rows and columns are scaled alike (a congruence), so P stays positive definite.
    """
    for slot in range(6, N):
        if P[slot, slot] > sd_cap * sd_cap:
            shrink = sd_cap / math.sqrt(P[slot, slot])
            P[slot, :] *= shrink
            P[:, slot] *= shrink


@njit(cache=True)
def negate(P, slot):
    """Change the sign of one slot of the state, in place."""
    P[slot, :] *= -1.0
    P[:, slot] *= -1.0
