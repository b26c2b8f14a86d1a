"""Rotations and rigid transforms: rotation vectors, matrices, quaternions, and the transform that fits points best.

Plain functions first, then the compiled kernels that they and other packages call; of these none allocates, but for
:func:`polar_rotation` and :func:`rigid_transform`.
"""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt

from .kernel import kernel, njit
from .small_matrices import diagonalise

Array = np.ndarray
WRITTEN_TOLERANCE = 1e-3  # of rotations from others: ours are exact to 1e-15, hand-written ones to their digits


def rotation_matrix(vectors: npt.ArrayLike) -> Array:
    """Rotation matrices (..., 3, 3) of rotation vectors (..., 3), rad (Rodrigues; thesis eq. 5.25, |omega| = 1)."""
    vectors = np.asarray(vectors, float)
    R = np.empty((*vectors.shape[:-1], 3, 3))
    for (x, y, z), one in zip(vectors.reshape(-1, 3).tolist(), R.reshape(-1, 3, 3), strict=True):
        rotation_exp(x, y, z, one)
    return R


def rotation_vector(R: Array) -> Array:
    """Rotation vector (3,), rad, of a rotation matrix (3, 3); its length is at most pi."""
    vector = np.empty(3)
    rotation_log(np.ascontiguousarray(R, float), vector)
    return vector


def quaternion_of(R: Array) -> Array:
    """Return the unit quaternion (4,), x y z w with w >= 0, of a rotation matrix (3, 3)."""
    quaternion = np.empty(4)
    fill_quaternion(np.ascontiguousarray(R, float), quaternion)
    return quaternion


def nearest_rotation(M: Array) -> Array:
    """Rotations (..., 3, 3) nearest to the matrices ``M`` (..., 3, 3) in the Frobenius norm, never reflections."""
    matrices = np.ascontiguousarray(M, float).reshape(-1, 3, 3)
    return np.array([polar_rotation(one) for one in matrices]).reshape(np.shape(M))


def transform(R: Array, t: Array) -> Array:
    """Join rotations (..., 3, 3) and translations (..., 3) to rigid transforms (..., 4, 4)."""
    T = np.zeros((*np.shape(R)[:-2], 4, 4))
    T[..., :3, :3], T[..., :3, 3], T[..., 3, 3] = R, t, 1.0
    return T


def inverse(T: Array) -> Array:
    """Invert rigid transforms (..., 4, 4)."""
    R = np.swapaxes(T[..., :3, :3], -1, -2)
    return transform(R, -(R @ T[..., :3, 3, None])[..., 0])


def angles_between(R_a: Array, R_b: Array) -> Array:
    """Compute the angles (n, m), rad, between rotations (n, 3, 3) and (m, 3, 3)."""
    trace = R_a.reshape(-1, 9) @ R_b.reshape(-1, 9).T
    return np.arccos(np.clip((trace - 1) / 2, -1, 1))


# --- kernels


@kernel
def matmul3(A, B, out):
    for i in range(3):
        for j in range(3):
            out[i, j] = A[i, 0] * B[0, j] + A[i, 1] * B[1, j] + A[i, 2] * B[2, j]


@kernel
def rotation_exp(x, y, z, E):
    """E (3, 3) <- rotation matrix of the rotation vector (x, y, z) (Rodrigues; thesis eq. 5.25)."""
    angle2 = x * x + y * y + z * z
    if angle2 < 1e-10:
        a = 1.0 - angle2 / 6.0
        b = 0.5 - angle2 / 24.0
    else:
        angle = math.sqrt(angle2)
        a = math.sin(angle) / angle
        half = math.sin(0.5 * angle)
        b = 2.0 * half * half / angle2
    E[0, 0] = 1.0 - b * (y * y + z * z)
    E[1, 1] = 1.0 - b * (x * x + z * z)
    E[2, 2] = 1.0 - b * (x * x + y * y)
    E[0, 1] = b * x * y - a * z
    E[1, 0] = b * x * y + a * z
    E[0, 2] = b * x * z + a * y
    E[2, 0] = b * x * z - a * y
    E[1, 2] = b * y * z - a * x
    E[2, 1] = b * y * z + a * x


