"""Small dense algebra, compiled: plain arrays in, plain arrays out.

No fast-math and fixed orders of summation, so equal inputs give equal bytes.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit


@njit(cache=True)
def inverse_spd(S):
    """S^-1 (n, n), exactly symmetric, for S symmetric positive definite; ValueError when it is not (NaN is not).

    With Cholesky's factor S = C C' and W = C^-1, both lower triangular, S^-1 = W' W. At 24 x 24 faster than LAPACK.
    """
    n = len(S)
    C, W = np.zeros((n, n)), np.zeros((n, n))
    for i in range(n):
        row = C[i]
        for j in range(i):
            other, rest = C[j], S[i, j]
            for k in range(j):
                rest -= row[k] * other[k]
            row[j] = rest * W[j, j]
        rest = S[i, i]
        for k in range(i):
            rest -= row[k] * row[k]
        if not rest > 0.0:
            raise ValueError("the matrix is not positive definite")
        W[i, i] = 1.0 / math.sqrt(rest)
    for i in range(n):
        for k in range(i):
            factor = -W[i, i] * C[i, k]
            for j in range(k + 1):
                W[i, j] += factor * W[k, j]
    X = np.dot(W.T, W)
    symmetrise(X)
    return X


@njit(cache=True)
def symmetrise(X):
    """X <- (X + X') / 2, in place: rounding makes the two triangles drift apart."""
    for i in range(len(X)):
        for j in range(i):
            mean = 0.5 * (X[i, j] + X[j, i])
            X[i, j] = mean
            X[j, i] = mean


@njit(cache=True)
def inverse3(S, out):
    """out (3, 3) <- S^-1 of a symmetric positive definite S (3, 3), by cofactors."""
    a, b, c, d, e, f = S[0, 0], S[0, 1], S[0, 2], S[1, 1], S[1, 2], S[2, 2]
    A, B, C = d * f - e * e, c * e - b * f, b * e - c * d
    scale = 1.0 / (a * A + b * B + c * C)
    out[0, 0], out[0, 1], out[0, 2] = scale * A, scale * B, scale * C
    out[1, 0], out[1, 1], out[1, 2] = scale * B, scale * (a * f - c * c), scale * (b * c - a * e)
    out[2, 0], out[2, 1], out[2, 2] = scale * C, scale * (b * c - a * e), scale * (a * d - b * b)


@njit(cache=True)
def positive3(S):
    """Whether S (3, 3), symmetric, is positive definite (Sylvester's criterion) and finite."""
    a, b, c, d, e, f = S[0, 0], S[0, 1], S[0, 2], S[1, 1], S[1, 2], S[2, 2]
    determinant = a * (d * f - e * e) + b * (c * e - b * f) + c * (b * e - c * d)
    return a > 0.0 and a * d - b * b > 0.0 and 0.0 < determinant < math.inf
