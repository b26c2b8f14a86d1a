"""Normal equations of an articulated figure: how residuals become H (n, n) and g (n,) of the step H d = g.

The first 24 unknowns are the pose's tangent. Terms fill the upper triangle of H. Three kinds of residual are known:
displacements of points that are fixed to a stick (:mod:`.point_factor`), single numbers with a sparse derivative, and
distances from capsules. A distance from the surface of a capsule, taken along the unit normal n at the place u of its
axis, is linear in what a capsule consists of, its ends P and Q and its two radii:

    e = n . (x - (1-u) P - u Q) - (1-u) r_P - u r_Q,    de = v . d(P, Q, r_P, r_Q),    v = -((1-u) n, u n, 1-u, u)

so the data of a capsule enter through the sums V = w v v^T and b = w e v, and the equations of any unknowns follow from
the capsules' derivatives M_k: H = sum_k M_k^T V_k M_k, g = -sum_k M_k^T b_k. A pose moves the ends alone: 6 numbers.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from capture_rig.small_matrices import inverse_positive

from .. import kernels
from ..skeleton import POINT_STICK
from .placed_figure import POINTS, reference_points

TANGENT = 24
CHAIN_COLUMNS = 11  # most columns that a point's Jacobian can have
OF_ENDS, OF_CAPSULE = 6, 8  # numbers of a capsule that a pose moves, and all of them


@njit(cache=True)
def add_scalar_residual(row, slots, n, residual, weight, H, g):
    """Add one scalar residual with sparse derivative ``row`` (n,) at ``slots``."""
    for m in range(n):
        a = weight * row[m]
        g[slots[m]] += a * residual
        for q in range(m, n):
            first, last = min(slots[m], slots[q]), max(slots[m], slots[q])
            H[first, last] += a * row[q]


@njit(cache=True)
def add_to_sums(k, u, n0, n1, n2, weight, residual, V, b):
    """Add one distance from capsule k to the sums V (k, c, c) and b (k, c); c = 6 leaves the radii out."""
    c = V.shape[1]
    v = np.empty(OF_CAPSULE)
    v[0], v[1], v[2] = -(1.0 - u) * n0, -(1.0 - u) * n1, -(1.0 - u) * n2
    v[3], v[4], v[5] = -u * n0, -u * n1, -u * n2
    v[6], v[7] = -(1.0 - u), -u
    for p in range(c):
        a = weight * v[p]
        b[k, p] += a * residual
        for q in range(c):
            V[k, p, q] += a * v[q]


@njit(cache=True)
def pose_columns(placed, M):
    """Fill M (k, 6 or 8, :24) with the derivatives of the capsules' ends with respect to the pose's tangent."""
    J, slots = np.empty((3, CHAIN_COLUMNS)), np.empty(CHAIN_COLUMNS, np.int64)
    for k in range(M.shape[0]):
        for end in range(2):
            point = placed.P[k] if end == 0 else placed.Q[k]
            n = kernels.point_jacobian(placed.surface.stick[k], point, placed.t0, placed.A, placed.axes, J, slots)
            for m in range(n):
                for i in range(3):
                    M[k, 3 * end + i, slots[m]] = J[i, m]


@njit(cache=True)
def add_sums(M, V, b, H, g):
    """Add M^T V M and -M^T b of all capsules; most of a capsule's columns are empty, and passed over."""
    c = V.shape[1]
    used, half = np.empty(M.shape[2], np.int64), np.empty(c)
    for k in range(M.shape[0]):
        count = 0
        for column in range(M.shape[2]):
            for p in range(c):
                if M[k, p, column] != 0.0:
                    used[count] = column
                    count += 1
                    break
        for m in range(count):
            for q in range(c):
                half[q] = 0.0
                for p in range(c):
                    half[q] += M[k, p, used[m]] * V[k, p, q]
                g[used[m]] -= M[k, q, used[m]] * b[k, q]
            for other in range(m, count):
                for q in range(c):
                    H[used[m], used[other]] += half[q] * M[k, q, used[other]]


@njit(cache=True)
def add_pose_sums(V, b, placed, H, g):
    """Add the sums of distances V (k, 6, 6), b (k, 6) to the equations of the pose."""
    M = np.zeros((V.shape[0], OF_ENDS, TANGENT))
    pose_columns(placed, M)
    add_sums(M, V, b, H, g)


@njit(cache=True)
def mirror_upper(H):
    """Copy the upper triangle of H onto the lower."""
    for i in range(H.shape[0]):
        for j in range(i):
            H[i, j] = H[j, i]


@njit(cache=True)
def point_covariances(information, placed, scale):
    """Return ``scale`` J information^-1 J^T of the 15 reference points, (15, 3, 3) m^2, world frame."""
    points, S = reference_points(placed), inverse_positive(information)
    covariance = np.empty((POINTS, 3, 3))
    J, slots = np.empty((3, CHAIN_COLUMNS)), np.empty(CHAIN_COLUMNS, np.int64)
    for i in range(POINTS):
        n = kernels.point_jacobian(POINT_STICK[i], points[i], placed.t0, placed.A, placed.axes, J, slots)
        if i == 0:
            n = 3  # the torso's centre does not move with any rotation
        for p in range(3):
            for q in range(p + 1):
                s = 0.0
                for k in range(n):
                    for m in range(n):
                        s += J[p, k] * S[slots[k], slots[m]] * J[q, m]
                covariance[i, p, q] = scale * s
                covariance[i, q, p] = scale * s
    return covariance
