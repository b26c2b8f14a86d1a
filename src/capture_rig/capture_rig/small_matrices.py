"""Dense algebra of small symmetric positive definite matrices, and least squares' robust weight, compiled.

Made for the 24 unknowns of a pose, the 10 of an image corner and the 3 coordinates of a point, where calling LAPACK
costs more than the arithmetic. No fast-math and fixed orders of summation, so equal inputs give equal bytes.
"""

from __future__ import annotations

import math

import numpy as np

from .kernel import kernel, njit

MOST_SWEEPS, ROUNDING = 12, 1e-17
"""Of Jacobi's rotations: five suffice for four unknowns. What is left over the eigenvalues when they end."""


@kernel
def robust_weight(information, squared):
    """Return the Geman-McClure weight of a residual, ``squared`` over its squared gate: a quarter at the gate."""
    ratio = 1.0 + squared
    return information / (ratio * ratio)


@kernel
def cholesky(M, L):
    """Fill the lower triangle of ``L`` (n, n) with M = L L'; False when M is not positive definite (NaN is not).

    Reads the lower triangle of ``M`` alone. ``L`` may be ``M`` itself.
    """
    for i in range(M.shape[0]):
        for j in range(i + 1):
            s = M[i, j]
            for k in range(j):
                s -= L[i, k] * L[j, k]
            if i > j:
                L[i, j] = s / L[j, j]
            elif s > 0.0:
                L[i, i] = math.sqrt(s)
            else:
                return False
    return True


@kernel
def solve_positive(M, b, L, x):
    """Solve M x = b for ``x`` (n,) by the Cholesky factor, left in ``L``; False when M is not positive definite."""
    if not cholesky(M, L):
        return False
    n = M.shape[0]
    for i in range(n):
        s = b[i]
        for k in range(i):
            s -= L[i, k] * x[k]
        x[i] = s / L[i, i]
    for i in range(n - 1, -1, -1):
        s = x[i]
        for k in range(i + 1, n):
            s -= L[k, i] * x[k]
        x[i] = s / L[i, i]
    return True


@kernel
def solve_positive_columns(M, L, B):
    """Replace B (n, m) by M^-1 B; the Cholesky factor is left in ``L``. False when M is not positive definite."""
    if not cholesky(M, L):
        return False
    n, m = B.shape
    for i in range(n):
        for k in range(i):
            for c in range(m):
                B[i, c] -= L[i, k] * B[k, c]
        for c in range(m):
            B[i, c] /= L[i, i]
    for i in range(n - 1, -1, -1):
        for k in range(i + 1, n):
            for c in range(m):
                B[i, c] -= L[k, i] * B[k, c]
        for c in range(m):
            B[i, c] /= L[i, i]
    return True


@njit(cache=True)
def inverse_positive(M):
    """Return M^-1 (n, n), exactly symmetric, for M positive definite; ValueError when it is not (NaN is not).

    With W = L^-1, M^-1 = W' W.
    """
    n = len(M)
    L, W = np.zeros((n, n)), np.zeros((n, n))
    if not cholesky(M, L):
        raise ValueError("the matrix is not positive definite")
    for i in range(n):
        W[i, i] = 1.0 / L[i, i]
        for k in range(i):
            factor = -W[i, i] * L[i, k]
            for j in range(k + 1):
                W[i, j] += factor * W[k, j]
    X = np.dot(W.T, W)
    symmetrise(X)
    return X


@njit(cache=True)
def symmetrise(X):
    """Replace X by (X + X') / 2, in place: rounding makes the two triangles differ."""
    for i in range(len(X)):
        for j in range(i):
            mean = 0.5 * (X[i, j] + X[j, i])
            X[i, j] = mean
            X[j, i] = mean


@kernel
def inverse3(S, out):
    """Fill ``out`` (3, 3) with S^-1 of a symmetric positive definite S (3, 3), by cofactors."""
    a, b, c, d, e, f = S[0, 0], S[0, 1], S[0, 2], S[1, 1], S[1, 2], S[2, 2]
    A, B, C = d * f - e * e, c * e - b * f, b * e - c * d
    scale = 1.0 / (a * A + b * B + c * C)
    out[0, 0], out[0, 1], out[0, 2] = scale * A, scale * B, scale * C
    out[1, 0], out[1, 1], out[1, 2] = scale * B, scale * (a * f - c * c), scale * (b * c - a * e)
    out[2, 0], out[2, 1], out[2, 2] = scale * C, scale * (b * c - a * e), scale * (a * d - b * b)


@kernel
def positive3(S):
    """Return whether S (3, 3), symmetric, is positive definite (Sylvester's criterion) and finite."""
    a, b, c, d, e, f = S[0, 0], S[0, 1], S[0, 2], S[1, 1], S[1, 2], S[2, 2]
    determinant = a * (d * f - e * e) + b * (c * e - b * f) + c * (b * e - c * d)
    return a > 0.0 and a * d - b * b > 0.0 and 0.0 < determinant < math.inf


@kernel
def diagonalise(S, V):
    """Turn a symmetric S (n, n) into the diagonal of its eigenvalues; V (n, n) <- eigenvectors, one a column.

    Cyclic Jacobi rotations (Golub & Van Loan, Matrix Computations, 8.5), until only rounding is left off the diagonal.
    """
    n = S.shape[0]
    for i in range(n):
        for j in range(n):
            V[i, j] = 1.0 if i == j else 0.0
    for _ in range(MOST_SWEEPS):
        diagonal, rest = 0.0, 0.0
        for i in range(n):
            diagonal += S[i, i] * S[i, i]
            for j in range(i):
                rest += S[i, j] * S[i, j]
        if rest <= ROUNDING * ROUNDING * diagonal:
            return
        for p in range(n):
            for q in range(p + 1, n):
                if S[p, q] != 0.0:
                    _rotate_away(S, V, p, q)


@kernel
def _rotate_away(S, V, p, q):
    """Turn the plane of two axes until S[p, q] is zero."""
    half = 0.5 * (S[q, q] - S[p, p]) / S[p, q]
    t = math.copysign(1.0, half) / (abs(half) + math.sqrt(1.0 + half * half))
    c = 1.0 / math.sqrt(1.0 + t * t)
    s = t * c
    for k in range(S.shape[0]):
        S[k, p], S[k, q] = c * S[k, p] - s * S[k, q], s * S[k, p] + c * S[k, q]
    for k in range(S.shape[0]):
        S[p, k], S[q, k] = c * S[p, k] - s * S[q, k], s * S[p, k] + c * S[q, k]
        V[k, p], V[k, q] = c * V[k, p] - s * V[k, q], s * V[k, p] + c * V[k, q]
