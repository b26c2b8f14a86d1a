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
    ca, cb, total = np.zeros(3), np.zeros(3), w.sum()
    if total > 0.0:
        ca, cb = np.dot(w, a) / total, np.dot(w, b) / total
    angle = _rotation_about(a - ca, b - cb, w, R)
    t[:] = cb - np.dot(R, ca)
    return angle


@njit(cache=True)
def weighted_procrustes_about(joint, a, b, w, R):
    """WOPP: the rotation about ``joint`` (3,) that takes a nearest to b. Writes ``R``; returns its angle (rad).

    The limb's form: both centroids are the joint and there is no shift (thesis 4.2 with u = 0, which as printed
    divides zero by zero).
    """
    return _rotation_about(a - joint, b - joint, w, R)


@njit(cache=True)
def _rotation_about(a, b, w, R):
    """R (3, 3) <- the proper rotation about the origin that maximises tr(R S), S = sum w a b^T (eq. 4.8 corrected: the
    printed product of (p, 3) matrices does not exist); returns its angle (rad). S = 0 gives the identity."""
    R[:] = polar_rotation(np.dot(b.T, a * w.reshape(-1, 1)))
    vector = np.empty(3)
    rotation_log(R, vector)
    return np.sqrt(np.sum(vector * vector))


@njit(cache=True)
def weighted_swing_about(joint, direction, a, b, w, R):
    """Find the smallest rotation about ``joint`` that turns a lone stick along ``direction`` (3,) onto its points.

    The points of one straight stick have a moment of rank one: Procrustes would return an arbitrary twist. The target
    direction is sum w |a - joint| (b - joint). Writes ``R``; returns its angle (rad).
    """
    levers = w * np.sqrt(((a - joint) ** 2).sum(axis=1))
    return swing_rotation(direction, np.dot(levers, b - joint), R)


@njit(cache=True)
def swing_rotation(direction, target, R):
    """Find the smallest rotation that takes ``direction`` (3,) onto the ray of ``target`` (3,); returns its angle.

    The identity when either is zero. Opposite directions leave the axis open: the coordinate axis most nearly
    perpendicular to ``direction`` then fixes it, the same every time.
    """
    R[:] = np.eye(3)
    length, reach = np.sqrt(np.sum(direction**2)), np.sqrt(np.sum(target**2))
    if length == 0.0 or reach == 0.0:
        return 0.0
    f, g = direction / length, target / reach
    axis, cosine = np.cross(f, g), np.dot(f, g)
    if cosine < ANTIPARALLEL:
        axis, cosine = np.cross(f, np.eye(3)[np.argmin(np.abs(f))]), -1.0
    # half-angle quaternion (1 + cos, v), not normalised
    fill_rotation(np.array([axis[0], axis[1], axis[2], 1.0 + cosine]), R)
    return np.pi if cosine == -1.0 else np.arctan2(np.sqrt(np.sum(axis**2)), cosine)
