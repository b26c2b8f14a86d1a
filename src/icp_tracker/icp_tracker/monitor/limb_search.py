"""Search for other places of one limb, rated by the data that the rest of the body does not explain.

The data are the contour rays that the body without the limb does not explain. Places come from the limb's library,
which is coarse: its best poses are refined by Gauss-Newton over the limb's own four angles, a few iterations each.
Places that were good at earlier sets are refined along with them, so that they move with the limb.

A place is rated by independent samples: cells of the limb's surface that rays show. A hem or a bent hand has many rays,
all at one place of the limb; an arm in view shows a dozen cells. A sample is worth a nat, so the log-likelihood of
detected elbows and hands is added.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np

from capture_rig.kernel import njit
from capture_rig.small_matrices import solve_positive
from stick_figure import kernels
from stick_figure.body_surface import BodySurface, place_capsules
from stick_figure.least_squares.contour_factor import NORMAL, RayArrays, RayMatch, match_rays, rays_at, sum_rays
from stick_figure.least_squares.contour_factor import TANGENT as ALONG
from stick_figure.least_squares.effective_information import CELLS, cell_of_ray
from stick_figure.least_squares.gauss_newton import Data
from stick_figure.least_squares.keypoint_factor import keypoint_support
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
from stick_figure.least_squares.posed_model import STICKS, BodyModel, PoseState, place
from stick_figure.pose import Pose

from ..articulated_fit import POINT_GATE_M
from .evidence import GATE_M, RAYS_PER_NAT, SAME_M, SLACK_M, match_to, ray_cost
from .pose_library import Limb, LimbPoses

# Thresholds: measured by python bench/recovery.py.
COARSE_GATE_M = 2.0 * GATE_M  # the library is coarse: an elbow may be 80 mm off
EXPLAINED_BY_BODY_M = 0.03  # data closer than this to the rest of the body are explained already
REFINED = 6  # poses of the library that are refined
KEPT = 3  # other places that are kept from set to set
ITERATIONS = 4
ANGLES = 4  # three of the ball joint, one of the hinge
STIFFNESS_M2 = 2.0 * 0.3**2  # rays that hold an angle at its guess, times their lever squared


@dataclass(frozen=True, eq=False)
class LimbPlaces:
    """Where else a limb may be, best first: at most KEPT places apart from each other and from the tracked one.

    poses : upper limb to torso and flexion, as in the library. samples : independent samples that only the tracked
    place explains, plus the nats of its detected joints; unexplained : samples within reach that neither limb nor body
    explains. margins (k,) : samples that each of these places explains beyond the tracked one. ends (k, 2, 3) : elbow
    and hand, or knee and foot, m, world; tracked (2, 3) : those of the tracked place. origins (k,) : the known place
    that each was refined from, or coincides with; -1 for a new one.
    """

    poses: LimbPoses
    margins: np.ndarray
    ends: np.ndarray
    tracked: np.ndarray
    samples: float
    unexplained: float
    origins: np.ndarray

    @cached_property
    def apart_m(self) -> np.ndarray:
        """Distance (k,) m of each place from the tracked one, of elbow or hand, whichever is farther."""
        return np.asarray(np.sqrt(((self.ends - self.tracked) ** 2).sum(axis=2).max(axis=1)))


NO_POSES = LimbPoses(np.empty((0, 3, 3)), np.empty(0))


def other_places(
    figure: BodyModel,
    pose: Pose,
    limb: Limb,
    data: Data,
    library: LimbPoses,
    known: LimbPoses = NO_POSES,
    matched: RayMatch | None = None,
) -> LimbPlaces:
    """Find other places of one limb: among the library's poses, and those ``known`` from the set before.

    ``matched`` : the rays' match in the pose, if known.
    """
    state = PoseState.of(pose)
    found = _search(data, matched or match_to(figure, state, data), state, figure, limb, library, known)
    R, flexion, margins, ends, tracked, samples, unexplained, origins = found
    return LimbPlaces(LimbPoses(R, flexion), margins, ends, tracked, samples, unexplained, origins)


def with_limb(pose: Pose, limb: Limb, R: np.ndarray, flexion: float) -> Pose:
    """Return the pose with one limb elsewhere: upper limb to torso ``R``, hinge ``flexion`` (rad)."""
    R_joints, hinges = pose.R_joints.copy(), pose.hinges.copy()
    R_joints[limb.ball], hinges[limb.hinge] = R, flexion
    return replace(pose, R_joints=R_joints, hinges=hinges)


@njit(cache=True, nogil=True)
def _search(data, matched, state, figure, limb, library, known):
    """Return the KEPT best places apart from the tracked one: R, flexion, margins, ends; the tracked ends, its samples,
    the unexplained ones; the known place that each of them is."""
    left, own = unexplained_data(data, matched, state, figure, limb), part_of(figure, limb, True)
    posed, costs, lower = place(state, own), np.empty(left.fine.shape[0]), own.surface.stick == limb.lower
    keypoints, sticks = data.keypoints, np.zeros(STICKS, np.bool_)
    sticks[limb.upper], sticks[limb.lower] = True, True
    tracked = _ends(posed, limb)
    samples = _samples(left, posed, lower, costs)
    unexplained = samples * _odds_unexplained(left, costs)
    samples += keypoint_support(keypoints, posed, sticks)
    gains = np.zeros(library.flexion.shape[0])
    for h in range(gains.shape[0]):
        state.RJ[limb.ball], state.hinges[limb.hinge] = library.R[h], library.flexion[h]
        _place_limb(posed, figure, limb)
        gains[h] = _rays_gained(left, posed, costs) + RAYS_PER_NAT * keypoint_support(keypoints, posed, sticks)
    chosen = np.argsort(-gains)[:REFINED]
    count = known.flexion.shape[0] + chosen.shape[0]
    R, flexion = np.empty((count, 3, 3)), np.empty(count)
    margins, ends = np.full(count, -np.inf), np.empty((count, 2, 3))
    for m in range(count):
        if m < known.flexion.shape[0]:
            state.RJ[limb.ball], state.hinges[limb.hinge] = known.R[m], known.flexion[m]
        else:
            h = chosen[m - known.flexion.shape[0]]
            if gains[h] <= 0.0:
                continue
            state.RJ[limb.ball], state.hinges[limb.hinge] = library.R[h], library.flexion[h]
        _refine_limb(left.rays, posed, figure, limb)
        R[m], flexion[m], ends[m] = state.RJ[limb.ball], state.hinges[limb.hinge], _ends(posed, limb)
        if farther_apart(ends[m], tracked) > SAME_M:
            found = _samples(left, posed, lower, costs) + keypoint_support(keypoints, posed, sticks)
            margins[m] = found - samples
    kept, origins = _distinct(margins, ends, known.flexion.shape[0])
    return R[kept], flexion[kept], margins[kept], ends[kept], tracked, samples, unexplained, origins


@njit(cache=True)
def _distinct(margins, ends, known):
    """Return the indices of the best places, KEPT at most, without duplicates; and for each the known place that it
    coincides with, -1 for a new one. The first ``known`` places are known."""
    kept, origins, count = np.empty(KEPT, np.int64), np.full(KEPT, -1), 0
    for m in np.argsort(-margins):
        if margins[m] == -np.inf:
            break
        same = 0
        while same < count and farther_apart(ends[m], ends[kept[same]]) > SAME_M:
            same += 1
        if same == KEPT:
            continue
        if same == count:
            kept[count] = m
            count += 1
        if m < known and origins[same] < 0:
            origins[same] = m
    return kept[:count], origins[:count]


@njit(cache=True)
def farther_apart(ends, others):
    """Return the larger of the distances (m) of two places' elbows and hands."""
    return np.sqrt(((ends - others) ** 2).sum(axis=1).max())


