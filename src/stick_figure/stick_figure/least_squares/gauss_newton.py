"""The compiled core of the all-joints solve: one robust Gauss-Newton over everything that speaks about the pose."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit

from capture_rig.small_matrices import solve_positive
from stick_figure import kernels
from stick_figure.body_surface import nearest_capsule, place_capsules

from ..joint_limits import add_joint_limits, add_neck_rest
from .contour_factor import add_contour_residuals, contour_weights, match_contour_rays
from .point_factor import (
    STICKS,
    TANGENT,
    add_point_residuals,
    columns,
    foot_points,
    mirror_upper,
    point_covariances,
    x84_keep,
)
from .surface_factor import add_arm_clearance, add_inside_residuals, add_voxel_residuals

GEMAN_MCCLURE, X84 = 0, 1


class ContourArrays(NamedTuple):
    """Rays along the silhouettes' rims, as :class:`rim_rays.ContourRays` but a column (3, r) each: points, directions,
    normals, and tangents = normals x directions along the rim; half_lengths (r,) m and information (r,) 1/m^2."""

    points: np.ndarray
    directions: np.ndarray
    normals: np.ndarray
    tangents: np.ndarray
    half_lengths: np.ndarray
    information: np.ndarray


class Data(NamedTuple):
    """What was measured: centerline points (n, 3) m with information (n,) 1/m^2 and
    squared gate (n,) m^2; voxels (m, 3) m of the hull's surface,
    samples (k, 3) m of the whole hull, and rims."""

    points: np.ndarray
    information: np.ndarray
    gate2: np.ndarray
    voxels: np.ndarray
    hull: np.ndarray
    contour_rays: ContourArrays


class Weights(NamedTuple):
    """How much each part counts: information in 1/m^2 or 1/rad^2 (zero switches it off), gates and floors in m."""

    prior: np.ndarray
    robust: int
    floor: float
    voxel: float
    voxel_gate: float
    contour_gate: float
    contour_slack: float
    clearance: float
    inside: float
    inside_slack: float
    inside_gate: float
    neck: float
    neck_pitch: float
    limit: float


class Stop(NamedTuple):
    """When to stop: iterations at most, converged when no reference point moves farther than ``tolerance`` (m) in one;
    largest step allowed (m, rad)."""

    iterations: int
    tolerance: float
    step_limit: float


@njit(cache=True)
def gauss_newton(data, t0, R0, RJ, hinges, figure, capsules, weights, stop):
    """Minimise in place over the state t0, R0, RJ, hinges.

    Returns the iterations, and how far (m) the last one moved any of the 15 reference points. (Not the step itself: the
    twist of a straight limb may wander without moving anything.)
    """
    start = (t0.copy(), R0.copy(), RJ.copy(), hinges.copy())
    H, g = np.empty((TANGENT, TANGENT)), np.empty(TANGENT)
    L, step, back = np.empty((TANGENT, TANGENT)), np.empty(TANGENT), np.empty(TANGENT)
    distances, counts = np.empty(data.points.shape[0]), np.zeros(STICKS, np.int64)
    before, after = np.empty((15, 3)), np.empty((15, 3))
    place_points(t0, R0, RJ, hinges, figure, after)
    moved = np.inf
    for iteration in range(stop.iterations):
        measure(data, t0, R0, RJ, hinges, figure, capsules, weights, H, g, distances, counts)
        kernels.difference(start[0], start[1], start[2], start[3], t0, R0, RJ, hinges, back)
        for k in range(TANGENT):
            H[k, k] += weights.prior[k]
            g[k] += weights.prior[k] * back[k]
        if weights.neck > 0.0:
            add_neck_rest(RJ[0], weights.neck_pitch, weights.neck, H, g)
        if weights.limit > 0.0:
            add_joint_limits(RJ, hinges, weights.limit, H, g)
        if weights.clearance > 0.0:
            keep_arms_clear(t0, R0, RJ, hinges, figure, capsules, weights.clearance, H, g)
        mirror_upper(H)
        solve_positive(H, g, L, step)
        size = np.abs(step).max()
        kernels.retract(t0, R0, RJ, hinges, step, min(1.0, stop.step_limit / max(size, 1e-300)))
        before[:] = after
        place_points(t0, R0, RJ, hinges, figure, after)
        moved = np.sqrt(((after - before) ** 2).sum(axis=1).max())
        if moved < stop.tolerance:
            return iteration + 1, moved
    return stop.iterations, moved


@njit(cache=True)
def place_points(t0, R0, RJ, hinges, figure, P):
    """The 15 reference points (15, 3) of a pose."""
    G, axes = np.empty((STICKS, 3, 3)), np.empty((18, 3))
    A, B = np.empty((STICKS, 3)), np.empty((STICKS, 3))
    kernels.stick_frames(R0, RJ, hinges, G, axes)
    kernels.stick_ends(G, t0, figure.lengths, figure.origins, A, B)
    kernels.reference_points(A, B, t0, P)


@njit(cache=True)
def measure(data, t0, R0, RJ, hinges, figure, capsules, weights, H, g, distances, counts):
    """What the data say at a pose: upper H and g (overwritten), each point's distance (n,) m to its stick, and the
    inliers (10,) a stick. Returns the inliers' (square sum m^2, weighted square sum, degrees of freedom)."""
    n = data.points.shape[0]
    G, axes = np.empty((STICKS, 3, 3)), np.empty((18, 3))
    A, B = np.empty((STICKS, 3)), np.empty((STICKS, 3))
    stick, along, feet, squared = np.empty(n, np.int64), np.empty(n), np.empty((n, 3)), np.empty(n)
    weight, keep = np.empty(n), np.empty(n, np.bool_)
    kernels.stick_frames(R0, RJ, hinges, G, axes)
    kernels.stick_ends(G, t0, figure.lengths, figure.origins, A, B)
    foot_points(data.points, A, B, stick, along, feet, squared)
    robust_weights(stick, squared, data.information, data.gate2, weights, keep, weight)
    H[:] = 0.0
    g[:] = 0.0
    add_point_residuals(data.points, weight, stick, along, feet, A, B, t0, axes, H, g)
    if weights.voxel > 0.0:
        add_voxels(data, capsules, weights, G, t0, A, axes, H, g)
    if data.contour_rays.information.shape[0] > 0:
        add_contour_rays(data.contour_rays, capsules, weights, G, t0, A, axes, H, g)
    if weights.inside > 0.0:
        add_inside_residuals(data.hull, weights.inside_slack, weights.inside, weights.inside_gate, A, B, t0, axes, H, g)
    distances[:] = np.sqrt(squared)
    return summarise(stick, along, squared, weight, keep, counts)


