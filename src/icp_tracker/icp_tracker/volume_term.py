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

from .flesh import TORSO_CAPSULES
from .normal_equations import CHAIN_COLUMNS

FIRST_JOINT_SLOT = 6
# where along upper arms and forearms the torso's surface is looked for
ARM_SAMPLES = np.array([(j, u) for j, us in ((2, (0.5, 0.75, 1.0)), (6, (0.3, 0.6, 0.85))) for u in us]
                       + [(j, u) for j, us in ((3, (0.5, 0.75, 1.0)), (7, (0.3, 0.6, 0.85))) for u in us])  # fmt: skip
CLEARANCE_M = 0.02  # the sticks of an arm stay this far outside the torso's flesh


@njit(cache=True)
def add_voxel_residuals(voxels, flesh, P, Q, match, information, gate, t0, A, axes, H, g):
    """Add every voxel's distance to the flesh, weight 1/m^2 ``information`` times Geman-McClure, to upper H and g.

    ``match`` = capsule, along, distance of :func:`flesh.nearest_flesh`.
    """
    capsule, along, distance = match
    J, row = np.empty((3, CHAIN_COLUMNS)), np.empty(CHAIN_COLUMNS)
    slots = np.empty(CHAIN_COLUMNS, np.int64)
    foot, normal = np.empty(3), np.empty(3)
    for i in range(voxels.shape[0]):
        e, k, length2 = distance[i], capsule[i], 0.0
        for q in range(3):
            foot[q] = P[k, q] + along[i] * (Q[k, q] - P[k, q])
            normal[q] = voxels[i, q] - foot[q]
            length2 += normal[q] * normal[q]
        if length2 == 0.0:
            continue
        for q in range(3):
            normal[q] /= np.sqrt(length2)
        ratio = 1.0 + e * e / (gate * gate)
        n = kernels.point_jacobian(flesh.stick[k], foot, t0, A, axes, J, slots)
        project(J, n, normal, row)
        add_scalar_residual(row, slots, n, e, information / (ratio * ratio), H, g)


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
