"""Rotations and rigid fits: rotation vectors, nearest rotations, and the transform that fits points best."""

from __future__ import annotations

import cv2
import numpy as np
import numpy.typing as npt

from .kernel import njit
from .small_matrices import diagonalise

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
    """Return the rotation (3, 3) nearest to a matrix (3, 3), by its quaternion (Horn, JOSA A 4, 1987).

    Of the unit quaternions q, that of the rotation R with the largest trace(R' M) is the largest eigenvector of N.
    """
    N, Q, R = np.empty((4, 4)), np.empty((4, 4)), np.empty((3, 3))
    (xx, xy, xz), (yx, yy, yz), (zx, zy, zz) = M
    N[0] = xx + yy + zz, zy - yz, xz - zx, yx - xy
    N[1] = zy - yz, xx - yy - zz, xy + yx, xz + zx
    N[2] = xz - zx, xy + yx, yy - xx - zz, yz + zy
    N[3] = yx - xy, xz + zx, yz + zy, zz - xx - yy
    diagonalise(N, Q)
    w, x, y, z = Q[:, np.diag(N).argmax()]
    R[0] = w * w + x * x - y * y - z * z, 2.0 * (x * y - w * z), 2.0 * (x * z + w * y)
    R[1] = 2.0 * (x * y + w * z), w * w - x * x + y * y - z * z, 2.0 * (y * z - w * x)
    R[2] = 2.0 * (x * z - w * y), 2.0 * (y * z + w * x), w * w - x * x - y * y + z * z
    return R


@njit(cache=True)
def rigid_transform(source, target):
    """R (3, 3) and t (3,) for which R source + t is nearest to ``target``: points (n, 3) (Kabsch 1976).

    Three points that do not lie on a line fix them.
    """
    centre_source, centre_target = source.sum(0) / len(source), target.sum(0) / len(target)
    R = polar_rotation(np.dot((target - centre_target).T, source - centre_source))
    return R, centre_target - np.dot(R, centre_source)
