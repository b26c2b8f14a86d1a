"""Other places for one limb: every pose of its library against the rays that the rest of the body leaves over.

The library is coarse, so its best poses are refined by Gauss-Newton over the limb's four joint angles alone, a few
iterations each, before the best of them is offered to the fit of the whole body.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
from numba import njit

from capture_rig.small_matrices import solve_positive
from stick_figure import kernels
from stick_figure.body_surface import BodySurface, place_capsules
from stick_figure.least_squares.contour_factor import NORMAL, RayArrays, match_rays, sum_rays
from stick_figure.least_squares.contour_factor import TANGENT as ALONG
from stick_figure.least_squares.hull_samples import HullSamples, is_in_hull, is_unseen
from stick_figure.least_squares.normal_equations import (
    CHAIN_COLUMNS,
    ENDS,
    TANGENT,
    TORSO_COLUMNS,
    add_capsule,
    mirror_upper,
    no_sums,
    pose_columns,
)
from stick_figure.least_squares.placed_figure import Figure, State, place
from stick_figure.pose import Pose

from .evidence import GATE_M, SLACK_M, ray_cost
from .pose_library import Limb, LimbPoses

COARSE_GATE_M = 0.12  # the library is coarse: an elbow may be 80 mm off
OPEN_M = 0.03  # a ray that the rest of the body passes so near has no need of the limb
APART_M = 0.12  # hands or feet (and elbows or knees) so near to each other are the same place
REFINED = 6  # poses of the library that are refined
LEAST_MARGIN = -4.0  # rays that another place must explain beyond this one to be fitted (which finds some more)
HELD_AT = (0.5, 1.0)  # where along upper and lower limb the hull is asked
HELD_LEAST = 3  # of those four points, that must lie in the hull

ITERATIONS = 4
ANGLES = 4  # three of the ball joint, one of the hinge
REFINE_GATE_M = 0.08
STIFFNESS_M2 = 2.0 * 0.3**2  # rays that hold an angle at its guess, times their lever squared
STEP_MOST = 0.4  # rad


def other_place(
    figure: Figure, pose: Pose, limb: Limb, library: LimbPoses, contour_rays: RayArrays, hull: HullSamples
) -> Pose | None:
    """Find the best pose that differs from ``pose`` in one limb alone and puts it elsewhere, if it may explain more."""
    state = State.of(pose)
    margin = _search(contour_rays, state, figure, limb, library, hull)
    return None if margin < LEAST_MARGIN else with_limb(pose, limb, state.RJ[limb.ball], state.hinges[limb.hinge])


def with_limb(pose: Pose, limb: Limb, R: np.ndarray, flexion: float) -> Pose:
    """Return the pose with one limb elsewhere: upper limb to torso ``R``, hinge ``flexion`` (rad)."""
    R_joints, hinges = pose.R_joints.copy(), pose.hinges.copy()
    R_joints[limb.ball], hinges[limb.hinge] = R, flexion
    return replace(pose, R_joints=R_joints, hinges=hinges)


@njit(cache=True, nogil=True)
def _search(contour_rays, state, figure, limb, library, hull):
    """Put into ``state`` the best pose of the library that lies elsewhere, refined.

    Returns the rays explained beyond those that the limb explains now; -inf when there is no such pose.
    """
    rays, without = _left_over(contour_rays, state, figure, limb)
    coarse, fine = ray_cost(without, COARSE_GATE_M), ray_cost(without, GATE_M)  # what each ray costs without the limb
    placed, costs = place(state, _part_of(figure, limb, True)), np.empty(without.shape[0])
    ends_now = _ends(placed, limb)
    gain_now = _rays_gained(rays, placed, fine, GATE_M, costs)
    gains = np.zeros(library.flexion.shape[0])
    for h in range(gains.shape[0]):
        state.RJ[limb.ball], state.hinges[limb.hinge] = library.R[h], library.flexion[h]
        _place_limb(placed, figure, limb)
        if _is_held(placed, limb, hull):
            gains[h] = _rays_gained(rays, placed, coarse, COARSE_GATE_M, costs)
    best, best_R, best_flexion = -np.inf, np.eye(3), 0.0
    for h in np.argsort(-gains)[:REFINED]:
        if gains[h] <= 0.0:
            break
        state.RJ[limb.ball], state.hinges[limb.hinge] = library.R[h], library.flexion[h]
        _refine_limb(rays, placed, figure, limb)
        gain = _rays_gained(rays, placed, fine, GATE_M, costs)
        elsewhere = np.sqrt(((_ends(placed, limb) - ends_now) ** 2).sum(axis=1).max()) > APART_M
        if gain > best and _is_held(placed, limb, hull) and elsewhere:
            best, best_flexion = gain, state.hinges[limb.hinge]
            best_R[:] = state.RJ[limb.ball]
    state.RJ[limb.ball], state.hinges[limb.hinge] = best_R, best_flexion
    return best - gain_now


@njit(cache=True)
def _left_over(rays, state, figure, limb):
    """Return the rays that the rest of the body leaves over for a limb within reach, and how far (m) it passes them."""
    placed = place(state, _part_of(figure, limb, False))
    without, shoulder = match_rays(rays, placed, SLACK_M).separation, placed.A[limb.upper]
    reach = figure.lengths[limb.upper] + figure.lengths[limb.lower] + COARSE_GATE_M
    chosen, count = np.empty(without.shape[0], np.int64), 0
    for i in range(without.shape[0]):
        if without[i] > OPEN_M and _distance_of_ray(rays.rows, i, shoulder) < reach:
            chosen[count] = i
            count += 1
    chosen = chosen[:count]
    rows = np.empty((rays.rows.shape[0], count))
    for k in range(rows.shape[0]):
        rows[k] = rays.rows[k][chosen]
    return RayArrays(rows, np.ones(count)), without[chosen]


@njit(cache=True)
def _distance_of_ray(rows, i, point):
    """Return the distance of a point from a ray's line."""
    across = rows[NORMAL, i] * point[0] + rows[NORMAL + 1, i] * point[1] + rows[NORMAL + 2, i] * point[2]
    along = rows[ALONG, i] * point[0] + rows[ALONG + 1, i] * point[1] + rows[ALONG + 2, i] * point[2]
    return math.hypot(across - rows[NORMAL + 3, i], along - rows[ALONG + 3, i])