@njit(cache=True)
def _place_limb(posed, figure, limb):
    """Update the limb's sticks and surface; ``posed`` shares the state's arrays."""
    pose, frames = (posed.t0, posed.R0, posed.RJ, posed.hinges), (posed.G, posed.axes, posed.A, posed.B)
    kernels.move_limb(limb.ball, limb.hinge, pose, (figure.lengths, figure.origins), frames)
    place_capsules(posed.surface, posed.G, posed.A, posed.P, posed.Q)


@njit(cache=True)
def _refine_limb(rays, posed, figure, limb):
    """Move the limb toward the rays, in place: Gauss-Newton over its four angles."""
    own, pull = np.empty((ANGLES, ANGLES)), np.empty(ANGLES)
    L, turn, step = np.empty((ANGLES, ANGLES)), np.empty(ANGLES), np.zeros(TANGENT)
    _place_limb(posed, figure, limb)
    for _ in range(ITERATIONS):
        sums = no_sums(posed.P.shape[0], ENDS)
        sum_rays(rays, match_rays(rays, posed, SLACK_M), POINT_GATE_M, sums)
        _add_limb_sums(sums, posed, limb, own, pull)
        for i in range(ANGLES):
            own[i, i] += STIFFNESS_M2
        solve_positive(own, pull, L, turn)
        for i in range(ANGLES):
            step[limb.slots[i]] = turn[i]
        scale = kernels.scale_of_step(turn)
        kernels.turn_limb(limb.ball, limb.hinge, posed.RJ, posed.hinges, step, scale)
        _place_limb(posed, figure, limb)


@njit(cache=True)
def _add_limb_sums(sums, posed, limb, own, pull):
    """Fill own (4, 4) and pull (4,) with the limb's part of the pose's equations: the torso stands still."""
    M, slots = np.empty((2 * ENDS, CHAIN_COLUMNS)), np.empty(CHAIN_COLUMNS, np.int64)
    angle, work = np.empty(ANGLES, np.int64), np.empty((2 * ENDS + 1, 2 * ENDS))
    own[:] = 0.0
    pull[:] = 0.0
    for k in range(posed.P.shape[0]):
        n = pose_columns(k, posed, M, slots)
        for m in range(TORSO_COLUMNS, n):
            for i in range(ANGLES):
                if limb.slots[i] == slots[m]:
                    angle[m - TORSO_COLUMNS] = i
        add_capsule(sums, k, M[:, TORSO_COLUMNS:], angle, n - TORSO_COLUMNS, work, own, pull)
    mirror_upper(own)


