"""Normal equations of an articulated figure: how residuals become H (n, n) and g (n,) of the step H d = g.

The first 24 unknowns are the pose's tangent. Terms fill the upper triangle of H. There are two kinds of residual:
displacements of points that are fixed to a stick (:mod:`.point_factor`), and distances from capsules. A distance from
the surface of a capsule, along the unit normal n at the place u of its axis, is linear in the capsule's ends P and Q
and its two radii:

    e = n . (x - (1-u) P - u Q) - (1-u) r_P - u r_Q,    de = -(1-u) m . d(P, r_P) - u m . d(Q, r_Q),    m = (n, 1)

so the data of a capsule enter through the sums of w (1-u)^2 m m^T, w u (1-u) m m^T, w u^2 m m^T and of w (1-u) e m,
w u e m, and the equations of any unknowns follow from the capsules' derivatives. A pose moves the ends alone.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from capture_rig.kernel import kernel, njit
from capture_rig.small_matrices import inverse_positive

from .. import kernels
from ..skeleton import POINT_STICK
from .posed_model import POINTS, reference_points

TANGENT = 24
CHAIN_COLUMNS, TORSO_COLUMNS = 11, 6  # most columns that a point's Jacobian can have; those of the torso come first
ENDS, WHOLE = 3, 4  # numbers at either end of a capsule: its place, and with its radius
_ROW, _COLUMN = np.array([0, 0, 0, 1, 1, 2, 0, 1, 2, 3]), np.array([0, 1, 2, 1, 2, 2, 3, 3, 3, 3])


class CapsuleSums(NamedTuple):
    """Sums over the distances from each of k capsules.

    squares (k, 3, 6 or 10) : of w (1-u)^2, w u (1-u), w u^2 times the products m_p m_q (xx xy xz yy yz zz, and for the
    radii x y z 1). pulls (k, 2, 4) : of w (1-u) e m and w u e m.
    """

    squares: np.ndarray
    pulls: np.ndarray


@njit(cache=True)
def no_sums(capsules, numbers):
    """Return zero sums of each of k ``capsules``; ``numbers`` is ENDS or WHOLE."""
    return CapsuleSums(np.zeros((capsules, 3, numbers * (numbers + 1) // 2)), np.zeros((capsules, 2, 4)))


@njit(cache=True)
def add_to_sums(sums, capsule, along, normals, weight, distance):
    """Add distances (n,) from their capsules (n,), at the places ``along`` (n,) of the axes, along ``normals`` (3, n).

    Capsule by capsule, so that the sums of one stay in registers; in the order of the data.
    """
    last, order = np.zeros(sums.pulls.shape[0], np.int64), np.empty(capsule.shape[0], np.int64)
    _sort_by_capsule(capsule, last, order)
    x, y, z = normals[0], normals[1], normals[2]
    for k in range(last.shape[0]):
        own, squares, pulls = order[last[k - 1] if k > 0 else 0 : last[k]], sums.squares[k], sums.pulls[k]
        aa, ab, bb = _six(squares[0]), _six(squares[1]), _six(squares[2])
        a, b = _four(pulls[0]), _four(pulls[1])
        for i in own:
            u, e, normal = along[i], distance[i], (x[i], y[i], z[i], 1.0)
            start, end, products = weight[i] * (1.0 - u), weight[i] * u, _products(normal)
            aa = _plus_six(aa, start * (1.0 - u), products)
            ab = _plus_six(ab, start * u, products)
            bb = _plus_six(bb, end * u, products)
            a = _plus_four(a, start * e, normal)
            b = _plus_four(b, end * e, normal)
        _store(squares[0], aa)
        _store(squares[1], ab)
        _store(squares[2], bb)
        _store(pulls[0], a)
        _store(pulls[1], b)
        if squares.shape[1] > 6:
            aa, ab, bb = _four(squares[0, 6:]), _four(squares[1, 6:]), _four(squares[2, 6:])
            for i in own:
                u, normal = along[i], (x[i], y[i], z[i], 1.0)
                start, end = weight[i] * (1.0 - u), weight[i] * u
                aa = _plus_four(aa, start * (1.0 - u), normal)
                ab = _plus_four(ab, start * u, normal)
                bb = _plus_four(bb, end * u, normal)
            _store(squares[0, 6:], aa)
            _store(squares[1, 6:], ab)
            _store(squares[2, 6:], bb)


@kernel
def _sort_by_capsule(capsule, last, order):
    """order (n,) <- rows sorted by capsule; last (k,), zero before, <- the end of each capsule's rows there."""
    for i in range(capsule.shape[0]):
        last[capsule[i]] += 1
    total = 0
    for k in range(last.shape[0]):
        count, last[k] = last[k], total
        total += count
    for i in range(capsule.shape[0]):
        order[last[capsule[i]]] = i
        last[capsule[i]] += 1


@kernel
def _products(m):
    """Return the products xx xy xz yy yz zz of a normal."""
    return m[0] * m[0], m[0] * m[1], m[0] * m[2], m[1] * m[1], m[1] * m[2], m[2] * m[2]


@kernel
def _plus_six(s, weight, m):
    first = s[0] + weight * m[0], s[1] + weight * m[1], s[2] + weight * m[2]
    return *first, s[3] + weight * m[3], s[4] + weight * m[4], s[5] + weight * m[5]


@kernel
def _plus_four(s, weight, m):
    return s[0] + weight * m[0], s[1] + weight * m[1], s[2] + weight * m[2], s[3] + weight * m[3]


