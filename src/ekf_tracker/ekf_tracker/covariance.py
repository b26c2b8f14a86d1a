"""Keeping a covariance a covariance: symmetric, positive definite, bounded where nothing is observed."""

from __future__ import annotations

import numpy as np

from stick_figure.kernels import SLOT_OF_JOINT_AXIS

from .compiled import cholesky_upper
from .slots import HINGES

JOINT_SLOTS = tuple(row[row >= 0] for row in SLOT_OF_JOINT_AXIS) + tuple(HINGES[k : k + 1] for k in range(4))
"""Tangent slots of each joint: neck (2), shoulders and hips (3 each), elbows and knees (1 each)."""

_BELONGS = np.zeros((len(JOINT_SLOTS), 48))
for _joint, _slots in enumerate(JOINT_SLOTS):
    _BELONGS[_joint, _slots] = 1.0

SMALLEST_VARIANCE = 1e-12
"""Eigenvalues below this (1 micrometre, 1 microradian) are rounding, not knowledge."""


def symmetrised(P: np.ndarray) -> np.ndarray:
    """The symmetric part of P: rounding makes the two triangles drift apart."""
    return 0.5 * (P + P.T)


def positive_definite(P: np.ndarray) -> tuple[np.ndarray, bool]:
    """P (n, n) symmetric, with its eigenvalues raised where rounding spoilt them; whether that was needed."""
    _, positive = cholesky_upper(P)
    if positive:
        return P, False
    eigenvalues, vectors = np.linalg.eigh(P)
    return symmetrised((vectors * np.maximum(eigenvalues, SMALLEST_VARIANCE)) @ vectors.T), True


def with_capped_joints(P: np.ndarray, sd_cap: float) -> np.ndarray:
    """P (48, 48) in which no joint's pose has a standard deviation above ``sd_cap`` (rad) about any axis.

    The twist of a straight limb is not observable, and without a bound its variance grows until the linearisation
    means nothing. The joint's error is shrunk along the uncertain axis only (a congruence, so P stays positive
    definite), and what is known about the other axes is kept.
    """
    cap = sd_cap * sd_cap
    wide = np.flatnonzero(_BELONGS @ P.diagonal() > cap)  # by the sum of its axes' variances; the largest decides
    for slots in (JOINT_SLOTS[joint] for joint in wide):
        variances, axes = np.linalg.eigh(P[slots[:, None], slots])
        if variances[-1] <= cap:
            continue
        shrink = (axes * np.sqrt(cap / np.maximum(variances, cap))) @ axes.T
        P = P.copy()
        P[slots, :] = shrink @ P[slots, :]
        P[:, slots] = P[:, slots] @ shrink
    return P


def with_negated_slots(P: np.ndarray, slots: np.ndarray) -> np.ndarray:
    """P (48, 48) after the sign of these tangent slots, and of their velocities, was turned."""
    sign = np.ones(len(P))
    sign[slots] = sign[24 + slots] = -1.0
    return P * np.outer(sign, sign)


def widened(P: np.ndarray, slots: np.ndarray, pose_variance: np.ndarray, velocity_variance: np.ndarray) -> np.ndarray:
    """P (48, 48) that knows nothing about these tangent slots but the given variances (n,) of pose and velocity."""
    both = np.concatenate([slots, 24 + slots])
    P = P.copy()
    P[both, :] = P[:, both] = 0.0
    P[both, both] = np.concatenate([pose_variance, velocity_variance])
    return P
