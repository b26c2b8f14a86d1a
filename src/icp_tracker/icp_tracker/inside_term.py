"""Sticks belong inside the hull: a visual hull holds all of the body, whatever it adds to it.

Points along head and limbs that lie farther from every voxel than the samples' spacing are pulled to the nearest one.
Unlike the hull's surface, this holds for the fat hull of few cameras as well as for a tight one.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from stick_figure import kernels

from .normal_equations import CHAIN_COLUMNS
from .volume_term import add_scalar_residual, project

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
