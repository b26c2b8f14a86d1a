"""Cholesky for the 24 unknowns of a pose, compiled without LAPACK (which would pull SciPy into the node)."""

from __future__ import annotations

import numpy as np
from numba import njit

PIVOT_FLOOR = 1e-12


@njit(cache=True)
def cholesky(M, L):
    """Lower triangle L (n, n) with M = L L^T, reading the lower triangle of M; pivots are floored, never negative."""
    n = M.shape[0]
    L[:] = 0.0
    for i in range(n):
        for j in range(i + 1):
            s = M[i, j]
            for k in range(j):
                s -= L[i, k] * L[j, k]
            if i == j:
                L[i, i] = np.sqrt(max(s, PIVOT_FLOOR))
            else:
                L[i, j] = s / L[j, j]


@njit(cache=True)
def solve_positive(M, b, L, x):
    """x (n,) with M x = b for a symmetric positive definite M (n, n); ``L`` is work space."""
    n = M.shape[0]
    cholesky(M, L)
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


@njit(cache=True)
def inverse_positive(M, inverse):
    """Inverse of a symmetric positive definite M (n, n), exactly symmetric."""
    n = M.shape[0]
    L = np.zeros((n, n))
    cholesky(M, L)
    W = np.zeros((n, n))  # L^-1
    for i in range(n):
        W[i, i] = 1.0 / L[i, i]
        for j in range(i):
            s = 0.0
            for k in range(j, i):
                s -= L[i, k] * W[k, j]
            W[i, j] = s / L[i, i]
    for i in range(n):
        for j in range(i + 1):
            s = 0.0
            for k in range(i, n):
                s += W[k, i] * W[k, j]
            inverse[i, j] = s
            inverse[j, i] = s
