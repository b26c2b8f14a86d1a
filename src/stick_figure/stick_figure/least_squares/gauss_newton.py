"""The compiled core of the all-joints fit: one robust Gauss-Newton over all terms of the pose.

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
    linearise_extremities,
    match_rays,
    match_turned,
    ray_match,
)
from .effective_information import add_effective_information
from .extremities import back_substitute, straight_extremities, turn_extremities
from .keypoint_factor import NO_KEYPOINTS, Keypoints, add_keypoints
from .normal_equations import TANGENT, mirror_upper, point_covariances
from .point_factor import add_point_residuals, add_surface, match_points, summarise
from .posed_model import STICKS, place, reference_points, surface_distances

# Thresholds: chosen with python bench/people.py, in steps of about a half.
TIGHT_M = 0.025  # excess of the hull over the body at which the voxels' weight has fallen to a half
# total weight of 1200 rays of 9000 / m^2 over their effective information, of 33 independent samples of 1 cm
# (`effective_information`); 10 and 50 decide as many limbs of tests/support/simulated_detections.py rightly
OVERCOUNTED = 30.0
EXTREMITY_ITERATIONS = 3  # after which hands and feet of a given pose have converged


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

    unseen : (24,) information of what no row bears on. Returns reference points (15, 3) m and their covariance
    (15, 3, 3) m^2 by the effective information; inliers a stick (10,) and their root mean square distance (m); surface
    voxels near each stick's surface (10,); the rays' match.
    """
    posed, counts, near = place(state, figure), np.zeros(STICKS, np.int64), np.zeros(STICKS, np.int64)
    capsule, _, distance = surface_distances(data.voxels, posed)
    for i in range(distance.shape[0]):
        if abs(distance[i]) < SURFACE_GATE_M:
            near[posed.surface.stick[capsule[i]]] += 1
    best = best_of_all(data.contour_rays, posed, SLACK_M)
    rays_match, posed = _with_extremities_turned(data.contour_rays, best, state, figure, posed, weights)
    match, independent = match_points(data, posed), np.diag(unseen)
    total = summarise(match, counts)
    add_effective_information(data, posed, rays_match, match, independent)
    add_keypoints(data.keypoints, posed, 1.0, independent, np.empty(TANGENT))
    mirror_upper(independent)
    covariance = point_covariances(independent, posed)
    return reference_points(posed), covariance, counts, np.sqrt(total / max(counts.sum(), 1)), near, ray_match(best)


@njit(cache=True)
def _with_extremities_turned(rays, best, state, figure, posed, weights):
    """Return the rays' match and the model with hands and feet fitted to them, the pose held; ``posed`` : with both
    straight, ``best`` (4, n) of its capsules."""
    ends = straight_extremities(weights.ends)
    stiff = best_of_stiff(rays, posed, SLACK_M, best)
    for _ in range(EXTREMITY_ITERATIONS):
        linearise_extremities(rays, match_turned(rays, posed, SLACK_M, stiff), posed, ends)
        back_substitute(ends, np.zeros(TANGENT), 1.0)
        posed = place(state, figure)
        turn_extremities(ends, posed)
    return match_turned(rays, posed, SLACK_M, stiff), posed


@njit(cache=True)
def hull_slack_weight(weights, distance):
    """Return the weight of the surface voxels, by their distances (m,) m from the body's surface.

    A hull of few cameras is up to twice the body's volume, with a surface that is not the body's. Its excess is the
    median distance: about 10 mm for six cameras around a person, 60 mm for four on two sides.
    """
    if weights.voxel == 0.0:
        return 0.0
    excess = max(np.median(distance), 0.0)
    return weights.voxel / (1.0 + (excess / TIGHT_M) ** 4.0)


@njit(cache=True, nogil=True)
def minimise(data, state, figure, weights, stop):
    """Fit the state in place, with the surface voxels' weight of its start; bend the hinges the right way.

    Returns the iterations, and how far (m) the last one moved any of the 15 reference points. (Not the step itself: the
    twist of a straight limb may wander without moving anything.)
    """
    start = (state.t0.copy(), state.R0.copy(), state.RJ.copy(), state.hinges.copy())
    H, g = np.empty((TANGENT, TANGENT)), np.empty(TANGENT)
    L, step = np.empty((TANGENT, TANGENT)), np.empty(TANGENT)
    posed, ends = place(state, figure), straight_extremities(weights.ends)
    after, moved, voxel, iteration = reference_points(posed), np.inf, 0.0, 0
    while iteration < stop.iterations and not moved < stop.tolerance:
        nearest = surface_distances(data.voxels, posed)
        if iteration == 0:
            voxel = hull_slack_weight(weights, nearest[2])
        rays_match = match_rays(data.contour_rays, posed, SLACK_M)
        linearise(data, rays_match, nearest, posed, weights, voxel, ends, H, g)
        regularise(start, posed, weights, H, g)
        mirror_upper(H)
        solve_positive(H, g, L, step)
        scale = kernels.scale_of_step(step)
        kernels.retract(state.t0, state.R0, state.RJ, state.hinges, step, scale)
        back_substitute(ends, step, scale)
        posed, before = place(state, figure), after
        turn_extremities(ends, posed)
        after = reference_points(posed)
        moved = np.sqrt(((after - before) ** 2).sum(axis=1).max())
        iteration += 1
    kernels.canonicalise_hinges(state.RJ, state.hinges, np.zeros(TANGENT), stop.hinge_margin)
    return iteration, moved


@njit(cache=True, nogil=True)
def linearise(data, rays_match, nearest, posed, weights, voxel, ends, H, g):
    """Overwrite upper H and g with the data's terms, rays and voxels (``nearest``) as matched; ``voxel`` : weight of a
    voxel, 1/m^2."""
    H[:] = 0.0
    g[:] = 0.0
    add_point_residuals(data.points, match_points(data, posed), posed, H, g)
    if voxel != 0.0:
        add_surface(data.voxels, nearest, posed, voxel, SURFACE_GATE_M, H, g)
    add_contour(data.contour_rays, rays_match, posed, SURFACE_GATE_M, ends, H, g)
    add_keypoints(data.keypoints, posed, OVERCOUNTED, H, g)


@njit(cache=True)
def regularise(start, posed, weights, H, g):
    """Add to upper H and g the priors: the start, the neck's rest, joint limits."""
    back = np.empty(TANGENT)
    t0, R0, RJ, hinges = start
    kernels.difference(t0, R0, RJ, hinges, posed.t0, posed.R0, posed.RJ, posed.hinges, back)
    for k in range(TANGENT):
        H[k, k] += weights.prior[k]
        g[k] += weights.prior[k] * back[k]
    add_neck_rest(posed.RJ[0], NECK_SD**-2, H, g)
    add_joint_limits(posed.RJ, posed.hinges, np.inf, LIMIT_SD_RAD**-2, H, g)