@njit(cache=True)
def _part_of(figure, limb, own):
    """Return the figure with the limb's surface alone (``own``), or with all but the limb's."""
    surface, rows = figure.surface, np.empty(figure.surface.stick.shape[0], np.int64)
    count = 0
    for k in range(rows.shape[0]):
        if ((surface.stick[k] == limb.upper) | (surface.stick[k] == limb.lower)) == own:
            rows[count] = k
            count += 1
    rows = rows[:count]
    part = BodySurface(surface.stick[rows], surface.start[rows], surface.end[rows], surface.radii[rows])
    return Figure(figure.lengths, figure.origins, part)


@njit(cache=True)
def _place_limb(placed, figure, limb):
    """Place the limb's sticks and surface anew; ``placed`` shares the state's arrays."""
    pose, frames = (placed.t0, placed.R0, placed.RJ, placed.hinges), (placed.G, placed.axes, placed.A, placed.B)
    kernels.move_limb(limb.ball, limb.hinge, pose, (figure.lengths, figure.origins), frames)
    place_capsules(placed.surface, placed.G, placed.A, placed.P, placed.Q)


@njit(cache=True)
def _refine_limb(rays, placed, figure, limb):
    """Move the limb toward the rays, in place: Gauss-Newton over its four angles."""
    own, pull = np.empty((ANGLES, ANGLES)), np.empty(ANGLES)
    L, turn, step = np.empty((ANGLES, ANGLES)), np.empty(ANGLES), np.zeros(TANGENT)
    _place_limb(placed, figure, limb)
    for _ in range(ITERATIONS):
        sums = no_sums(placed.P.shape[0], ENDS)
        sum_rays(rays, match_rays(rays, placed, SLACK_M), REFINE_GATE_M, sums)
        _add_limb_sums(sums, placed, limb, own, pull)
        for i in range(ANGLES):
            own[i, i] += STIFFNESS_M2
        solve_positive(own, pull, L, turn)
        for i in range(ANGLES):
            step[limb.slots[i]] = turn[i]
        scale = min(1.0, STEP_MOST / max(np.abs(turn).max(), 1e-12))
        kernels.turn_limb(limb.ball, limb.hinge, placed.RJ, placed.hinges, step, scale)
        _place_limb(placed, figure, limb)


@njit(cache=True)
def _add_limb_sums(sums, placed, limb, own, pull):
    """Fill own (4, 4) and pull (4,) with the limb's part of the pose's equations: the torso stands still."""
    M, slots = np.empty((2 * ENDS, CHAIN_COLUMNS)), np.empty(CHAIN_COLUMNS, np.int64)
    angle, work = np.empty(ANGLES, np.int64), np.empty((2 * ENDS + 2, 2 * ENDS))
    own[:] = 0.0
    pull[:] = 0.0
    for k in range(placed.P.shape[0]):
        n = pose_columns(k, placed, M, slots)
        for m in range(TORSO_COLUMNS, n):
            for i in range(ANGLES):
                if limb.slots[i] == slots[m]:
                    angle[m - TORSO_COLUMNS] = i
        add_capsule(sums, k, M[:, TORSO_COLUMNS:], angle, n - TORSO_COLUMNS, work, own, pull)
    mirror_upper(own)


@njit(cache=True, error_model="numpy")  # a check for zero would keep it from being vectorised
def _rays_gained(rays, placed, cost_without, gate, costs):
    """Return the rays that the limb explains: what each (n,) costs without it, less what it costs with it.

    costs (n,) : scratch.
    """
    separation = match_rays(rays, placed, SLACK_M).separation
    for i in range(costs.shape[0]):
        costs[i] = cost_without[i] - ray_cost(separation[i], gate)
    gain = 0.0
    for i in range(costs.shape[0]):
        gain += max(costs[i], 0.0)
    return gain


@njit(cache=True)
def _ends(placed, limb):
    """Return where the limb bends and where it ends (2, 3)."""
    ends = np.empty((2, 3))
    ends[0], ends[1] = placed.B[limb.upper], placed.B[limb.lower]
    return ends


@njit(cache=True)
def _is_held(placed, limb, hull):
    """Return whether the hull holds the limb."""
    held = 0
    for stick in (limb.upper, limb.lower):
        A, B = placed.A[stick], placed.B[stick]
        for u in HELD_AT:
            x, y, z = A[0] + u * (B[0] - A[0]), A[1] + u * (B[1] - A[1]), A[2] + u * (B[2] - A[2])
            held += is_in_hull(hull, x, y, z) or is_unseen(hull.unseen, x, y, z)
    return held >= HELD_LEAST
