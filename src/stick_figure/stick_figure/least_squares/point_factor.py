"""Points against the figure: centerline points against the sticks, voxels of the hull's surface against the body's.

Centerline points are matched to their foot points, weighted robustly, summed into H and g.

Matching is step 3 of the thesis's Algorithm 2: the foot point is the nearest point of the nearest stick. (The text of
its section 4.3 looks for the closest LINE first and falls back on end points; that picks another stick for one point in
five and contradicts Algorithm 2 and figure 4.4.) Every point pulls on its stick through its foot point's derivative.
For a foot inside a stick the component along the stick is free (the foot slides); for a foot clamped to a stick's end
all three components count. This is articulated ICP as in Demirdjian & Darrell, "3-D articulated pose tracking for
untethered diectic reference", ICMI 2002, with hard joint constraints; the columns are the thesis's Table 5.8 corrected.

The centerline does not show which way a torso faces, nor an arm that hangs against it, where the slices of trunk and
arm merge. The hull's surface does. A small Geman-McClure gate ignores phantom volumes, whose surface is far from the
body (unlike their interior, which is not used).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from capture_rig.kernel import kernel, njit
from capture_rig.small_matrices import robust_weight

from .. import kernels
from .normal_equations import CHAIN_COLUMNS, ENDS, add_pose_sums, add_to_sums, no_sums
from .posed_model import STICKS, columns


class PointMatch(NamedTuple):
    """Each point's stick (n,), the place along it (n,) from 0 to 1, foot (n, 3) m, squared distance (n,) m^2, robust
    weight (n,) 1/m^2, and whether it counts as an inlier (n,)."""

    stick: np.ndarray
    along: np.ndarray
    feet: np.ndarray
    squared: np.ndarray
    weight: np.ndarray
    inlier: np.ndarray


@njit(cache=True)
def match_points(data, posed):
    """Find each point's stick, its foot there, and its weight."""
    n = data.points.shape[0]
    match = PointMatch(
        np.empty(n, np.int64), np.empty(n), np.empty((n, 3)), np.empty(n), np.empty(n), np.empty(n, np.bool_)
    )
    foot_points(data.points, posed.A, posed.B, match.stick, match.along, match.feet, match.squared)
    robust_weights(data, match)
    return match


@njit(cache=True, error_model="numpy")
def robust_weights(data, match):
    """Fill in the Geman-McClure weights, 1/m^2, and the inliers of a match."""
    for i in range(match.squared.shape[0]):
        match.weight[i] = robust_weight(data.information[i], match.squared[i] / data.gate2[i])
        match.inlier[i] = match.squared[i] <= data.gate2[i]


@kernel
def summarise(match, counts):
    """Count the inliers of each stick into ``counts`` (10,); returns the sum of their squared distances, m^2."""
    total = 0.0
    counts[:] = 0
    for i in range(match.stick.shape[0]):
        if match.inlier[i]:
            counts[match.stick[i]] += 1
            total += match.squared[i]
    return total


# --- residuals and their derivatives


@njit(cache=True)
def add_point_residuals(points, match, posed, H, g):
    """Add sum w J^T J to upper H and sum w J^T r to g, r = point - foot.

    A foot at ``along`` = u has the Jacobian (1-u) J_A + u J_B of its stick's two ends, so that a stick's points enter
    through a handful of sums.
    """
    squares = np.zeros((STICKS, 5))
    pulls = np.zeros((STICKS, 2, 3))
    sum_over_sticks(points, match, squares, pulls)
    A, B = posed.A, posed.B
    J_A, J_B = np.empty((3, CHAIN_COLUMNS)), np.empty((3, CHAIN_COLUMNS))
    slots = np.empty(CHAIN_COLUMNS, np.int64)
    for j in range(STICKS):
        inside_aa, inside_ab, inside_bb, at_start, at_end = squares[j]
        if inside_aa + inside_bb + at_start + at_end == 0.0:
            continue
        kernels.point_jacobian(j, A[j], posed.t0, A, posed.axes, J_A, slots)
        n = kernels.point_jacobian(j, B[j], posed.t0, A, posed.axes, J_B, slots)
        for m in range(n):
            for k in range(3):
                g[slots[m]] += J_A[k, m] * pulls[j, 0, k] + J_B[k, m] * pulls[j, 1, k]
        add_products(J_A, J_A, slots, n, at_start, H)
        add_products(J_B, J_B, slots, n, at_end, H)
        remove_direction(J_A, n, A[j], B[j])
        remove_direction(J_B, n, A[j], B[j])
        add_products(J_A, J_A, slots, n, inside_aa, H)
        add_products(J_A, J_B, slots, n, inside_ab, H)
        add_products(J_B, J_A, slots, n, inside_ab, H)
        add_products(J_B, J_B, slots, n, inside_bb, H)


@kernel
def sum_over_sticks(points, match, squares, pulls):
    """Sum over each stick's points: squares (10, 5) = w (1-u)^2, w u (1-u), w u^2 of the feet inside the stick, w of
    those clamped to its start, to its end; pulls (10, 2, 3) = w (1-u) r, w u r."""
    for i in range(points.shape[0]):
        j, u, w = match.stick[i], match.along[i], match.weight[i]
        if w <= 0.0:
            continue
        if u <= 0.0:
            squares[j, 3] += w
        elif u >= 1.0:
            squares[j, 4] += w
        else:
            squares[j, 0] += w * (1.0 - u) * (1.0 - u)
            squares[j, 1] += w * u * (1.0 - u)
            squares[j, 2] += w * u * u
        for k in range(3):
            pull = w * (points[i, k] - match.feet[i, k])
            pulls[j, 0, k] += (1.0 - u) * pull
            pulls[j, 1, k] += u * pull


