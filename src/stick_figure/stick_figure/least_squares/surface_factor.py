"""The hull's voxels in the all-joints solve, and the room that arms and torso need.

The centerline cannot see which way a torso faces, nor an arm that hangs against it: there the slices of trunk and arm
merge. The hull's surface can: every voxel of it should lie on the figure's flesh. A small Geman-McClure gate ignores
phantom volumes, whose surface is far from any flesh (their interior would not be: it stays out). And arms do not go
through the torso.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from stick_figure import kernels
from stick_figure.body_surface import TORSO_CAPSULES

from .point_factor import CHAIN_COLUMNS, STICKS

FIRST_JOINT_SLOT = 6
LINE = 6  # coordinates of a line in space
# where along upper arms and forearms the torso's surface is looked for
ARM_SAMPLES = np.array(
    [(j, u) for j, us in ((2, (0.5, 0.75, 1.0)), (6, (0.3, 0.6, 0.85))) for u in us]
    + [(j, u) for j, us in ((3, (0.5, 0.75, 1.0)), (7, (0.3, 0.6, 0.85))) for u in us]
)
CLEARANCE_M = 0.02  # the sticks of an arm stay this far outside the torso's flesh


@njit(cache=True)
def add_voxel_residuals(voxels, capsules, P, Q, match, information, gate, t0, A, axes, H, g):
    """Add every voxel's distance to the flesh, weight 1/m^2 ``information`` times Geman-McClure, to upper H and g.

    ``match`` = capsule, along, distance of :func:`flesh.nearest_capsule`. The derivative of a distance with respect to
    any joint is linear in the surface normal's line (n, c x n), so a stick's voxels enter through 6x6 sums.
    """
    squares, pulls = np.zeros((STICKS, LINE, LINE)), np.zeros((STICKS, LINE))
    sum_lines(voxels, capsules, P, Q, match, information, gate, squares, pulls)
    spread_lines(squares, pulls, t0, A, axes, H, g)


@njit(cache=True)
def spread_lines(squares, pulls, t0, A, axes, H, g):
    """Add each stick's sums over lines, squares (10, 6, 6) and pulls (10, 6), to upper H and g of what moves it."""
    twists, slots = np.empty((CHAIN_COLUMNS, LINE)), np.empty(CHAIN_COLUMNS, np.int64)
    half = np.empty(LINE)
    for j in range(STICKS):
        n = stick_twists(j, t0, A, axes, twists, slots)
        for m in range(n):
            for q in range(LINE):
                half[q] = 0.0
                for k in range(LINE):
                    half[q] += twists[m, k] * squares[j, k, q]
                g[slots[m]] += twists[m, q] * pulls[j, q]
            for p in range(m, n):
                first, last = min(slots[m], slots[p]), max(slots[m], slots[p])
                for q in range(LINE):
                    H[first, last] += half[q] * twists[p, q]


@njit(cache=True)
def sum_lines(voxels, capsules, P, Q, match, information, gate, squares, pulls):
    """Sums over each stick's voxels: squares (10, 6, 6) = w l l^T, pulls (10, 6) = w e l, with the line l = (n, c x n)
    of the surface normal n through the capsule's axis point c, and e the distance to the surface."""
    capsule, along, distance = match
    line = np.empty(LINE)
    for i in range(voxels.shape[0]):
        e, k, u = distance[i], capsule[i], along[i]
        c0 = P[k, 0] + u * (Q[k, 0] - P[k, 0])
        c1 = P[k, 1] + u * (Q[k, 1] - P[k, 1])
        c2 = P[k, 2] + u * (Q[k, 2] - P[k, 2])
        n0, n1, n2 = voxels[i, 0] - c0, voxels[i, 1] - c1, voxels[i, 2] - c2
        length = np.sqrt(n0 * n0 + n1 * n1 + n2 * n2)
        if length == 0.0:
            continue
        line[0], line[1], line[2] = n0 / length, n1 / length, n2 / length
        line[3] = c1 * line[2] - c2 * line[1]
        line[4] = c2 * line[0] - c0 * line[2]
        line[5] = c0 * line[1] - c1 * line[0]
        ratio = 1.0 + e * e / (gate * gate)
        weight, j = information / (ratio * ratio), capsules.stick[k]
        for p in range(LINE):
            a = weight * line[p]
            pulls[j, p] += a * e
            for q in range(LINE):
                squares[j, p, q] += a * line[q]


@njit(cache=True)
def stick_twists(j, t0, A, axes, twists, slots):
    """The motions (n, 6) that move stick j, as (o x a, a) for a turn about axis a through o and (e, 0) for a shift:
    the line (n, c x n) is shortened by their scalar product with it. Returns n; ``slots`` (n,) their tangent slots."""
    for i in range(3):
        slots[i], slots[3 + i] = i, 3 + i
        twists[i, :] = 0.0
        twists[i, i] = 1.0
        twists[3 + i, :] = 0.0
        twists[3 + i, 3 + i] = 1.0
    twists[3, 1], twists[3, 2] = t0[2], -t0[1]  # t0 x e
    twists[4, 0], twists[4, 2] = -t0[2], t0[0]
    twists[5, 0], twists[5, 1] = t0[1], -t0[0]
    n = FIRST_JOINT_SLOT
    for m in range(kernels.CHAIN.shape[1]):
        slot = kernels.CHAIN[j, m]
        if slot < 0:
            break
        o, a = A[kernels.PIVOT_STICK[slot]], axes[slot - FIRST_JOINT_SLOT]
        twists[n, 0] = o[1] * a[2] - o[2] * a[1]
        twists[n, 1] = o[2] * a[0] - o[0] * a[2]
        twists[n, 2] = o[0] * a[1] - o[1] * a[0]
        twists[n, 3], twists[n, 4], twists[n, 5] = a[0], a[1], a[2]
        slots[n] = slot
        n += 1
    return n


