"""Rotations and rigid transforms, many at a time."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
from scipy.spatial.transform import Rotation

Array = npt.NDArray[np.float64]


def rotation(vectors: npt.ArrayLike) -> Array:
    """Turn rotation vectors (..., 3), rad, to matrices (..., 3, 3)."""
    vectors = np.asarray(vectors, float)
    return Rotation.from_rotvec(vectors.reshape(-1, 3)).as_matrix().reshape(*vectors.shape[:-1], 3, 3)


def transform(R: Array, t: Array) -> Array:
    """Join rotations (..., 3, 3) and translations (..., 3) to transforms (..., 4, 4)."""
    T = np.zeros((*np.shape(R)[:-2], 4, 4))
    T[..., :3, :3], T[..., :3, 3], T[..., 3, 3] = R, t, 1.0
    return T


def inverse(T: Array) -> Array:
    """Invert rigid transforms (..., 4, 4)."""
    R = np.swapaxes(T[..., :3, :3], -1, -2)
    return transform(R, -(R @ T[..., :3, 3, None])[..., 0])


def angle_between(R_a: Array, R_b: Array) -> Array:
    """Compute the angles (n, m), rad, between rotations (n, 3, 3) and (m, 3, 3)."""
    trace = R_a.reshape(-1, 9) @ R_b.reshape(-1, 9).T
    return np.arccos(np.clip((trace - 1) / 2, -1, 1))
