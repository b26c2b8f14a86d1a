"""Rotations and rigid fits: rotation vectors, nearest rotations, and the transform that fits points best."""

from __future__ import annotations

import cv2
import numpy as np
import numpy.typing as npt
from numba import njit

Array = np.ndarray


def rotation_matrix(vector: npt.ArrayLike) -> Array:
    """Rotation matrix (3, 3) of a rotation vector (3,), rad (Rodrigues)."""
    return np.asarray(cv2.Rodrigues(np.asarray(vector, float))[0], np.float64)


def rotation_vector(R: Array) -> Array:
    """Rotation vector (3,), rad, of a rotation matrix (3, 3)."""
    return np.asarray(cv2.Rodrigues(R)[0], np.float64).reshape(3)


def nearest_rotation(M: Array) -> Array:
    """Rotations (..., 3, 3) nearest to the matrices ``M`` (..., 3, 3) in the Frobenius norm, never reflections."""
    matrices = np.ascontiguousarray(M, float).reshape(-1, 3, 3)
    return np.array([polar_rotation(one) for one in matrices]).reshape(np.shape(M))


@njit(cache=True)
def polar_rotation(M):
    """Return the rotation (3, 3) nearest to a matrix (3, 3).

    The polar factor, with the least singular direction turned where it would be a reflection (Umeyama, PAMI 1991).
    """
    U, _, Vt = np.linalg.svd(M)
    R = np.dot(U, Vt)
    if np.linalg.det(R) < 0.0:
        U[:, 2] *= -1.0
        R = np.dot(U, Vt)
    return R


@njit(cache=True)
def rigid_transform(source, target):
    """R (3, 3) and t (3,) for which R source + t is nearest to ``target``: points (n, 3) (Kabsch 1976).

    Three points that do not lie on a line fix them.
    """
    centre_source, centre_target = source.sum(0) / len(source), target.sum(0) / len(target)
    R = polar_rotation(np.dot((target - centre_target).T, source - centre_source))
    return R, centre_target - np.dot(R, centre_source)
