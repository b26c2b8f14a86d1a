"""Weighted Procrustes: the rotation (and shift) that moves model points onto data points (thesis 4.2).

Rows are points (p, 3); weights multiply SQUARED residuals. Everywhere ``a`` is the MODEL's foot point and ``b`` the
DATA point it belongs to: the motion found moves the model onto the data.

The thesis solves eq. 4.8-4.10 by a singular value decomposition. In the row convention of its chapter 4 they read,
corrected: ``U D V^T = sum w (a - ca)(b - cb)^T``, ``R = V diag(1, 1, det(V U^T)) U^T``, ``t = cb - R ca`` with the
weighted centroids ca, cb. The rotation maximises ``tr(R S)`` over proper rotations, which is the eigenvector of the
largest eigenvalue of Davenport's 4x4 matrix (Horn, "Closed-form solution of absolute orientation using unit
quaternions", JOSA A 4, 1987). That form needs no determinant repair (a quaternion is never a reflection), no LAPACK,
and compiles to machine code; it is what runs here, and the test holds it against the SVD.
"""

from __future__ import annotations

import numpy as np

from capture_rig.kernel import njit

JACOBI_SWEEPS = 16
ANTIPARALLEL = -1.0 + 1e-12  # cosine below which two directions count as opposite


@njit(cache=True)
def weighted_extended_procrustes(a, b, w, R, t):
    """WEOPP: R a + t nearest to b. Writes ``R`` (3, 3) and ``t`` (3,); returns the rotation angle (rad).

    ``a``, ``b`` (p, 3), ``w`` (p,) >= 0. With no weight at all R is the identity and t zero.
    """
    ca = np.zeros(3)
    cb = np.zeros(3)
    total = weighted_centroids(a, b, w, ca, cb)
    S = np.zeros((3, 3))
    t[:] = 0.0
    if total > 0.0:
        moment(a, b, w, ca, cb, S)
    angle = rotation_from_moment(S, R)
    for i in range(3):
        t[i] = cb[i] - (R[i, 0] * ca[0] + R[i, 1] * ca[1] + R[i, 2] * ca[2])
    return angle


@njit(cache=True)
def weighted_procrustes_about(joint, a, b, w, R):
    """WOPP: the rotation about ``joint`` (3,) that takes a nearest to b. Writes ``R``; returns its angle (rad).

    The limb's form: both centroids are the joint and there is no shift (thesis 4.2 with u = 0, which as printed
    divides zero by zero).
    """
    S = np.zeros((3, 3))
    moment(a, b, w, joint, joint, S)
    return rotation_from_moment(S, R)


@njit(cache=True)
def weighted_swing_about(joint, direction, a, b, w, R):
    """Find the smallest rotation about ``joint`` that turns a lone stick along ``direction`` (3,) onto its points.

    The points of one straight stick have a moment of rank one: Procrustes would return an arbitrary twist. The target
    direction is sum w |a - joint| (b - joint). Writes ``R``; returns its angle (rad).
    """
    target = np.zeros(3)
    for i in range(a.shape[0]):
        if w[i] > 0.0:
            x, y, z = a[i, 0] - joint[0], a[i, 1] - joint[1], a[i, 2] - joint[2]
            lever = w[i] * np.sqrt(x * x + y * y + z * z)
            for k in range(3):
                target[k] += lever * (b[i, k] - joint[k])
    return swing_rotation(direction, target, R)


@njit(cache=True)
def weighted_centroids(a, b, w, ca, cb):
    """Weighted centroids of both sets into ``ca``, ``cb`` (3,); returns the sum of the weights."""
    total = 0.0
    ca[:] = 0.0
    cb[:] = 0.0
    for i in range(a.shape[0]):
        total += w[i]
        for k in range(3):
            ca[k] += w[i] * a[i, k]
            cb[k] += w[i] * b[i, k]
    if total > 0.0:
        for k in range(3):
            ca[k] /= total
            cb[k] /= total
    return total


@njit(cache=True)
def moment(a, b, w, ca, cb, S):
    """S = sum w (a - ca)(b - cb)^T (eq. 4.8 corrected: the printed product of (p,3) matrices does not exist)."""
    S[:] = 0.0
    for i in range(a.shape[0]):
        if w[i] > 0.0:
            for p in range(3):
                left = w[i] * (a[i, p] - ca[p])
                for q in range(3):
                    S[p, q] += left * (b[i, q] - cb[q])


@njit(cache=True)
def rotation_from_moment(S, R):
    """Proper rotation R maximising tr(R S); returns its angle (rad). S = 0 gives the identity."""
    K = np.empty((4, 4))
    trace = S[0, 0] + S[1, 1] + S[2, 2]
    for p in range(3):
        for q in range(3):
            K[p + 1, q + 1] = S[p, q] + S[q, p]
        K[p + 1, p + 1] -= trace
    K[0, 0] = trace
    K[0, 1] = S[1, 2] - S[2, 1]
    K[0, 2] = S[2, 0] - S[0, 2]
    K[0, 3] = S[0, 1] - S[1, 0]
    for p in range(1, 4):
        K[p, 0] = K[0, p]
    V = np.eye(4)
    diagonalise(K, V)
    best = 0
    for k in range(1, 4):
        if K[k, k] > K[best, best]:
            best = k
    return rotation_from_quaternion(V[0, best], V[1, best], V[2, best], V[3, best], R)


