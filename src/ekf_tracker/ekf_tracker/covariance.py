"""Keeping a covariance a covariance: symmetric, positive definite, bounded where nothing is observed."""

from __future__ import annotations

import numpy as np

from stick_figure.kernels import SLOT_OF_JOINT_AXIS

from .slots import HINGES

JOINT_SLOTS = tuple(row[row >= 0] for row in SLOT_OF_JOINT_AXIS) + tuple(HINGES[k : k + 1] for k in range(4))
"""Tangent slots of each joint: neck (2), shoulders and hips (3 each), elbows and knees (1 each)."""

SMALLEST_VARIANCE = 1e-12
"""Eigenvalues below this (1 micrometre, 1 microradian) are rounding, not knowledge."""


def symmetrised(P: np.ndarray) -> np.ndarray:
    """The symmetric part of P: rounding makes the two triangles drift apart."""
    return 0.5 * (P + P.T)


def positive_definite(P: np.ndarray) -> np.ndarray:
    """P (n, n) symmetric, with its eigenvalues raised where rounding spoilt them."""
    eigenvalues, vectors = np.linalg.eigh(P)
    return symmetrised((vectors * np.maximum(eigenvalues, SMALLEST_VARIANCE)) @ vectors.T)


def widened(P: np.ndarray, slots: np.ndarray, pose_variance: np.ndarray, velocity_variance: np.ndarray) -> np.ndarray:
    """P (48, 48) that knows nothing about these tangent slots but the given variances (n,) of pose and velocity."""
    both = np.concatenate([slots, 24 + slots])
    P = P.copy()
    P[both, :] = P[:, both] = 0.0
    P[both, both] = np.concatenate([pose_variance, velocity_variance])
    return P
