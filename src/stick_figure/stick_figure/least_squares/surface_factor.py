"""The hull's surface against the body's: every surface voxel should lie on it.

The centerline cannot see which way a torso faces, nor an arm that hangs against it: there the slices of trunk and arm
merge. The hull's surface can. A small Geman-McClure gate ignores phantom volumes, whose surface is far from the body
(their interior would not be: it stays out).
"""

from __future__ import annotations

import numpy as np

from capture_rig.kernel import kernel, njit

from .normal_equations import ENDS, add_pose_sums, add_to_sums, no_sums


@njit(cache=True)
def add_surface(voxels, nearest, placed, information, gate, H, g):
    """Add the distances of surface voxels (m, 3) m from the body's surface to upper H and g, Geman-McClure.

    ``nearest`` : their capsules, as of `surface_distances`. information : 1/m^2 of each; gate : m.
    """
    sums = no_sums(placed.P.shape[0], ENDS)
    _sum_voxels(voxels, nearest, placed, information, gate, sums)
    add_pose_sums(sums, placed, H, g)


@njit(cache=True, error_model="numpy")
def _sum_voxels(voxels, nearest, placed, information, gate, sums):
    """Add the voxels' distances to the sums of their nearest capsules."""
    capsule, along, distance = nearest
    normals, weight = np.empty((3, voxels.shape[0])), np.empty(voxels.shape[0])
    for i in range(voxels.shape[0]):
        c, u = capsule[i], along[i]
        for q in range(3):
            normals[q, i] = voxels[i, q] - (placed.P[c, q] + u * (placed.Q[c, q] - placed.P[c, q]))
    _weigh_voxels(distance, information, gate, normals, weight)
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