@njit(cache=True)
def diagonalise(K, V):
    """Cyclic Jacobi rotations: K (4, 4) symmetric becomes diagonal, V collects its eigenvectors as columns."""
    scale = 0.0
    for p in range(4):
        for q in range(4):
            scale += K[p, q] * K[p, q]
    for _ in range(JACOBI_SWEEPS):
        off = 0.0
        for p in range(3):
            for q in range(p + 1, 4):
                off += K[p, q] * K[p, q]
        if off <= 1e-32 * scale:
            return
        for p in range(3):
            for q in range(p + 1, 4):
                if K[p, q] != 0.0:
                    jacobi_rotation(K, V, p, q)


@njit(cache=True)
def jacobi_rotation(K, V, p, q):
    """Annihilate K[p, q] (Golub & Van Loan 8.5)."""
    tau = (K[q, q] - K[p, p]) / (2.0 * K[p, q])
    tangent = (1.0 if tau >= 0.0 else -1.0) / (abs(tau) + np.sqrt(1.0 + tau * tau))
    c = 1.0 / np.sqrt(1.0 + tangent * tangent)
    s = tangent * c
    for k in range(4):
        left, right = K[k, p], K[k, q]
        K[k, p], K[k, q] = c * left - s * right, s * left + c * right
    for k in range(4):
        left, right = K[p, k], K[q, k]
        K[p, k], K[q, k] = c * left - s * right, s * left + c * right
    for k in range(4):
        left, right = V[k, p], V[k, q]
        V[k, p], V[k, q] = c * left - s * right, s * left + c * right


@njit(cache=True)
def rotation_from_quaternion(w, x, y, z, R):
    """Rotation matrix of the unit quaternion (w, x, y, z) into ``R``; returns its angle in [0, pi]."""
    n = w * w + x * x + y * y + z * z
    R[0, 0] = (w * w + x * x - y * y - z * z) / n
    R[1, 1] = (w * w - x * x + y * y - z * z) / n
    R[2, 2] = (w * w - x * x - y * y + z * z) / n
    R[0, 1] = 2.0 * (x * y - w * z) / n
    R[1, 0] = 2.0 * (x * y + w * z) / n
    R[0, 2] = 2.0 * (x * z + w * y) / n
    R[2, 0] = 2.0 * (x * z - w * y) / n
    R[1, 2] = 2.0 * (y * z - w * x) / n
    R[2, 1] = 2.0 * (y * z + w * x) / n
    return 2.0 * np.arctan2(np.sqrt(x * x + y * y + z * z), abs(w))


@njit(cache=True)
def swing_rotation(direction, target, R):
    """Find the smallest rotation that takes ``direction`` (3,) onto the ray of ``target`` (3,); returns its angle.

    The identity when either is zero. Opposite directions leave the axis open: the coordinate axis most nearly
    perpendicular to ``direction`` then fixes it, the same every time.
    """
    R[:] = 0.0
    R[0, 0] = R[1, 1] = R[2, 2] = 1.0
    length = np.sqrt(direction[0] ** 2 + direction[1] ** 2 + direction[2] ** 2)
    reach = np.sqrt(target[0] ** 2 + target[1] ** 2 + target[2] ** 2)
    if length == 0.0 or reach == 0.0:
        return 0.0
    f0, f1, f2 = direction[0] / length, direction[1] / length, direction[2] / length
    g0, g1, g2 = target[0] / reach, target[1] / reach, target[2] / reach
    cosine = f0 * g0 + f1 * g1 + f2 * g2
    if cosine < ANTIPARALLEL:
        return half_turn_across(f0, f1, f2, R)
    v0, v1, v2 = f1 * g2 - f2 * g1, f2 * g0 - f0 * g2, f0 * g1 - f1 * g0
    # half-angle quaternion (1 + cos, v), not normalised
    rotation_from_quaternion(1.0 + cosine, v0, v1, v2, R)
    return np.arctan2(np.sqrt(v0 * v0 + v1 * v1 + v2 * v2), cosine)


@njit(cache=True)
def half_turn_across(f0, f1, f2, R):
    """Half turn about an axis perpendicular to the unit vector f."""
    if abs(f0) <= abs(f1) and abs(f0) <= abs(f2):
        k0, k1, k2 = 0.0, f2, -f1  # f x e_x
    elif abs(f1) <= abs(f2):
        k0, k1, k2 = -f2, 0.0, f0  # f x e_y
    else:
        k0, k1, k2 = f1, -f0, 0.0  # f x e_z
    rotation_from_quaternion(0.0, k0, k1, k2, R)
    return np.pi