@njit(cache=True)
def add_arm_clearance(P, Q, radii, information, A, B, t0, axes, H, g):
    """Push arms out of the torso's flesh, weight 1/m^2. Both move with the torso, so only the joints can do it."""
    J, row = np.empty((3, CHAIN_COLUMNS)), np.empty(CHAIN_COLUMNS)
    slots = np.empty(CHAIN_COLUMNS, np.int64)
    point, normal = np.empty(3), np.empty(3)
    for s in range(ARM_SAMPLES.shape[0]):
        j, u = int(ARM_SAMPLES[s, 0]), ARM_SAMPLES[s, 1]
        for q in range(3):
            point[q] = A[j, q] + u * (B[j, q] - A[j, q])
        depth = CLEARANCE_M - torso_distance(point, P, Q, radii, normal)
        if depth <= 0.0:
            continue
        n = kernels.point_jacobian(j, point, t0, A, axes, J, slots)
        project(J, n, normal, row)
        row[:FIRST_JOINT_SLOT] = 0.0
        add_scalar_residual(row, slots, n, depth, information, H, g)


@njit(cache=True)
def torso_distance(point, P, Q, radii, normal):
    """Signed distance (m) of a point to the torso's flesh, and the unit ``normal`` (3,) of that surface there."""
    best = np.inf
    for k in range(TORSO_CAPSULES):
        along, length2 = 0.0, 0.0
        for q in range(3):
            along += (point[q] - P[k, q]) * (Q[k, q] - P[k, q])
            length2 += (Q[k, q] - P[k, q]) ** 2
        u = min(max(along / length2, 0.0), 1.0)
        d0 = point[0] - P[k, 0] - u * (Q[k, 0] - P[k, 0])
        d1 = point[1] - P[k, 1] - u * (Q[k, 1] - P[k, 1])
        d2 = point[2] - P[k, 2] - u * (Q[k, 2] - P[k, 2])
        length = np.sqrt(d0 * d0 + d1 * d1 + d2 * d2)
        distance = length - radii[k, 0] - u * (radii[k, 1] - radii[k, 0])
        if distance < best and length > 0.0:
            best = distance
            normal[0], normal[1], normal[2] = d0 / length, d1 / length, d2 / length
    return best


@njit(cache=True)
def project(J, n, normal, row):
    """row (n,) = normal^T J, the derivative of a distance along ``normal``."""
    for m in range(n):
        row[m] = J[0, m] * normal[0] + J[1, m] * normal[1] + J[2, m] * normal[2]


@njit(cache=True)
def add_scalar_residual(row, slots, n, residual, weight, H, g):
    """One scalar residual with sparse derivative ``row`` (n,) at ``slots``, into upper H and g."""
    for m in range(n):
        a = weight * row[m]
        g[slots[m]] += a * residual
        for q in range(m, n):
            first, last = min(slots[m], slots[q]), max(slots[m], slots[q])
            H[first, last] += a * row[q]


# --- Sticks belong inside the hull: a visual hull holds all of the body, whatever it adds to it.
#
# Points along head and limbs that lie farther from every voxel than the samples' spacing are pulled to the nearest one.
# Unlike the hull's surface, this holds for the fat hull of few cameras as well as for a tight one.

SAMPLES = 3  # points along each stick, the last one at its end


@njit(cache=True)
def add_inside_residuals(voxels, slack, information, gate, A, B, t0, axes, H, g):
    """Add the distances beyond ``slack`` (m) of points on sticks 1 to 9 from the voxels (m, 3) to upper H and g.

    Weight 1/m^2 ``information`` times Geman-McClure of width ``gate`` (m). ``voxels`` sample the hull's inside too.
    """
    J, row = np.empty((3, CHAIN_COLUMNS)), np.empty(CHAIN_COLUMNS)
    slots = np.empty(CHAIN_COLUMNS, np.int64)
    point, normal = np.empty(3), np.empty(3)
    for j in range(1, A.shape[0]):
        for s in range(SAMPLES):
            u = (s + 1.0) / SAMPLES
            for q in range(3):
                point[q] = A[j, q] + u * (B[j, q] - A[j, q])
            nearest, distance = nearest_voxel(voxels, point, slack)
            outside = distance - slack
            if outside <= 0.0:
                continue
            for q in range(3):
                normal[q] = (voxels[nearest, q] - point[q]) / distance
            ratio = 1.0 + outside * outside / (gate * gate)
            n = kernels.point_jacobian(j, point, t0, A, axes, J, slots)
            project(J, n, normal, row)
            add_scalar_residual(row, slots, n, outside, information / (ratio * ratio), H, g)


@njit(cache=True)
def nearest_voxel(voxels, point, near_enough):
    """Index of the voxel (m, 3) nearest to a point and its distance (m); or the first one that is ``near_enough``."""
    best, at = np.inf, 0
    for i in range(voxels.shape[0]):
        x, y, z = voxels[i, 0] - point[0], voxels[i, 1] - point[1], voxels[i, 2] - point[2]
        squared = x * x + y * y + z * z
        if squared < best:
            best, at = squared, i
            if squared <= near_enough * near_enough:
                break
    return at, np.sqrt(best)