@kernel
def rotation_log(R, w):
    """w (3,) <- rotation vector of R (3, 3), |w| <= pi. Goes through the quaternion: exact near 0 and near pi."""
    trace = R[0, 0] + R[1, 1] + R[2, 2]
    if trace > 0.0:
        s = trace + 1.0
        x = R[2, 1] - R[1, 2]
        y = R[0, 2] - R[2, 0]
        z = R[1, 0] - R[0, 1]
    elif R[0, 0] >= R[1, 1] and R[0, 0] >= R[2, 2]:
        s = R[2, 1] - R[1, 2]
        x = 1.0 + R[0, 0] - R[1, 1] - R[2, 2]
        y = R[0, 1] + R[1, 0]
        z = R[0, 2] + R[2, 0]
    elif R[1, 1] >= R[2, 2]:
        s = R[0, 2] - R[2, 0]
        x = R[0, 1] + R[1, 0]
        y = 1.0 - R[0, 0] + R[1, 1] - R[2, 2]
        z = R[1, 2] + R[2, 1]
    else:
        s = R[1, 0] - R[0, 1]
        x = R[0, 2] + R[2, 0]
        y = R[1, 2] + R[2, 1]
        z = 1.0 - R[0, 0] - R[1, 1] + R[2, 2]
    if s < 0.0:
        s, x, y, z = -s, -x, -y, -z
    sine = math.sqrt(x * x + y * y + z * z)
    factor = 2.0 / s if sine < 1e-12 * s else 2.0 * math.atan2(sine, s) / sine
    w[0] = factor * x
    w[1] = factor * y
    w[2] = factor * z


@kernel
def turn(R, x, y, z, E, T):
    """R <- exp((x, y, z)) R in place, followed by one Newton step back to orthogonality."""
    rotation_exp(x, y, z, E)
    matmul3(E, R, T)
    for i in range(3):
        for j in range(3):
            E[i, j] = T[0, i] * T[0, j] + T[1, i] * T[1, j] + T[2, i] * T[2, j]
    for i in range(3):
        for j in range(3):
            R[i, j] = 1.5 * T[i, j] - 0.5 * (T[i, 0] * E[0, j] + T[i, 1] * E[1, j] + T[i, 2] * E[2, j])


@kernel
def fill_quaternion(R, quaternion):
    """quaternion (4,) <- of R (3, 3), by way of its rotation vector."""
    vector = quaternion[:3]
    rotation_log(R, vector)
    angle = math.sqrt(vector[0] * vector[0] + vector[1] * vector[1] + vector[2] * vector[2])
    scale = math.sin(0.5 * angle) / angle if angle > 0.0 else 0.5
    for i in range(3):
        vector[i] *= scale
    quaternion[3] = math.cos(0.5 * angle)


@kernel
def fill_rotation(quaternion, R):
    """R (3, 3) <- of a quaternion (4,), x y z w, of any length but 0."""
    x, y, z, w = quaternion[0], quaternion[1], quaternion[2], quaternion[3]
    double = 2.0 / (w * w + x * x + y * y + z * z)
    R[0, 0] = 1.0 - double * (y * y + z * z)
    R[1, 1] = 1.0 - double * (x * x + z * z)
    R[2, 2] = 1.0 - double * (x * x + y * y)
    R[0, 1], R[1, 0] = double * (x * y - w * z), double * (x * y + w * z)
    R[0, 2], R[2, 0] = double * (x * z + w * y), double * (x * z - w * y)
    R[1, 2], R[2, 1] = double * (y * z - w * x), double * (y * z + w * x)


@njit(cache=True)
def polar_rotation(M):
    """Return the rotation (3, 3) nearest to a matrix (3, 3), by its quaternion (Horn, JOSA A 4, 1987).

    Of the unit quaternions q, that of the rotation R with the largest trace(R' M) is the largest eigenvector of N.
    """
    N, Q, R, q = np.empty((4, 4)), np.empty((4, 4)), np.empty((3, 3)), np.empty(4)
    (xx, xy, xz), (yx, yy, yz), (zx, zy, zz) = M
    N[0] = xx + yy + zz, zy - yz, xz - zx, yx - xy
    N[1] = zy - yz, xx - yy - zz, xy + yx, xz + zx
    N[2] = xz - zx, xy + yx, yy - xx - zz, yz + zy
    N[3] = yx - xy, xz + zx, yz + zy, zz - xx - yy
    diagonalise(N, Q)
    largest = np.diag(N).argmax()
    q[3], q[:3] = Q[0, largest], Q[1:, largest]
    fill_rotation(q, R)
    return R


@njit(cache=True)
def rigid_transform(source, target):
    """R (3, 3) and t (3,) for which R source + t is nearest to ``target``: points (n, 3) (Kabsch 1976).

    Three points that do not lie on a line fix them.
    """
    centre_source, centre_target = source.sum(0) / len(source), target.sum(0) / len(target)
    R = polar_rotation(np.dot((target - centre_target).T, source - centre_source))
    return R, centre_target - np.dot(R, centre_source)
