"""Effective (cluster-robust) information of a fit's rows about the pose, as neighbours' errors are correlated.

A thousand contour rays touch a body, and their residuals are no thousand independent numbers: where the model's surface
or a silhouette is wrong at one place of a limb, it is wrong for every ray that touches there, from whatever camera and
in every set. So the body's surface is divided into cells, half of a capsule's length times one of six directions, and
all rays of a cell count as one datum. Its variance is estimated for each stick from the rays themselves (the reduced
chi-square of the method of least squares), pulled towards that of a surface that fits well:

    s^2 = (nu s0^2 + sum over the stick's cells of the mean squared residual) / (nu + cells)

with no residual beyond the robust gate, so that outlines that nothing explains count too. Cells are correlated in turn:
a limb whose model is misplaced or too thin errs in all of them, and three cells are one independent datum. A rig that
looks from two sides fills the cells of these two sides alone, and leaves the direction between them as uncertain as it
is. Centerline points share the width of the hull: those of half a stick are one datum.

For rows correlated in groups: Liang & Zeger, Biometrika 73 (1986); here the correlation within a group is taken as one.
"""

from __future__ import annotations

import numpy as np

from capture_rig.kernel import njit
from capture_rig.small_matrices import robust_weight

from .contour_factor import NORMAL, SURFACE_GATE_M
from .normal_equations import ENDS, add_pose_sums, add_to_sums, no_sums
from .point_factor import add_point_residuals
from .posed_model import STICKS

# Thresholds: chosen so that 95 % ellipsoids hold the true points of rendered people in 95 % of all sets (`inside_95` of
# python bench/people.py).
DIRECTIONS, HALVES = 6, 2
CELLS = DIRECTIONS * HALVES  # of a capsule, or of the trunk
CELLS_OF_A_DATUM = 3.0
SURFACE_SD_M = 0.01  # of the body's surface about the model's, in one cell, where it fits well
PRIOR_CELLS = 4.0  # weight of SURFACE_SD_M in measured cells; a limb shows 4 to 12


@njit(cache=True, nogil=True)
def add_effective_information(data, posed, rays_match, points_match, H):
    """Add to upper H the effective information of rays and points, matched as given."""
    g = np.empty(H.shape[0])
    _add_cells(data.contour_rays, rays_match, posed, H, g)
    _add_stick_halves(data, posed, points_match, H, g)


@njit(cache=True)
def _add_cells(rays, match, posed, H, g):
    n, capsules = rays.information.shape[0], posed.P.shape[0]
    cell, weight = np.empty(n, np.int64), np.empty(n)
    total, count, squares = np.zeros(capsules * CELLS), np.zeros(capsules * CELLS), np.zeros(capsules * CELLS)
    for i in range(n):
        c = cell_of_ray(posed, match.capsule[i], match.along[i], rays.rows, i)
        cell[i], weight[i] = c, robust_weight(1.0, (match.separation[i] / SURFACE_GATE_M) ** 2)
        total[c] += weight[i]
        count[c] += 1.0
        squares[c] += min(match.separation[i], SURFACE_GATE_M) ** 2
    information = _information_of_a_datum(count, squares, posed.surface.stick)
    for i in range(n):
        share = weight[i] / max(total[cell[i]], 1.0)
        weight[i] = share * information[posed.surface.stick[match.capsule[i]]]
    sums = no_sums(capsules, ENDS)
    add_to_sums(sums, match.capsule, match.along, rays.rows[NORMAL : NORMAL + 3], weight, match.distance)
    add_pose_sums(sums, posed, H, g)


@njit(cache=True)
def _information_of_a_datum(count, squares, stick_of_capsule):
    """Return the information (10,) 1/m^2 of a cell of each stick, from each cell's ray count and squared residuals."""
    squared, cells = np.full(STICKS, PRIOR_CELLS * SURFACE_SD_M**2), np.full(STICKS, PRIOR_CELLS)
    for c in range(count.shape[0]):
        if count[c] > 0.0:
            squared[stick_of_capsule[c // CELLS]] += squares[c] / count[c]
            cells[stick_of_capsule[c // CELLS]] += 1.0
    return cells / squared / CELLS_OF_A_DATUM


@njit(cache=True)
def cell_of_ray(posed, k, along, rows, i):
    """Return the cell in which ray i touches capsule k; all capsules of the trunk share theirs."""
    if posed.surface.stick[k] > 0:
        part, far = k, along > 0.5
    else:
        height = 0.0
        for axis in range(3):
            at = posed.P[k, axis] + along * (posed.Q[k, axis] - posed.P[k, axis])
            height += posed.R0[axis, 2] * (at - posed.t0[axis])
        part, far = 0, height > 0.0
    return (part * HALVES + (1 if far else 0)) * DIRECTIONS + _direction(posed, k, rows, i)


@njit(cache=True)
def _direction(posed, k, rows, i):
    """Return the axis of its capsule's stick that the normal of ray i is nearest to: 0 to 2, opposite 3 to 5."""
    G, nearest, largest = posed.G[posed.surface.stick[k]], 0, 0.0
    for axis in range(3):
        along = G[0, axis] * rows[0, i] + G[1, axis] * rows[1, i] + G[2, axis] * rows[2, i]
        if abs(along) > largest:
            largest = abs(along)
            nearest = axis if along > 0.0 else axis + 3
    return nearest


@njit(cache=True)
def _add_stick_halves(data, posed, match, H, g):
    """Add the points of each half of a stick as one datum of their mean information."""
    total, whole = np.zeros((STICKS, 2)), match.weight.copy()
    for i in range(whole.shape[0]):
        total[match.stick[i], 1 if match.along[i] > 0.5 else 0] += whole[i] / data.information[i]
    for i in range(whole.shape[0]):
        match.weight[i] = whole[i] / max(total[match.stick[i], 1 if match.along[i] > 0.5 else 0], 1.0)
    add_point_residuals(data.points, match, posed, H, g)
    match.weight[:] = whole
