"""The hull's voxels against the body: its surface on the body's, the sticks inside it, arms outside the torso.

The centerline cannot see which way a torso faces, nor an arm that hangs against it: there the slices of trunk and arm
merge. The hull's surface can: every voxel of it should lie on the body's. A small Geman-McClure gate ignores phantom
volumes, whose surface is far from the body (their interior would not be: it stays out). And whatever a visual hull adds
to the body, it holds all of it: points of head and limbs that lie farther from every voxel than the samples' spacing
are pulled to the nearest one. Unlike the surface, this holds for the wide hull of few cameras as well.
"""

from __future__ import annotations

import numpy as np

from capture_rig.kernel import kernel, njit

from .. import kernels
from ..body_surface import TORSO_CAPSULES
from .hull_samples import nearest_sample
from .normal_equations import CHAIN_COLUMNS, ENDS, add_pose_sums, add_scalar_residual, add_to_sums, no_sums
from .placed_figure import STICKS, surface_distances

FIRST_JOINT_SLOT = 6
# Thresholds: measured by python bench/people.py --ablation SESSION.
SAMPLES = 3  # points along each stick that belong inside the hull, the last one at its end
# where along upper arms and forearms the torso's surface is looked for
ARM_SAMPLES = np.array(
    [(j, u) for j, us in ((2, (0.5, 0.75, 1.0)), (6, (0.3, 0.6, 0.85))) for u in us]
    + [(j, u) for j, us in ((3, (0.5, 0.75, 1.0)), (7, (0.3, 0.6, 0.85))) for u in us]
)
CLEARANCE_M = 0.02  # the sticks of an arm stay this far outside the torso's surface


@njit(cache=True)
def add_surface(data, placed, weights, H, g):
    """Add the distances of the hull's surface voxels from the body's surface to upper H and g, Geman-McClure."""
    if weights.voxel != 0.0:
        add_nearest(data.voxels, surface_distances(data.voxels, placed), placed, weights, H, g)


@njit(cache=True)
def add_nearest(voxels, nearest, placed, weights, H, g):
    """Add the distances of voxels from their nearest capsules; ``nearest`` as of `surface_distances`."""
    sums = no_sums(placed.P.shape[0], ENDS)
    _sum_voxels(voxels, nearest, placed, weights, sums)
    add_pose_sums(sums, placed, H, g)


@njit(cache=True, error_model="numpy")
def _sum_voxels(voxels, nearest, placed, weights, sums):
    """Add the voxels' distances to the sums of their nearest capsules."""
    capsule, along, distance = nearest
    normals, weight = np.empty((3, voxels.shape[0])), np.empty(voxels.shape[0])
    for i in range(voxels.shape[0]):
        c, u = capsule[i], along[i]
        for q in range(3):
            normals[q, i] = voxels[i, q] - (placed.P[c, q] + u * (placed.Q[c, q] - placed.P[c, q]))
    _weigh_voxels(distance, weights.voxel, weights.voxel_gate, normals, weight)
    add_to_sums(sums, capsule, along, normals, weight, distance)


@kernel
def _weigh_voxels(distance, information, gate, normals, weight):
    """normals (3, n) <- of unit length; weight (n,) <- Geman-McClure, 0 on a capsule's axis, where there is none."""
    for i in range(weight.shape[0]):
        x, y, z, e = normals[0, i], normals[1, i], normals[2, i], distance[i]
        length, ratio = np.sqrt(x * x + y * y + z * z), 1.0 + e * e / (gate * gate)
        weight[i] = information / (ratio * ratio) if length > 0.0 else 0.0
        length = length if length > 0.0 else 1.0
        normals[0, i], normals[1, i], normals[2, i] = x / length, y / length, z / length


@njit(cache=True)
def add_inside(data, placed, weights, H, g):
    """Add the distances beyond the slack of points on sticks 1 to 9 from the hull's voxels, Geman-McClure."""
    if weights.inside == 0.0:
        return
    J, row = np.empty((3, CHAIN_COLUMNS)), np.empty(CHAIN_COLUMNS)
    slots = np.empty(CHAIN_COLUMNS, np.int64)
    point, normal = np.empty(3), np.empty(3)
    for j in range(1, STICKS):
        for s in range(SAMPLES):
            point_on_stick(placed, j, (s + 1.0) / SAMPLES, point)
            nearest, distance = nearest_sample(data.hull, point, weights.inside_slack)
            outside = distance - weights.inside_slack
            if outside <= 0.0:
                continue
            for q in range(3):
                normal[q] = (data.hull.points[nearest, q] - point[q]) / distance
            ratio = 1.0 + outside * outside / (weights.inside_gate * weights.inside_gate)
            n = kernels.point_jacobian(j, point, placed.t0, placed.A, placed.axes, J, slots)
            project(J, n, normal, row)
            add_scalar_residual(row, slots, n, outside, weights.inside / (ratio * ratio), H, g)


@njit(cache=True)
def add_arm_clearance(placed, weights, H, g):
    """Add the depths of arms in the torso. Both move with the torso, so only the joints can mend them."""
    if weights.clearance == 0.0:
        return
    J, row = np.empty((3, CHAIN_COLUMNS)), np.empty(CHAIN_COLUMNS)
    slots = np.empty(CHAIN_COLUMNS, np.int64)
    point, normal = np.empty(3), np.empty(3)
    for s in range(ARM_SAMPLES.shape[0]):
        j = int(ARM_SAMPLES[s, 0])
        point_on_stick(placed, j, ARM_SAMPLES[s, 1], point)
        depth = CLEARANCE_M - torso_distance(point, placed, normal)
        if depth <= 0.0:
            continue
        n = kernels.point_jacobian(j, point, placed.t0, placed.A, placed.axes, J, slots)
        project(J, n, normal, row)
        row[:FIRST_JOINT_SLOT] = 0.0
        add_scalar_residual(row, slots, n, depth, weights.clearance, H, g)


@kernel
def point_on_stick(placed, j, u, point):
    """Fill ``point`` (3,) with the place ``u``, 0 to 1, along stick j."""
    for q in range(3):
        point[q] = placed.A[j, q] + u * (placed.B[j, q] - placed.A[j, q])


@kernel
def torso_distance(point, placed, normal):
    """Return the signed distance (m) of a point from the torso's surface, and its unit ``normal`` (3,) there."""
    P, Q, radii = placed.P, placed.Q, placed.surface.radii
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


@kernel
def project(J, n, normal, row):
    """Fill ``row`` (n,) with normal^T J, the derivative of a distance along ``normal``."""
    for m in range(n):
        row[m] = J[0, m] * normal[0] + J[1, m] * normal[1] + J[2, m] * normal[2]
