"""Rotation matrices and rotation vectors in plain numpy calls (the work is done by the compiled kernels)."""

from __future__ import annotations

import numpy as np

from . import kernels

Array = np.ndarray


def rotation_matrix(vector: Array) -> Array:
    """Rotation matrix (3, 3) of a rotation vector (3,), rad (Rodrigues; thesis eq. 5.25 with |omega| = 1)."""
    R = np.empty((3, 3))
    kernels.rotation_exp(float(vector[0]), float(vector[1]), float(vector[2]), R)
    return R


def rotation_vector(R: Array) -> Array:
    """Rotation vector (3,), rad, of a rotation matrix (3, 3); its length is at most pi."""
    vector = np.empty(3)
    kernels.rotation_log(np.ascontiguousarray(R, float), vector)
    return vector


def nearest_rotation(M: Array) -> Array:
    """The rotation (3, 3) nearest to a matrix in the Frobenius norm, never a reflection."""
    U, _, Vt = np.linalg.svd(M)
    return U @ np.diag([1.0, 1.0, np.linalg.det(U @ Vt)]) @ Vt
