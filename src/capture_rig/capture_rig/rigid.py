"""Rotations and rigid fits: rotation vectors, nearest rotations, and the transform that fits points best."""

from __future__ import annotations

import cv2
import numpy as np
import numpy.typing as npt

Array = np.ndarray


def rotation_matrix(vector: npt.ArrayLike) -> Array:
    """Rotation matrix (3, 3) of a rotation vector (3,), rad (Rodrigues)."""
    return np.asarray(cv2.Rodrigues(np.asarray(vector, float))[0], np.float64)


def rotation_vector(R: Array) -> Array:
    """Rotation vector (3,), rad, of a rotation matrix (3, 3)."""
    return np.asarray(cv2.Rodrigues(R)[0], np.float64).reshape(3)


def nearest_rotation(M: Array) -> Array:
    """Rotations (..., 3, 3) nearest to the matrices ``M`` (..., 3, 3) in the Frobenius norm, never reflections.

    The polar factor, with the least singular direction turned where it would be a reflection (Umeyama, PAMI 1991).
    """
    U, _, Vt = np.linalg.svd(M)
    R = U @ Vt
    reflected = np.linalg.det(R) < 0.0
    if not reflected.any():
        return R
    U[..., :, 2] *= np.where(reflected, -1.0, 1.0)[..., None]
    return U @ Vt


def rigid_transform(source: Array, target: Array) -> tuple[Array, Array]:
    """R (..., 3, 3) and t (..., 3) for which R source + t is nearest to ``target``: points (..., n, 3) (Kabsch 1976).

    Three points that do not lie on a line fix them.
    """
    centre_source, centre_target = source.mean(-2, keepdims=True), target.mean(-2, keepdims=True)
    R = nearest_rotation(np.swapaxes(target - centre_target, -1, -2) @ (source - centre_source))
    return R, centre_target[..., 0, :] - (R @ centre_source[..., 0, :, None])[..., 0]