@njit(cache=True)
def add_voxels(data, capsules, weights, G, t0, A, axes, H, g):
    """The voxels' part of the normal equations."""
    m, k = data.voxels.shape[0], capsules.stick.shape[0]
    P, Q = np.empty((k, 3)), np.empty((k, 3))
    match = (np.zeros(m, np.int64), np.zeros(m), np.empty(m))
    x, y, z = columns(data.voxels)
    place_capsules(capsules, G, A, P, Q)
    nearest_capsule(x, y, z, P, Q, capsules.radii, match[0], match[1], match[2])
    add_voxel_residuals(data.voxels, capsules, P, Q, match, weights.voxel, weights.voxel_gate, t0, A, axes, H, g)


@njit(cache=True)
def add_contour_rays(contour_rays, capsules, weights, G, t0, A, axes, H, g):
    """The rims' part of the normal equations."""
    n, k = contour_rays.information.shape[0], capsules.stick.shape[0]
    P, Q = np.empty((k, 3)), np.empty((k, 3))
    match = (np.zeros(n, np.int64), np.zeros(n), np.empty(n), np.empty(n))
    weight = np.empty(n)
    place_capsules(capsules, G, A, P, Q)
    match_contour_rays(contour_rays, P, Q, capsules.radii, weights.contour_slack, match)
    contour_weights(match[3], contour_rays.information, weights.contour_gate, weight)
    add_contour_residuals(contour_rays, capsules, P, Q, match, weight, t0, A, axes, H, g)


