"""Other places for one limb: every pose of its library against the rays that the rest of the body leaves over."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numba import njit

from stick_figure.body import Body
from stick_figure.pose import Pose

from ..figure_arrays import Figure, State
from ..flesh import Flesh
from ..gauss_newton import Rims
from ..rim_term import match_rims
from .evidence import GATE_M, SLACK_M, place
from .hull_map import HullMap
from .limb_library import Limb, LimbPoses
from .limb_refine import is_held, place_limb, rays_gained, refine_limb

COARSE_GATE_M = 0.12  # the library is coarse: an elbow may be 80 mm off
OPEN_M = 0.03  # a ray that the rest of the body passes so near has no need of the limb
APART_M = 0.12  # hands or feet (and elbows or knees) so near to each other are the same place
REFINED = 6  # of the library, the poses that are looked at more closely
LEAST_LEAD = -4.0  # rays that another place must explain more than this one, to be worth a fit (which finds some more)


def other_place(
    body: Body, flesh: Flesh, pose: Pose, limb: Limb, library: LimbPoses, rims: Rims, hull: HullMap
) -> Pose | None:
    """The best pose that differs from ``pose`` in one limb alone and puts it elsewhere, if it may explain more."""
    mine = (flesh.stick == limb.upper) | (flesh.stick == limb.lower)
    rest, own = _chosen(flesh, ~mine), _chosen(flesh, mine)
    figure = Figure.of(body)
    R, flexion = pose.R_joints[limb.ball].copy(), np.array([pose.hinges[limb.hinge]])
    lead = _search(
        *State.of(pose),
        figure,
        rest,
        own,
        limb.upper,
        figure.lengths[[limb.upper, limb.lower]],
        limb.is_arm,
        library.R,
        library.flexion,
        rims,
        hull,
        R,
        flexion,
    )
    return None if lead < LEAST_LEAD else with_limb(pose, limb, R, float(flexion[0]))


def with_limb(pose: Pose, limb: Limb, R: np.ndarray, flexion: float) -> Pose:
    """The pose with one limb elsewhere: upper limb to torso ``R``, hinge ``flexion`` (rad)."""
    R_joints, hinges = pose.R_joints.copy(), pose.hinges.copy()
    R_joints[limb.ball], hinges[limb.hinge] = R, flexion
    return replace(pose, R_joints=R_joints, hinges=hinges)


def _chosen(flesh: Flesh, rows: np.ndarray) -> Flesh:
    return Flesh(*(np.ascontiguousarray(part[rows]) for part in flesh))


@njit(cache=True)
def _search(t0, R0, RJ, hinges, figure, rest, own, upper, lengths, is_arm, tried_R, tried, rims, hull, R, flexion):
    """The best of the library that lies elsewhere, refined, into R (3, 3) and flexion (1,), which hold the limb's own.

    Returns the rays that it explains beyond those that the limb explains now; -inf when there is none.
    """
    A, left_over, without = _without_limb(t0, R0, RJ, hinges, figure, rest, rims, upper, lengths)
    shoulder, m, k = A[upper], without.shape[0], own.stick.shape[0]
    match = (np.zeros(m, np.int64), np.zeros(m), np.empty(m), np.empty(m))
    frames, ends, P, Q = np.empty((2, 3, 3)), np.empty((2, 3)), np.empty((k, 3)), np.empty((k, 3))
    place_limb(R0, R, flexion[0], is_arm, shoulder, lengths, own, upper, frames, ends, P, Q)
    match_rims(left_over, P, Q, own.radii, SLACK_M, match)
    now, gain_now = ends.copy(), rays_gained(match[3], without, GATE_M)
    gains = np.zeros(tried.shape[0])
    for h in range(tried.shape[0]):
        place_limb(R0, tried_R[h], tried[h], is_arm, shoulder, lengths, own, upper, frames, ends, P, Q)
        if is_held(shoulder, ends, hull):
            match_rims(left_over, P, Q, own.radii, SLACK_M, match)
            gains[h] = rays_gained(match[3], without, COARSE_GATE_M)
    best = -np.inf
    for h in np.argsort(-gains)[:REFINED]:
        if gains[h] <= 0.0:
            break
        turned = tried_R[h].copy()
        bent = refine_limb(
            R0, shoulder, own, upper, lengths, is_arm, left_over, turned, tried[h], (match, frames, ends, P, Q)
        )
        gain = rays_gained(match[3], without, GATE_M)
        if gain > best and is_held(shoulder, ends, hull) and _apart(ends, now):
            best, flexion[0] = gain, bent
            R[:] = turned
    return best - gain_now


@njit(cache=True)
def _apart(ends, others):
    """Whether two limbs' ends (2, 3) are in different places."""
    first, second = 0.0, 0.0
    for i in range(3):
        first += (ends[0, i] - others[0, i]) ** 2
        second += (ends[1, i] - others[1, i]) ** 2
    return max(first, second) > APART_M**2


@njit(cache=True)
def _without_limb(t0, R0, RJ, hinges, figure, rest, rims, upper, lengths):
    """Stick starts (10, 3), the rays that the limb could touch and the rest of the body leaves over, and how far that
    rest passes from each."""
    k, n = rest.stick.shape[0], rims.information.shape[0]
    A, B, P, Q = np.empty((10, 3)), np.empty((10, 3)), np.empty((k, 3)), np.empty((k, 3))
    place(t0, R0, RJ, hinges, figure, rest, A, B, P, Q)
    misfit = np.empty(n)
    match_rims(rims, P, Q, rest.radii, SLACK_M, (np.zeros(n, np.int64), np.zeros(n), np.empty(n), misfit))
    rows, count = np.empty(n, np.int64), 0
    reach = lengths[0] + lengths[1] + COARSE_GATE_M
    for i in range(n):
        squared, along = 0.0, 0.0
        for q in range(3):
            d = A[upper, q] - rims.points[q, i]
            squared += d * d
            along += d * rims.directions[q, i]
        if misfit[i] > OPEN_M and squared - along * along < reach * reach:
            rows[count] = i
            count += 1
    rows = rows[:count]
    left_over = Rims(
        np.ascontiguousarray(rims.points[:, rows]),
        np.ascontiguousarray(rims.directions[:, rows]),
        np.ascontiguousarray(rims.normals[:, rows]),
        np.ascontiguousarray(rims.tangents[:, rows]),
        rims.half_lengths[rows],
        rims.information[rows],
    )
    return A, left_over, misfit[rows]
