"""Other places for one limb: every pose of its library against the rays that the rest of the body leaves over.

The library is coarse, so its best poses are refined by Gauss-Newton over the limb's four joint angles alone, a few
iterations each, before the best of them is offered to the fit of the whole body.
"""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numba import njit

from capture_rig.small_matrices import solve_positive
from stick_figure import kernels
from stick_figure.body_surface import BodySurface
from stick_figure.least_squares.contour_factor import DIRECTION, RayArrays, match_rays, sum_rays
from stick_figure.least_squares.normal_equations import ENDS, TANGENT, add_pose_sums, mirror_upper, no_sums
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
CELL_M = 0.05  # a cell and its neighbours count as hull: within 0.05 to 0.1 m of a sample


def other_place(
    figure: Figure, pose: Pose, limb: Limb, library: LimbPoses, contour_rays: RayArrays, hull: HullMap
) -> Pose | None:
    """Find the best pose that differs from ``pose`` in one limb alone and puts it elsewhere, if it may explain more."""
    mine = (figure.surface.stick == limb.upper) | (figure.surface.stick == limb.lower)
    rest, own = (figure._replace(surface=_chosen(figure.surface, rows)) for rows in (~mine, mine))
    state = State.of(pose)
    placed = place(state, rest)
    without = match_rays(contour_rays, placed, SLACK_M).separation
    reach = figure.lengths[limb.upper] + figure.lengths[limb.lower] + COARSE_GATE_M
    open_rays = (without > OPEN_M) & (_distances(contour_rays, placed.A[limb.upper]) < reach)
    left_over = contour_rays.chosen(open_rays, np.ones(np.count_nonzero(open_rays)))
    margin = _search(left_over, without[open_rays], state, own, limb, library, hull)
    return None if margin < LEAST_MARGIN else with_limb(pose, limb, state.RJ[limb.ball], state.hinges[limb.hinge])


def with_limb(pose: Pose, limb: Limb, R: np.ndarray, flexion: float) -> Pose:
    """Return the pose with one limb elsewhere: upper limb to torso ``R``, hinge ``flexion`` (rad)."""
    R_joints, hinges = pose.R_joints.copy(), pose.hinges.copy()
    R_joints[limb.ball], hinges[limb.hinge] = R, flexion
    return replace(pose, R_joints=R_joints, hinges=hinges)


def _chosen(surface: BodySurface, rows: np.ndarray) -> BodySurface:
    return BodySurface(*(np.ascontiguousarray(part[rows]) for part in surface))


def _distances(rays: RayArrays, point: np.ndarray) -> np.ndarray:
    """Return the distance (n,) m of a point from every ray's line."""
    across = rays.rows[:DIRECTION].reshape(2, 4, -1)
    return np.hypot(*(np.einsum("akn,k->an", across[:, :3], point) - across[:, 3]))


@njit(cache=True)
def _search(rays, without, state, figure, limb, library, hull):
    """Put into ``state`` the best pose of the library that lies elsewhere, refined.

    ``rays`` that the rest of the body leaves over, passing it at the distances ``without``; ``figure`` with the limb's
    surface alone. Returns the rays explained beyond those that the limb explains now; -inf when there is no such pose.
    """
    now = place(state, figure)
    gain_now = _rays_gained(match_rays(rays, now, SLACK_M).separation, without, GATE_M)
    gains = np.zeros(library.flexion.shape[0])
    for h in range(gains.shape[0]):
        state.RJ[limb.ball], state.hinges[limb.hinge] = library.R[h], library.flexion[h]
        placed = place(state, figure)
        if _is_held(placed, limb, hull):
            gains[h] = _rays_gained(match_rays(rays, placed, SLACK_M).separation, without, COARSE_GATE_M)
    best, best_R, best_flexion = -np.inf, np.eye(3), 0.0
    for h in np.argsort(-gains)[:REFINED]:
        if gains[h] <= 0.0:
            break
        state.RJ[limb.ball], state.hinges[limb.hinge] = library.R[h], library.flexion[h]
        placed = _refine_limb(rays, state, figure, limb)
        gain = _rays_gained(match_rays(rays, placed, SLACK_M).separation, without, GATE_M)
        if gain > best and _is_held(placed, limb, hull) and _is_elsewhere(placed, now, limb):
            best, best_flexion = gain, state.hinges[limb.hinge]
            best_R[:] = state.RJ[limb.ball]
    state.RJ[limb.ball], state.hinges[limb.hinge] = best_R, best_flexion
    return best - gain_now


