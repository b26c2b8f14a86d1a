"""The filter's inner loops, compiled: plain arrays in, plain arrays out.

No fast-math and fixed orders of summation, so equal inputs give equal bytes. The pose's state arrays t0, R0, RJ, hinges
are those of `stick_figure.kernels`.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from stick_figure import kernels
from stick_figure.body import Body
from stick_figure.pose import Pose
from stick_figure.skeleton import POINT_STICK

STEP_LIMIT = 0.5
"""rad and m: a longer Gauss-Newton step is outside the region where the linearisation holds."""
LINEAR_M = 1e-3
"""When every point is this close to where the linearisation said, linearising again is not worth it."""


def points_and_jacobian(body: Body, pose: Pose) -> tuple[np.ndarray, np.ndarray]:
    """The measurement function h (15, 3) m and its Jacobian H (15, 3, 24) with respect to the pose's tangent.

    Thesis Tables 5.2 and 5.8 (p1's row corrected: p1 is the torso's position and nothing else).
    """
    h, H = np.empty((15, 3)), np.empty((15, 3, 24))
    t0, R0, RJ, hinges = pose.arrays
    _points_and_jacobian(t0, R0, RJ, hinges, body.lengths, body.stick_origins_torso, POINT_STICK, h, H)
    return h, H


@njit(cache=True)
def _points_and_jacobian(t0, R0, RJ, hinges, lengths, origins, sticks, h, H):
    G, axes = np.empty((10, 3, 3)), np.zeros((18, 3))
    A, B = np.empty((10, 3)), np.empty((10, 3))
    kernels.stick_frames(R0, RJ, hinges, G, axes)
    kernels.stick_ends(G, t0, lengths, origins, A, B)
    kernels.reference_points(A, B, t0, h)
    columns, slots = np.empty((3, 11)), np.empty(11, np.int64)
    H[:] = 0.0
    for point in range(15):
        n = kernels.point_jacobian(sticks[point], h[point], t0, A, axes, columns, slots)
        for i in range(3):
            for k in range(n):
                H[point, i, slots[k]] = columns[i, k]


@njit(cache=True)
def relinearised(prior, pose, lengths, origins, sticks, P_pose, z, R, chosen, iterations):
    """Iterates the EKF's update (thesis Table 5.7) to the pose at which its own linearisation holds.

    prior, pose : state arrays (t0, R0, RJ, hinges); ``pose`` is the first linearisation, and becomes the result.
    P_pose (24, 24) : the prior's covariance. z (15, 3), R (15, 3, 3) : the points and their covariances.
    chosen (m,) int : the points to use. Returns, for the last linearisation, H (3m, 24), S^-1 H (3m, 24), and the
    innovation as seen from the prior's mean, z - h(x) + H (x (-) prior), (3m,).
    """
    t0, R0, RJ, hinges = pose
    t0_prior, R0_prior, RJ_prior, hinges_prior = prior
    n = 3 * len(chosen)
    h, H_all, H_next = np.empty((15, 3)), np.empty((15, 3, 24)), np.empty((15, 3, 24))
    H, SH, innovation, expected = np.empty((n, 24)), np.empty((n, 24)), np.empty(n), np.empty(n)
    gone, step = np.empty(24), np.empty(24)
    _points_and_jacobian(t0, R0, RJ, hinges, lengths, origins, sticks, h, H_next)
    for _ in range(iterations):
        H_all[:] = H_next
        for m in range(len(chosen)):
            H[3 * m : 3 * m + 3] = H_all[chosen[m]]
            expected[3 * m : 3 * m + 3] = h[chosen[m]]
            innovation[3 * m : 3 * m + 3] = z[chosen[m]] - h[chosen[m]]
        kernels.difference(t0, R0, RJ, hinges, t0_prior, R0_prior, RJ_prior, hinges_prior, gone)
        innovation += H @ gone
        S = H @ P_pose @ H.T
        for m in range(len(chosen)):
            S[3 * m : 3 * m + 3, 3 * m : 3 * m + 3] += R[chosen[m]]
        SH = solve_spd(S, H)
        step[:] = P_pose @ (innovation @ SH) - gone
        step *= min(1.0, STEP_LIMIT / max(np.abs(step).max(), STEP_LIMIT))
        t0[:], R0[:], RJ[:], hinges[:] = t0_prior, R0_prior, RJ_prior, hinges_prior
        kernels.retract(t0, R0, RJ, hinges, gone + step, 1.0)
        _points_and_jacobian(t0, R0, RJ, hinges, lengths, origins, sticks, h, H_next)
        expected += H @ step
        for m in range(len(chosen)):
            expected[3 * m : 3 * m + 3] -= h[chosen[m]]
        if np.abs(expected).max() < LINEAR_M:
            break
    return H, SH, innovation


@njit(cache=True)
def joseph(P, K, H, R):
    """(I - K H) P (I - K H)' + K R K' for K (48, 3m), H (3m, 24) on the pose, and R (m, 3, 3) on its diagonal.

    Joseph's form, because a sum of two squares stays symmetric and positive whatever the rounding of K;
    the thesis's (I - K H) P (Table 5.7) is right only for the exact gain and loses both over a few thousand sets.
    """
    n = len(P)
    A = np.eye(n)
    A[:, : H.shape[1]] -= K @ H
    KR = np.empty_like(K)
    for m in range(len(R)):
        for i in range(n):
            for j in range(3):
                KR[i, 3 * m + j] = (
                    K[i, 3 * m] * R[m, 0, j] + K[i, 3 * m + 1] * R[m, 1, j] + K[i, 3 * m + 2] * R[m, 2, j]
                )
    C = A @ P @ A.T + KR @ K.T
    return 0.5 * (C + C.T)


@njit(cache=True)
def point_covariances(H, P_pose):
    """H P H' (15, 3, 3) of each point from H (15, 3, 24) and P_pose (24, 24)."""
    C = np.zeros((15, 3, 3))
    row = np.empty(24)
    for point in range(15):
        for i in range(3):
            row[:] = 0.0
            for k in range(24):
                if H[point, i, k] != 0.0:
                    for m in range(24):
                        row[m] += H[point, i, k] * P_pose[k, m]
            for j in range(3):
                for m in range(24):
                    C[point, i, j] += row[m] * H[point, j, m]
    return C