@njit(cache=True)
def body_surface_distances(data, t0, R0, RJ, hinges, figure, capsules, distance):
    """Signed distance (m,) of every surface voxel from the flesh at a pose, m, negative inside; returns the stick (m,)
    whose flesh is nearest."""
    m, k = data.voxels.shape[0], capsules.stick.shape[0]
    G, axes = np.empty((STICKS, 3, 3)), np.empty((18, 3))
    A, B = np.empty((STICKS, 3)), np.empty((STICKS, 3))
    P, Q = np.empty((k, 3)), np.empty((k, 3))
    kernels.stick_frames(R0, RJ, hinges, G, axes)
    kernels.stick_ends(G, t0, figure.lengths, figure.origins, A, B)
    place_capsules(capsules, G, A, P, Q)
    x, y, z = columns(data.voxels)
    capsule = np.zeros(m, np.int64)
    nearest_capsule(x, y, z, P, Q, capsules.radii, capsule, np.zeros(m), distance)
    return capsules.stick[capsule]


@njit(cache=True)
def keep_arms_clear(t0, R0, RJ, hinges, figure, capsules, information, H, g):
    """The room between arms and torso, as normal equations."""
    G, axes = np.empty((STICKS, 3, 3)), np.empty((18, 3))
    A, B = np.empty((STICKS, 3)), np.empty((STICKS, 3))
    P, Q = np.empty((capsules.stick.shape[0], 3)), np.empty((capsules.stick.shape[0], 3))
    kernels.stick_frames(R0, RJ, hinges, G, axes)
    kernels.stick_ends(G, t0, figure.lengths, figure.origins, A, B)
    place_capsules(capsules, G, A, P, Q)
    add_arm_clearance(P, Q, capsules.radii, information, A, B, t0, axes, H, g)


@njit(cache=True)
def robust_weights(stick, squared, information, gate2, weights, keep, weight):
    """Weights (n,) 1/m^2 of the points, and ``keep`` (n,) for those that count as inliers."""
    n = squared.shape[0]
    if weights.robust == X84:
        x84_keep(np.sqrt(squared), stick, STICKS, weights.floor, keep)
        for i in range(n):
            weight[i] = information[i] if keep[i] else 0.0
        return
    for i in range(n):
        ratio = 1.0 + squared[i] / gate2[i]
        weight[i] = information[i] / (ratio * ratio)
        keep[i] = squared[i] <= gate2[i]


@njit(cache=True)
def summarise(stick, along, squared, weight, keep, counts):
    """Inliers a stick into ``counts`` (10,); returns their square sum, weighted square sum, and degrees of freedom.

    A foot inside a stick slides: its residual has two degrees of freedom; a clamped one has three.
    """
    total, chi2, freedom = 0.0, 0.0, 0.0
    counts[:] = 0
    for i in range(stick.shape[0]):
        if not keep[i]:
            continue
        counts[stick[i]] += 1
        total += squared[i]
        chi2 += weight[i] * squared[i]
        freedom += 2.0 if 0.0 < along[i] < 1.0 else 3.0
    return total, chi2, freedom


@njit(cache=True)
def points_and_covariances(t0, R0, RJ, hinges, figure, information, scale, P, covariance):
    """The 15 reference points (15, 3) of a pose, and ``scale`` J information^-1 J^T of each (15, 3, 3)."""
    G, axes = np.empty((STICKS, 3, 3)), np.empty((18, 3))
    A, B = np.empty((STICKS, 3)), np.empty((STICKS, 3))
    kernels.stick_frames(R0, RJ, hinges, G, axes)
    kernels.stick_ends(G, t0, figure.lengths, figure.origins, A, B)
    kernels.reference_points(A, B, t0, P)
    point_covariances(information, A, B, t0, axes, scale, covariance)