@njit(cache=True)
def _refine_limb(rays, state, figure, limb):
    """Move the limb toward the rays, in place: Gauss-Newton over its four angles; returns the placed figure."""
    H, g, step = np.empty((TANGENT, TANGENT)), np.empty(TANGENT), np.zeros(TANGENT)
    own, pull, L, turn = np.empty((ANGLES, ANGLES)), np.empty(ANGLES), np.empty((ANGLES, ANGLES)), np.empty(ANGLES)
    placed = place(state, figure)
    for _ in range(ITERATIONS):
        sums = no_sums(placed.P.shape[0], ENDS)
        sum_rays(rays, match_rays(rays, placed, SLACK_M), REFINE_GATE_M, sums)
        H[:] = 0.0
        g[:] = 0.0
        add_pose_sums(sums, placed, H, g)
        mirror_upper(H)
        for i in range(ANGLES):
            pull[i] = g[limb.slots[i]]
            for j in range(ANGLES):
                own[i, j] = H[limb.slots[i], limb.slots[j]]
            own[i, i] += STIFFNESS_M2
        solve_positive(own, pull, L, turn)
        for i in range(ANGLES):
            step[limb.slots[i]] = turn[i]
        scale = min(1.0, STEP_MOST / max(np.abs(turn).max(), 1e-12))
        kernels.retract(state.t0, state.R0, state.RJ, state.hinges, step, scale)
        placed = place(state, figure)
    return placed


@njit(cache=True)
def _rays_gained(separation, without, gate):
    """Return the rays that the limb explains: what each (n,) costs ``without`` it, less what it costs with it."""
    gain = 0.0
    for i in range(separation.shape[0]):
        gain += max(ray_cost(without[i], gate) - ray_cost(separation[i], gate), 0.0)
    return gain


@njit(cache=True)
def _is_elsewhere(placed, other, limb):
    """Return whether the limb ends, or bends, in another place than in the other figure."""
    first, second = 0.0, 0.0
    for i in range(3):
        first += (placed.B[limb.upper, i] - other.B[limb.upper, i]) ** 2
        second += (placed.B[limb.lower, i] - other.B[limb.lower, i]) ** 2
    return max(first, second) > APART_M**2


@njit(cache=True)
def _is_held(placed, limb, hull):
    """Return whether the hull holds the limb."""
    held = 0
    for stick in (limb.upper, limb.lower):
        A, B = placed.A[stick], placed.B[stick]
        for u in HELD_AT:
            held += _in_hull(hull, A[0] + u * (B[0] - A[0]), A[1] + u * (B[1] - A[1]), A[2] + u * (B[2] - A[2]))
    return held >= HELD_LEAST


class HullMap(NamedTuple):
    """The hull as a coarse map of cells, so that hundreds of poses can be asked whether they lie in it.

    low (3,) m: corner of the first cell, world; cells (x, y, z) bool: hull here or in a neighbouring cell.
    """

    low: np.ndarray
    cells: np.ndarray

    @staticmethod
    def of(samples_world: np.ndarray) -> HullMap:
        """Map samples (m, 3) of the hull, m > 0."""
        low = samples_world.min(axis=0) - 2.0 * CELL_M
        size = np.ceil((samples_world.max(axis=0) - low) / CELL_M).astype(int) + 2
        cells = np.zeros(size, np.bool_)
        _mark(samples_world, low, cells)
        return HullMap(low, cells)


@njit(cache=True)
def _mark(samples, low, cells):
    for n in range(samples.shape[0]):
        i = int((samples[n, 0] - low[0]) / CELL_M)
        j = int((samples[n, 1] - low[1]) / CELL_M)
        k = int((samples[n, 2] - low[2]) / CELL_M)
        cells[i - 1 : i + 2, j - 1 : j + 2, k - 1 : k + 2] = True


@njit(cache=True)
def _in_hull(hull, x, y, z):
    """Return whether a point lies in a cell of hull."""
    cells = hull.cells
    a, b, c = (x - hull.low[0]) / CELL_M, (y - hull.low[1]) / CELL_M, (z - hull.low[2]) / CELL_M
    if a < 0.0 or b < 0.0 or c < 0.0 or a >= cells.shape[0] or b >= cells.shape[1] or c >= cells.shape[2]:
        return False
    return cells[int(a), int(b), int(c)]