@njit(cache=True)
def mahalanobis(y, S):
    """Squared lengths y' S^-1 y (n,) of y (n, 3) under S (n, 3, 3), each positive definite."""
    distances = np.empty(len(y))
    for i in range(len(y)):
        distances[i] = (y[i] * solve_spd(S[i], y[i].copy().reshape(3, 1))[:, 0]).sum()
    return distances


@njit(cache=True)
def cholesky_upper(S):
    """U (n, n) with U' U = S in its upper triangle, and whether S (n, n) is positive definite (NaN is not)."""
    n = len(S)
    U = S.copy()
    for k in range(n):
        if not U[k, k] > 0.0:
            return U, False
        pivot = math.sqrt(U[k, k])
        for j in range(k, n):
            U[k, j] /= pivot
        for i in range(k + 1, n):
            for j in range(i, n):
                U[i, j] -= U[k, i] * U[k, j]
    return U, True


@njit(cache=True)
def all_covariances(C, tolerance):
    """Whether every matrix of C (k, n, n) is positive definite and, within the tolerance, symmetric (NaN is not)."""
    good = True
    for i in range(len(C)):
        good = good and np.abs(C[i] - C[i].T).max() < tolerance and cholesky_upper(C[i])[1]
    return good


@njit(cache=True)
def solve_spd(S, B):
    """S^-1 B for S (n, n) symmetric positive definite and B (n, m), by Cholesky; ValueError when S is not.

    All inner loops run along rows, so they fill vector registers; at these sizes that beats LAPACK several times.
    """
    n, m = B.shape
    U, positive = cholesky_upper(S)
    if not positive:
        raise ValueError("the matrix is not positive definite")
    X = B.copy()
    for i in range(n):  # U' Y = B
        for k in range(i):
            for c in range(m):
                X[i, c] -= U[k, i] * X[k, c]
        for c in range(m):
            X[i, c] /= U[i, i]
    for i in range(n - 1, -1, -1):  # U X = Y
        for k in range(i + 1, n):
            for c in range(m):
                X[i, c] -= U[i, k] * X[k, c]
        for c in range(m):
            X[i, c] /= U[i, i]
    return X
