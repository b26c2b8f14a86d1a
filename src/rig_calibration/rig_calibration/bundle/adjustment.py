"""Step 4: bundle adjustment. All poses of cameras and targets at once, so that the corners fit best.

    minimise over cameras, poses [scales, lenses, warps]  sum rho(|pixel - predicted| / sigma)  [+ |shared - prior|^2]

with rho Huber's loss at 3 standard deviations, by Levenberg-Marquardt with iteratively reweighted least squares. The
scale of sigma is estimated from the residuals themselves (their median), because the errors of detectors and lenses are
not known beforehand. Every corner depends on shared unknowns (cameras, lenses, targets: tens of them) and on one pose
of one target (hundreds of poses, six unknowns each, not coupled to each other), so that poses are eliminated: with U, V
and W the blocks of J^T J by shared, by pose and mixed,
(U - sum W V^-1 W^T) d_shared = g_shared - sum W V^-1 g_pose  (Schur complement; Triggs et al. 2000, section 6.1).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from capture_rig.lens import NEGLIGIBLE, Array

from ..boards.x_corner import CONVERGED_PX
from .state import POSE, Bools, BundleState, LinearisedRows, Observations, linearise, residuals_px

# Threshold: from the normal distribution (99 % efficiency).
HUBER = 3.0  # standard deviations: corners with normal noise are hardly weighed down; beyond, something is wrong
RAYLEIGH_MEDIAN = math.sqrt(2 * math.log(2))  # the median length of a two-dimensional residual of unit variance
ROUNDS, ITERATIONS = 4, 40
DECREASE = 1e-10  # of the cost, as a share: less than that, and the iterations end


@dataclass(frozen=True, eq=False)
class FreeUnknowns:
    """What may move: shared (d,) unknowns and poses (m,) of targets. What fixes the frame is not free."""

    shared: Bools
    poses: Bools


@dataclass(frozen=True, eq=False)
class Prior:
    """What is known of the shared unknowns beforehand: mean (d,) as laid out, information (d, d)."""

    mean: Array
    information: Array


def adjust(state: BundleState, seen: Observations, free: FreeUnknowns, prior: Prior) -> tuple[BundleState, float]:
    """Adjust robustly, estimating the state and the scale of the noise (the corners' standard deviations are that many
    times those given) in turns."""
    scale = noise_scale(state, seen)
    for _ in range(ROUNDS):
        state = _levenberg_marquardt(state, seen.weighted(np.array(1 / scale)), free, prior)
        before, scale = scale, noise_scale(state, seen)
        if abs(scale - before) < 0.01 * before:
            break
    return state, scale


def noise_scale(state: BundleState, seen: Observations) -> float:
    """Estimate the residuals' standard deviation over the one given, by the median: outliers do not count. No less
    than corners are fitted to."""
    corners = seen.weight > 0
    floor = CONVERGED_PX * float(np.median(seen.weight[corners]))
    return max(float(np.median(normalised_lengths(state, seen)[corners])) / RAYLEIGH_MEDIAN, floor)


def normalised_lengths(state: BundleState, seen: Observations) -> Array:
    """Compute the (s, n) lengths of the residuals in standard deviations; 0 where there is no corner."""
    with np.errstate(invalid="ignore"):
        lengths = np.linalg.norm(residuals_px(state, seen), axis=2) * seen.weight
    return np.where(seen.weight > 0, lengths, 0.0)


def robust_rows(state: BundleState, seen: Observations) -> LinearisedRows:
    """Linearise the residuals, corners beyond Huber's limit weighed down so that least squares gives his estimate."""
    linear = linearise(state, seen)
    lengths = np.linalg.norm(linear.residual.reshape(len(linear.residual), -1, 2), axis=2)
    root = np.repeat(np.sqrt(np.minimum(1.0, HUBER / np.maximum(lengths, 1e-300))), 2, axis=1)
    return LinearisedRows(root * linear.residual, root[..., None] * linear.by_shared, root[..., None] * linear.by_pose)


def _levenberg_marquardt(state: BundleState, seen: Observations, free: FreeUnknowns, prior: Prior) -> BundleState:
    damping, cost = 1e-4, _cost(state, seen, prior)
    if not np.isfinite(cost):
        return state
    for _ in range(ITERATIONS):
        equations = normal_equations(robust_rows(state, seen), seen, state, prior)
        while True:
            trial = state.moved(*step(equations, free, damping))
            trial_cost = _cost(trial, seen, prior)
            if trial_cost <= cost:
                break
            damping *= 10
            if damping > 1e8:
                return state
        gained, state, cost, damping = cost - trial_cost, trial, trial_cost, max(damping / 10, 1e-12)
        if gained <= DECREASE * cost:
            break
    return state


