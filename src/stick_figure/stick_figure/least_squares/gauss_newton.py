"""The compiled core of the all-joints fit: one robust Gauss-Newton over everything that speaks about the pose.

Every term is a kernel ``add_<term>(..., H, g)`` in a module of its own; a new term is such a kernel, its data in
:class:`Data`, its weight in :class:`Weights`, and a line in :func:`linearise` or :func:`regularise`.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from capture_rig.kernel import njit
from capture_rig.small_matrices import solve_positive
from capture_rig.visibility import UnseenCells

from .. import kernels
from ..joint_limits import LIMIT_SD_RAD, NECK_SD, add_joint_limits, add_neck_rest
from .contour_factor import (
    SLACK_M,
    SURFACE_GATE_M,
    RayArrays,
    add_contour,
    best_of_all,
    best_of_stiff,
    look_at_ends,
    match_rays,
    match_turned,
    ray_match,
)
from .free_ends import follow, straight_ends, turn_ends
from .independent_rows import add_independent_rows
from .keypoint_factor import NO_KEYPOINTS, Keypoints, add_keypoints
from .normal_equations import TANGENT, mirror_upper, point_covariances
from .placed_figure import STICKS, place, reference_points, surface_distances
from .point_factor import add_point_residuals, add_surface, match_points, summarise

# Thresholds: chosen with python bench/people.py --ablation, in steps of about a half.
TIGHT_M = 0.025  # excess of the hull over the body at which the voxels' weight has fallen to a half
# weight of 1200 rays of 9000 / m^2 over that of what they tell, 33 places of a centimetre (`independent_rows`); with 10
# to 50 simulated detections (tests/support/simulated_detections.py) settle as many limbs
OVERCOUNTED = 30.0
LOOKS_AT_ENDS = 3  # until hands and feet of a given pose have turned to where the rays want them


class Data(NamedTuple):
    """What was measured: centerline points (n, 3) m with information (n,) 1/m^2 and squared gate (n,) m^2; voxels
    (m, 3) m of the hull's surface, samples (k, 3) m of the whole hull, contour rays, where no hull can be, and joints
    that a detector found in the images."""

    points: np.ndarray
    information: np.ndarray
    gate2: np.ndarray
    voxels: np.ndarray
    hull: np.ndarray
    contour_rays: RayArrays
    unseen: UnseenCells
    keypoints: Keypoints = NO_KEYPOINTS


class Weights(NamedTuple):
    """How much each term counts: information in 1/m^2 or 1/rad^2; zero switches it off.

    prior (24,) : of the tangent slots about the start. ends : of hands and feet about straight.
    """

    prior: np.ndarray
    voxel: float
    ends: float


class Stop(NamedTuple):
    """When to stop: iterations at most, converged when no reference point moves farther than ``tolerance`` (m) in one;
    rad that a hinge may stay on the wrong side of straight."""

    iterations: int
    tolerance: float
    hinge_margin: float


@njit(cache=True, nogil=True)
def assess(data, state, figure, weights, unseen):
    """Evaluate the data at a state: how well it explains them, and how well they determine it.

    unseen : (24,) information about what no row bears on. Returns reference points (15, 3) m and their covariance
    (15, 3, 3) m^2, that of the independent rows; inliers a stick (10,) and their root mean square distance (m); surface
    voxels near each stick's surface (10,); what rays were matched to.
    """
    placed, counts, near = place(state, figure), np.zeros(STICKS, np.int64), np.zeros(STICKS, np.int64)
    capsule, _, distance = surface_distances(data.voxels, placed)
    for i in range(distance.shape[0]):
        if abs(distance[i]) < SURFACE_GATE_M:
            near[placed.surface.stick[capsule[i]]] += 1
    best = best_of_all(data.contour_rays, placed, SLACK_M)
    rays_match, placed = _with_ends_turned(data.contour_rays, best, state, figure, placed, weights)
    match, independent = match_points(data, placed), np.diag(unseen)
    total = summarise(match, counts)
    add_independent_rows(data, placed, rays_match, match, independent)
    add_keypoints(data.keypoints, placed, 1.0, independent, np.empty(TANGENT))
    mirror_upper(independent)
    covariance = point_covariances(independent, placed)
    return reference_points(placed), covariance, counts, np.sqrt(total / max(counts.sum(), 1)), near, ray_match(best)


@njit(cache=True)
def _with_ends_turned(rays, best, state, figure, placed, weights):
    """Return the match of the rays, and the figure with hands and feet turned to where they want them, the pose as it
    is; ``placed`` : with both straight, ``best`` (4, n) of its capsules."""
    ends = straight_ends(weights.ends)
    stiff = best_of_stiff(rays, placed, SLACK_M, best)
    for _ in range(LOOKS_AT_ENDS):
        look_at_ends(rays, match_turned(rays, placed, SLACK_M, stiff), placed, ends)
        follow(ends, np.zeros(TANGENT), 1.0)
        placed = place(state, figure)
        turn_ends(ends, placed)
    return match_turned(rays, placed, SLACK_M, stiff), placed


@njit(cache=True)
def loose_hull_weight(weights, distance):
    """Return the weight of the surface voxels, by their distances (m,) m from the body's surface.

    A hull of few cameras is up to twice the body's volume, and the surface of what it adds is not the body's. Its
    excess is the median distance: about 10 mm for six cameras around a person, 60 mm for four on two sides.
    """
    if weights.voxel == 0.0:
        return 0.0
    excess = max(np.median(distance), 0.0)
    return weights.voxel / (1.0 + (excess / TIGHT_M) ** 4.0)


@njit(cache=True, nogil=True)
def minimise(data, state, figure, weights, stop):
    """Fit in place over the state, the surface voxels weighed by where it begins; bend the hinges the right way.

    Returns the iterations, and how far (m) the last one moved any of the 15 reference points. (Not the step itself: the
    twist of a straight limb may wander without moving anything.)
    """
    start = (state.t0.copy(), state.R0.copy(), state.RJ.copy(), state.hinges.copy())
    H, g = np.empty((TANGENT, TANGENT)), np.empty(TANGENT)
    L, step = np.empty((TANGENT, TANGENT)), np.empty(TANGENT)
    placed, ends = place(state, figure), straight_ends(weights.ends)
    after, moved, voxel, iteration = reference_points(placed), np.inf, 0.0, 0
    while iteration < stop.iterations and not moved < stop.tolerance:
        nearest = surface_distances(data.voxels, placed)
        if iteration == 0:
            voxel = loose_hull_weight(weights, nearest[2])
        rays_match = match_rays(data.contour_rays, placed, SLACK_M)
        linearise(data, rays_match, nearest, placed, weights, voxel, ends, H, g)
        regularise(start, placed, weights, H, g)
        mirror_upper(H)
        solve_positive(H, g, L, step)
        scale = kernels.scale_of_step(step)
        kernels.retract(state.t0, state.R0, state.RJ, state.hinges, step, scale)
        follow(ends, step, scale)
        placed, before = place(state, figure), after
        turn_ends(ends, placed)
        after = reference_points(placed)
        moved = np.sqrt(((after - before) ** 2).sum(axis=1).max())
        iteration += 1
    kernels.canonicalise_hinges(state.RJ, state.hinges, np.zeros(TANGENT), stop.hinge_margin)
    return iteration, moved


@njit(cache=True, nogil=True)
def linearise(data, rays_match, nearest, placed, weights, voxel, ends, H, g):
    """Overwrite upper H and g with what the data say about the pose, rays and voxels (``nearest``) with what they were
    matched to; ``voxel`` : weight of a voxel, 1/m^2."""
    H[:] = 0.0
    g[:] = 0.0
    add_point_residuals(data.points, match_points(data, placed), placed, H, g)
    if voxel != 0.0:
        add_surface(data.voxels, nearest, placed, voxel, SURFACE_GATE_M, H, g)
    add_contour(data.contour_rays, rays_match, placed, SURFACE_GATE_M, ends, H, g)
    add_keypoints(data.keypoints, placed, OVERCOUNTED, H, g)


@njit(cache=True)
def regularise(start, placed, weights, H, g):
    """Add to upper H and g what is known without data: the start, the neck's rest, joint limits."""
    back = np.empty(TANGENT)
    t0, R0, RJ, hinges = start
    kernels.difference(t0, R0, RJ, hinges, placed.t0, placed.R0, placed.RJ, placed.hinges, back)
    for k in range(TANGENT):
        H[k, k] += weights.prior[k]
        g[k] += weights.prior[k] * back[k]
    add_neck_rest(placed.RJ[0], NECK_SD**-2, H, g)
    add_joint_limits(placed.RJ, placed.hinges, np.inf, LIMIT_SD_RAD**-2, H, g)