@kernel
def remove_direction(J, n, start, end):
    """Project the columns of J (3, n) onto the plane across the stick from ``start`` to ``end``: the foot slides."""
    d0, d1, d2 = end[0] - start[0], end[1] - start[1], end[2] - start[2]
    length2 = d0 * d0 + d1 * d1 + d2 * d2
    for m in range(n):
        s = (J[0, m] * d0 + J[1, m] * d1 + J[2, m] * d2) / length2
        J[0, m] -= s * d0
        J[1, m] -= s * d1
        J[2, m] -= s * d2


@kernel
def add_products(J, K, slots, n, w, H):
    """Add half of w J^T K (the pairs m <= q) to upper H: J^T J whole, or J^T K with K^T J added next."""
    if w == 0.0:
        return
    for m in range(n):
        for q in range(m, n):
            row, column = min(slots[m], slots[q]), max(slots[m], slots[q])
            H[row, column] += w * (J[0, m] * K[0, q] + J[1, m] * K[1, q] + J[2, m] * K[2, q])


# --- foot points


@njit(cache=True)
def foot_points(points, A, B, stick, along, feet, squared):
    """Project ``points`` (n, 3) onto all sticks from ``A`` to ``B`` (10, 3) and keep the nearest projection.

    Writes ``stick`` (n,) int, ``along`` (n,) in [0, 1] from A to B (clamped), ``feet`` (n, 3) and ``squared`` (n,),
    the squared distance; all in the frame and unit of the points.
    """
    stick[:] = 0
    along[:] = 0.0
    squared[:] = np.inf
    x, y, z = columns(points)
    for j in range(STICKS):
        prefer_stick(j, x, y, z, A[j], B[j], stick, along, squared)
    place_feet(A, B, stick, along, feet)


@kernel
def prefer_stick(j, x, y, z, start, end, stick, along, squared):
    """Move to stick ``j`` every point that is nearer to it than ``squared``; branch-free, so it is vectorised."""
    a0, a1, a2 = start[0], start[1], start[2]
    d0, d1, d2 = end[0] - a0, end[1] - a1, end[2] - a2
    length2 = d0 * d0 + d1 * d1 + d2 * d2
    inverse = 1.0 / length2 if length2 > 0.0 else 0.0
    for i in range(x.shape[0]):
        p, q, r = x[i] - a0, y[i] - a1, z[i] - a2
        u = (p * d0 + q * d1 + r * d2) * inverse
        u = u if u > 0.0 else 0.0
        u = u if u < 1.0 else 1.0
        p -= u * d0
        q -= u * d1
        r -= u * d2
        distance2 = p * p + q * q + r * r
        nearer = distance2 < squared[i]
        squared[i] = distance2 if nearer else squared[i]
        along[i] = u if nearer else along[i]
        stick[i] = j if nearer else stick[i]


@kernel
def place_feet(A, B, stick, along, feet):
    """Fill ``feet`` (n, 3) with the points at ``along`` of their sticks."""
    for i in range(stick.shape[0]):
        j, u = stick[i], along[i]
        for k in range(3):
            feet[i, k] = A[j, k] + u * (B[j, k] - A[j, k])


@njit(cache=True)
def add_surface(voxels, nearest, posed, information, gate, H, g):
    """Add the distances of surface voxels (m, 3) m from the body's surface to upper H and g, Geman-McClure.

    ``nearest`` : their capsules, as of `surface_distances`. information : 1/m^2 of each; gate : m.
    """
    sums = no_sums(posed.P.shape[0], ENDS)
    _sum_voxels(voxels, nearest, posed, information, gate, sums)
    add_pose_sums(sums, posed, H, g)


@njit(cache=True, error_model="numpy")
def _sum_voxels(voxels, nearest, posed, information, gate, sums):
    """Add the voxels' distances to the sums of their nearest capsules."""
    capsule, along, distance = nearest
    normals, weight = np.empty((3, voxels.shape[0])), np.empty(voxels.shape[0])
    for i in range(voxels.shape[0]):
        c, u = capsule[i], along[i]
        for q in range(3):
            normals[q, i] = voxels[i, q] - (posed.P[c, q] + u * (posed.Q[c, q] - posed.P[c, q]))
    _weigh_voxels(distance, information, gate, normals, weight)
    add_to_sums(sums, capsule, along, normals, weight, distance)


@kernel
def _weigh_voxels(distance, information, gate, normals, weight):
    """normals (3, n) <- unit length; weight (n,) <- Geman-McClure, 0 on a capsule's axis, which has no normal."""
    for i in range(weight.shape[0]):
        x, y, z, e = normals[0, i], normals[1, i], normals[2, i], distance[i]
        length = np.sqrt(x * x + y * y + z * z)
        weight[i] = robust_weight(information, e * e / (gate * gate)) if length > 0.0 else 0.0
        length = length if length > 0.0 else 1.0
        normals[0, i], normals[1, i], normals[2, i] = x / length, y / length, z / length