@kernel
def _six(array):
    return array[0], array[1], array[2], array[3], array[4], array[5]


@kernel
def _four(array):
    return array[0], array[1], array[2], array[3]


@kernel
def _store(array, numbers):
    for q in range(len(numbers)):
        array[q] = numbers[q]


@njit(cache=True)
def add_pose_sums(sums, posed, H, g):
    """Add the sums of distances to the equations of the pose."""
    M, slots = np.empty((2 * ENDS, CHAIN_COLUMNS)), np.empty(CHAIN_COLUMNS, np.int64)
    work = np.empty((2 * ENDS + 1, 2 * ENDS))
    for k in range(posed.P.shape[0]):
        if sums.pulls[k].any():
            add_capsule(sums, k, M, slots, pose_columns(k, posed, M, slots), work, H, g)


@kernel
def pose_columns(k, posed, M, slots):
    """Fill M (6 or 8, n) with the derivatives of capsule k's ends along the tangent ``slots`` (n,); returns n."""
    stick, second = posed.surface.stick[k], M.shape[0] // 2
    kernels.point_jacobian(stick, posed.P[k], posed.t0, posed.A, posed.axes, M[:3], slots)
    return kernels.point_jacobian(stick, posed.Q[k], posed.t0, posed.A, posed.axes, M[second:], slots)


@kernel
def add_capsule(sums, k, M, slots, n, work, H, g):
    """Add the sums of capsule k, whose ends have the derivatives M (6, n) by the unknowns ``slots`` (n,).

    work (c + 1, c), c the capsule's numbers: scratch.
    """
    _add_numbers(2 * ENDS, sums, k, M, slots, n, n, work, H, g)


@kernel
def add_whole_capsule(sums, k, M, slots, n, common, work, H, g):
    """Add the sums of capsule k with a radius at either end, M (8, n + common), for unknowns of its own and those
    ``common`` to all capsules, which are the last ones of H."""
    for s in range(common):
        slots[n + s] = H.shape[0] - common + s
    _add_numbers(2 * WHOLE, sums, k, M, slots, n, n + common, work, H, g)


@kernel
def _add_numbers(c, sums, k, M, slots, own, n, work, H, g):
    """Add c numbers; the slots of the unknowns from ``own`` to n are the last ones of H, in order. With a c that the
    compiler knows, the inner loops become straight code."""
    d = c // 2
    V, half, pulls = work[:c], work[c], sums.pulls[k]
    fill_moments(sums, k, V)
    for m in range(n):
        for q in range(c):
            entry = 0.0
            for p in range(c):
                entry += M[p, m] * V[p, q]
            half[q] = entry
        for q in range(d):
            g[slots[m]] += M[q, m] * pulls[0, q]
        for q in range(d):
            g[slots[m]] += M[d + q, m] * pulls[1, q]
        for other in range(m, own):
            row, column = min(slots[m], slots[other]), max(slots[m], slots[other])
            entry = H[row, column]
            for q in range(c):
                entry += half[q] * M[q, other]
            H[row, column] = entry
        if n > own:
            first = max(m, own)
            _add_four_rows(half[:WHOLE], M[:WHOLE, first:n], H[slots[m], H.shape[0] - n + first :])
            _add_four_rows(half[WHOLE:], M[WHOLE:, first:n], H[slots[m], H.shape[0] - n + first :])


@kernel
def _add_four_rows(factors, rows, total):
    """total (n,) += factors (4,) times rows (4, n), in order; vectorised."""
    a, b, c, d = _four(factors)
    first, second, third, fourth = rows[0], rows[1], rows[2], rows[3]
    for s in range(total.shape[0]):
        total[s] = total[s] + a * first[s] + b * second[s] + c * third[s] + d * fourth[s]


@kernel
def fill_moments(sums, k, V):
    """V (c, c) <- the weights of the numbers of capsule k, its start's and its end's."""
    d = V.shape[0] // 2
    for q in range(sums.squares.shape[2]):
        i, j = _ROW[q], _COLUMN[q]
        aa, ab, bb = sums.squares[k, 0, q], sums.squares[k, 1, q], sums.squares[k, 2, q]
        V[i, j], V[j, i], V[d + i, d + j], V[d + j, d + i] = aa, aa, bb, bb
        V[i, d + j], V[j, d + i], V[d + i, j], V[d + j, i] = ab, ab, ab, ab


@kernel
def mirror_upper(H):
    """Copy the upper triangle of H onto the lower."""
    for i in range(H.shape[0]):
        for j in range(i):
            H[i, j] = H[j, i]


@njit(cache=True)
def point_covariances(information, posed):
    """Return J information^-1 J^T of the 15 reference points, (15, 3, 3) m^2, world frame."""
    points, S = reference_points(posed), inverse_positive(information)
    covariance = np.empty((POINTS, 3, 3))
    J, slots = np.empty((3, CHAIN_COLUMNS)), np.empty(CHAIN_COLUMNS, np.int64)
    for i in range(POINTS):
        n = kernels.point_jacobian(POINT_STICK[i], points[i], posed.t0, posed.A, posed.axes, J, slots)
        if i == 0:
            n = 3  # the torso's centre does not move with any rotation
        for p in range(3):
            for q in range(p + 1):
                s = 0.0
                for k in range(n):
                    for m in range(n):
                        s += J[p, k] * S[slots[k], slots[m]] * J[q, m]
                covariance[i, p, q] = s
                covariance[i, q, p] = s
    return covariance
