"""Weighted Procrustes: the rotation (and shift) that moves model points onto data points (thesis 4.2).

Rows are points (p, 3); weights multiply SQUARED residuals. Everywhere ``a`` is the MODEL's foot point and ``b`` the
DATA point it belongs to: the motion found moves the model onto the data.

The thesis solves eq. 4.8-4.10 by a singular value decomposition. In the row convention of its chapter 4 they read,
corrected: ``U D V^T = sum w (a - ca)(b - cb)^T``, ``R = V diag(1, 1, det(V U^T)) U^T``, ``t = cb - R ca`` with the
weighted centroids ca, cb. The rotation maximises ``tr(R S)`` over proper rotations: Horn's quaternion
(`capture_rig.rigid.polar_rotation`), which needs no determinant repair, is what runs here; the test holds it against
the SVD.
"""

from __future__ import annotations

import numpy as np

from capture_rig.kernel import njit
from capture_rig.rigid import fill_rotation, polar_rotation, rotation_log

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
    R[:] = polar_rotation(S.T)
    vector = np.empty(3)
    rotation_log(R, vector)
    return np.sqrt(np.sum(vector * vector))


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
    fill_rotation(np.array([v0, v1, v2, 1.0 + cosine]), R)
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
    fill_rotation(np.array([k0, k1, k2, 0.0]), R)
    return np.pi