@njit(cache=True)
def _rays_gained(left, posed, costs):
    """Return the rays that the limb explains at a wide gate: the fall of the costs by it."""
    _gains(match_rays(left.rays, posed, SLACK_M).separation, left.coarse, COARSE_GATE_M, costs)
    gain = 0.0
    for i in range(costs.shape[0]):
        gain += max(costs[i], 0.0)
    return gain


@njit(cache=True, error_model="numpy")  # a check for zero would keep it from being vectorised
def _gains(separation, cost_without, gate, gains):
    """gains (n,) <- cost of each ray without the limb less its cost with it."""
    for i in range(gains.shape[0]):
        gains[i] = cost_without[i] - ray_cost(separation[i], gate)


@njit(cache=True)
def _samples(left, posed, lower, costs):
    """Return the number of cells of the limb's surface that show in rays which only the limb explains; at most twice
    those of its ``lower`` (k,) bool capsules, as an elbow does not show where the hand is.

    costs (n,) : scratch.
    """
    match, shown = match_rays(left.rays, posed, SLACK_M), np.zeros((posed.P.shape[0], CELLS))
    _gains(match.separation, left.fine, GATE_M, costs)
    for i in range(costs.shape[0]):
        if costs[i] > 0.0:
            cell = cell_of_ray(posed, match.capsule[i], match.along[i], left.rays.rows, i)
            shown[cell // CELLS, cell % CELLS] += costs[i] / RAYS_PER_NAT
    shown = np.minimum(shown, 1.0)
    return min(shown.sum(), 2.0 * shown[lower].sum())


@njit(cache=True)
def _odds_unexplained(left, gains):
    """Return the ratio of unexplained to explained rays; ``gains`` (n,) : by the limb."""
    unexplained = 0.0
    for i in range(gains.shape[0]):
        unexplained += left.fine[i] - max(gains[i], 0.0)
    return unexplained / max(gains.shape[0] - unexplained, 1.0)


@njit(cache=True)
def _ends(posed, limb):
    """Return elbow and hand, or knee and foot (2, 3)."""
    ends = np.empty((2, 3))
    ends[0], ends[1] = posed.B[limb.upper], posed.B[limb.lower]
    return ends


# --- the data that the body without the limb does not explain, within the limb's reach


class UnexplainedData(NamedTuple):
    """Contour rays (n,) within reach of a limb that the rest of the body does not explain.

    coarse, fine (n,) : cost of each without the limb, at a wide gate and at the usual one.
    """

    rays: RayArrays
    coarse: np.ndarray
    fine: np.ndarray


@njit(cache=True)
def unexplained_data(data, matched, state, figure, limb):
    """Return the data that the body without the limb does not explain."""
    rays, posed, own = data.contour_rays, place(state, part_of(figure, limb, False)), _is_of_limb(figure, limb)
    without, root = _rays_without(rays, matched, posed, own), posed.A[limb.upper].copy()
    reach = figure.lengths[limb.upper] + figure.lengths[limb.lower] + COARSE_GATE_M
    chosen, count = np.empty(without.shape[0], np.int64), 0
    for i in range(without.shape[0]):
        if without[i] > EXPLAINED_BY_BODY_M and _distance_of_ray(rays.rows, i, root) < reach:
            chosen[count] = i
            count += 1
    chosen = chosen[:count]
    left = without[chosen]
    return UnexplainedData(
        RayArrays(rays_at(rays, chosen).rows, np.ones(count)), ray_cost(left, COARSE_GATE_M), ray_cost(left, GATE_M)
    )


@njit(cache=True)
def _rays_without(rays, match, posed, own):
    """Return the separation (n,) of the rays from a body without its ``own`` (k,) bool capsules; only rays that were
    matched to one of these change."""
    separation, again = match.separation.copy(), np.flatnonzero(own[match.capsule])
    separation[again] = match_rays(rays_at(rays, again), posed, SLACK_M).separation
    return separation


@njit(cache=True)
def _distance_of_ray(rows, i, point):
    """Return the distance of a point from a ray's line."""
    across = rows[NORMAL, i] * point[0] + rows[NORMAL + 1, i] * point[1] + rows[NORMAL + 2, i] * point[2]
    along = rows[ALONG, i] * point[0] + rows[ALONG + 1, i] * point[1] + rows[ALONG + 2, i] * point[2]
    return math.hypot(across - rows[NORMAL + 3, i], along - rows[ALONG + 3, i])


@njit(cache=True)
def _is_of_limb(figure, limb):
    """Return which capsules (k,) bool are the limb's."""
    return (figure.surface.stick == limb.upper) | (figure.surface.stick == limb.lower)


@njit(cache=True)
def part_of(figure, limb, own):
    """Return the model with the limb's surface alone (``own``), or with all but the limb's."""
    surface, rows = figure.surface, np.flatnonzero(_is_of_limb(figure, limb) == own)
    part = BodySurface(surface.stick[rows], surface.start[rows], surface.end[rows], surface.radii[rows])
    return BodyModel(figure.lengths, figure.origins, part)