def _cost(state: BundleState, seen: Observations, prior: Prior) -> float:
    if not (np.all(state.scale > 0) and np.all(state.lens[:, :2] > 0)):
        return np.inf
    lengths = normalised_lengths(state, seen)
    inside = np.minimum(lengths, HUBER)
    away = shared_of(state) - prior.mean
    cost = float(np.sum(inside * (2 * lengths - inside)) + away @ prior.information @ away)
    return cost if np.isfinite(cost) else np.inf


# --- Normal equations and the elimination of the poses.


class NormalEquations(NamedTuple):
    """By pose, U (m, d, d), W (m, d, 6), V (m, 6, 6), and the right sides g_shared (m, d), g_poses (m, 6); the prior of
    the shared unknowns: prior_U (d, d), prior_g (d,)."""

    U: Array
    W: Array
    V: Array
    g_shared: Array
    g_poses: Array
    prior_U: Array
    prior_g: Array


class Reduced(NamedTuple):
    """What is left of each pose after its elimination, of the shared unknowns: information (m, d, d) and score (m, d),
    0 for those that are held fixed; and V^-1 (m, 6, 6)."""

    information: Array
    score: Array
    V_inverse: Array


def normal_equations(linear: LinearisedRows, seen: Observations, state: BundleState, prior: Prior) -> NormalEquations:
    """Sum the normal equations of all detections by pose; a camera sees each pose of a target once."""
    J = np.concatenate([linear.by_shared, linear.by_pose, linear.residual[..., None]], axis=2)
    products = np.swapaxes(J, 1, 2) @ J
    layout = state.layout
    d, pairs = layout.size, seen.camera * layout.targets + seen.target
    N = np.zeros((len(state.position), d + POSE + 1, d + POSE + 1))
    for pair in np.unique(pairs):  # those of one camera and target have the same columns
        rows = np.flatnonzero(pairs == pair)
        shared = layout.columns(seen.camera[rows[:1]], seen.target[rows[:1]])[0]
        columns = np.append(shared, np.arange(d, d + POSE + 1))
        N[seen.pose[rows][:, None, None], columns[:, None], columns] += products[rows]
    pull = prior.information @ (prior.mean - shared_of(state))
    W, V = N[:, :d, d:-1], N[:, d:-1, d:-1]
    return NormalEquations(N[:, :d, :d], W, V, N[:, :d, -1], N[:, d:-1, -1], prior.information, pull)


def reduce(equations: NormalEquations, free: FreeUnknowns, damping: float = 0.0) -> Reduced:
    """Eliminate the poses; ``damping`` as in Levenberg-Marquardt, relative to the diagonals."""
    # the turn of a wand about itself, which no picture shows, is not divided by zero
    floor = NEGLIGIBLE * np.trace(equations.V, axis1=1, axis2=2)[:, None, None] + 1e-300
    V_inverse = np.linalg.inv(equations.V + (damping * equations.V + floor) * np.eye(POSE))
    V_inverse = V_inverse * free.poses[:, None, None]
    weighted = equations.W @ V_inverse
    information = equations.U - weighted @ np.swapaxes(equations.W, 1, 2)
    score = equations.g_shared - (weighted @ equations.g_poses[..., None])[..., 0]
    return Reduced(information * np.outer(free.shared, free.shared), score * free.shared, V_inverse)


def step(equations: NormalEquations, free: FreeUnknowns, damping: float) -> tuple[Array, Array]:
    """Solve for the damped Gauss-Newton step: shared (d,), poses (m, 6)."""
    reduced, moving = reduce(equations, free, damping), np.ix_(free.shared, free.shared)
    U = equations.U.sum(axis=0) + equations.prior_U
    S = (reduced.information.sum(axis=0) + equations.prior_U + damping * np.diag(np.diag(U)))[moving]
    shared = np.zeros(len(free.shared))
    score = (reduced.score.sum(axis=0) + equations.prior_g)[free.shared]
    shared[free.shared] = np.linalg.lstsq(S, score, rcond=None)[0]
    rest = equations.g_poses - np.swapaxes(equations.W, 1, 2) @ shared
    return shared, (reduced.V_inverse @ rest[..., None])[..., 0]


def shared_of(state: BundleState) -> Array:
    """Return lenses, scales and warps as laid out, with zeros for the poses of cameras, which have no prior."""
    by_camera = np.hstack([np.zeros((len(state.lens), POSE)), state.lens])
    return np.concatenate([by_camera.ravel(), np.column_stack([state.scale, state.board_warp]).ravel()])
