"""Step 4: bundle adjustment. All poses of cameras and targets at once, so that the corners fit best.

    minimise over cameras, poses [scales, lenses, warps]  sum rho(|pixel - predicted| / sigma)  [+ |shared - prior|^2]

with rho Huber's loss at 3 standard deviations, by Levenberg-Marquardt with iteratively reweighted least squares. The
scale of sigma is estimated from the residuals themselves (their median), because what detectors and lenses really do
is not known beforehand. Every corner depends on what is shared (cameras, lenses, targets: tens of unknowns) and on one
pose of one target (hundreds of poses, six unknowns each, none of which meets another), so that poses are eliminated:
with U, V and W the blocks of J^T J by shared, by pose and mixed,
(U - sum W V^-1 W^T) d_shared = g_shared - sum W V^-1 g_pose  (Schur complement; Triggs et al. 2000, section 6.1).
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from capture_rig.lens import Array

from .state import POSE, Bools, Layout, Linearised, Observations, State, linearise, residuals_px

# Thresholds: from the normal distribution (99 % efficiency); the least scale: judgement.
HUBER = 3.0  # standard deviations: corners with normal noise are hardly weighed down; beyond, something is wrong
RAYLEIGH_MEDIAN = math.sqrt(2 * math.log(2))  # the median length of a two-dimensional residual of unit variance
MIN_SCALE_PX = 0.002
ROUNDS = 4
TINY = 1e-9  # of the trace: keeps the turn of a wand about itself, which no picture shows, from being divided by zero


@dataclass(frozen=True)
class StopCriterion:
    """When to stop: after so many iterations, or when the cost falls by less than this share of itself."""

    iterations: int
    decrease: float


CONVERGED = StopCriterion(40, 1e-10)
ROUGHLY = StopCriterion(8, 1e-4)  # enough to see what contradicts the rest


@dataclass(frozen=True, eq=False)
class FreeUnknowns:
    """What may move: shared (d,) unknowns and poses (m,) of targets. What fixes the frame is not free."""

    shared: Bools
    poses: Bools


@dataclass(frozen=True, eq=False)
class Prior:
    """What is known of the shared unknowns beforehand: mean (d,) as laid out ``with_lens``, information (d, d)."""

    mean: Array
    information: Array


@dataclass(frozen=True, eq=False)
class Adjusted:
    """The adjusted state; ``scale``: the corners' standard deviations are that many times those given."""

    state: State
    scale: float


def adjust(
    state: State,
    seen: Observations,
    layout: Layout,
    free: FreeUnknowns,
    prior: Prior | None = None,
    stop: StopCriterion = CONVERGED,
) -> Adjusted:
    """Adjust robustly, estimating the scale of the noise and the state in turns."""
    scale = noise_scale(state, seen)
    for _ in range(ROUNDS):
        state = _levenberg_marquardt(state, seen.weighted(np.array(1 / scale)), layout, free, prior, stop)
        before, scale = scale, noise_scale(state, seen)
        if abs(scale - before) < 0.01 * before:
            break
    return Adjusted(state, scale)


def noise_scale(state: State, seen: Observations) -> float:
    """Estimate the residuals' standard deviation over the one given, by the median: outliers do not count."""
    corners = seen.weight > 0
    floor = MIN_SCALE_PX * float(np.median(seen.weight[corners]))
    return max(float(np.median(normalised_lengths(state, seen)[corners])) / RAYLEIGH_MEDIAN, floor)


def normalised_lengths(state: State, seen: Observations) -> Array:
    """Compute the (s, n) lengths of the residuals in standard deviations; 0 where there is no corner."""
    with np.errstate(invalid="ignore"):
        lengths = np.linalg.norm(residuals_px(state, seen), axis=2) * seen.weight
    return np.where(seen.weight > 0, lengths, 0.0)


def robust_rows(state: State, seen: Observations, with_lens: bool) -> Linearised:
    """Linearise the residuals, corners beyond Huber's limit weighed down so that least squares gives his estimate."""
    linear = linearise(state, seen, with_lens)
    lengths = np.linalg.norm(linear.residual.reshape(len(linear.residual), -1, 2), axis=2)
    root = np.repeat(np.sqrt(np.minimum(1.0, HUBER / np.maximum(lengths, 1e-300))), 2, axis=1)
    return Linearised(root * linear.residual, root[..., None] * linear.by_shared, root[..., None] * linear.by_pose)


def _levenberg_marquardt(
    state: State, seen: Observations, layout: Layout, free: FreeUnknowns, prior: Prior | None, stop: StopCriterion
) -> State:
    damping, cost = 1e-4, _cost(state, seen, layout, prior)
    if not np.isfinite(cost):
        return state
    for _ in range(stop.iterations):
        linear = robust_rows(state, seen, layout.with_lens)
        equations = with_prior(normal_equations(linear, seen, layout, len(free.poses)), prior, state, layout)
        while True:
            trial = state.moved(*step(equations, free, damping))
            trial_cost = _cost(trial, seen, layout, prior)
            if trial_cost <= cost:
                break
            damping *= 10
            if damping > 1e8:
                return state
        gained, state, cost, damping = cost - trial_cost, trial, trial_cost, max(damping / 10, 1e-12)
        if gained <= stop.decrease * cost:
            break
    return state


def _cost(state: State, seen: Observations, layout: Layout, prior: Prior | None) -> float:
    if not (np.all(state.scale > 0) and np.all(state.lens[:, :2] > 0)):
        return np.inf
    lengths = normalised_lengths(state, seen)
    inside = np.minimum(lengths, HUBER)
    cost = float(np.sum(inside * (2 * lengths - inside)))
    if prior is not None:
        away = _shared(state, layout) - prior.mean
        cost += float(away @ prior.information @ away)
    return cost if np.isfinite(cost) else np.inf


# --- Normal equations and the elimination of the poses.


@dataclass(frozen=True, eq=False)
class NormalEquations:
    """U (d, d), W (m, d, 6), V (m, 6, 6), and the right sides g_shared (d,), g_poses (m, 6)."""

    U: Array
    W: Array
    V: Array
    g_shared: Array
    g_poses: Array


@dataclass(frozen=True, eq=False)
class Reduced:
    """The same after elimination: S (f, f) and b (f,) of the free shared unknowns, and V^-1 (m, 6, 6)."""

    S: Array
    b: Array
    V_inverse: Array


def normal_equations(linear: Linearised, seen: Observations, layout: Layout, poses: int) -> NormalEquations:
    """Sum the normal equations of all detections; a camera sees each pose of a target once."""
    products = _products(linear)
    size, k = layout.size, layout.width + layout.target_width
    U, W, V = np.zeros((size, size)), np.zeros((poses, size, POSE)), np.zeros((poses, POSE, POSE))
    g_shared, g_poses = np.zeros(size), np.zeros((poses, POSE))
    pairs = seen.camera * layout.targets + seen.target
    for pair in np.unique(pairs):  # those of one camera and target have the same columns
        rows = np.flatnonzero(pairs == pair)
        columns, pose = layout.columns(seen.camera[rows[:1]], seen.target[rows[:1]])[0], seen.pose[rows]
        total = products[rows].sum(axis=0)
        U[np.ix_(columns, columns)] += total[:k, :k]
        g_shared[columns] += total[:k, -1]
        W[pose[:, None], columns] += products[rows, :k, k:-1]
        V[pose] += products[rows, k:-1, k:-1]
        g_poses[pose] += products[rows, k:-1, -1]
    return NormalEquations(U, W, V, g_shared, g_poses)


def with_prior(equations: NormalEquations, prior: Prior | None, state: State, layout: Layout) -> NormalEquations:
    """Add what is known of the shared unknowns beforehand."""
    if prior is None:
        return equations
    g = equations.g_shared + prior.information @ (prior.mean - _shared(state, layout))
    return replace(equations, U=equations.U + prior.information, g_shared=g)


def reduce(equations: NormalEquations, free: FreeUnknowns, damping: float = 0.0) -> Reduced:
    """Eliminate the poses; ``damping`` as in Levenberg-Marquardt, relative to the diagonals."""
    V_inverse = np.asarray(_inverses(equations.V, damping) * free.poses[:, None, None], float)
    W = equations.W[:, free.shared]
    U = equations.U[np.ix_(free.shared, free.shared)]
    flat = np.swapaxes(W, 0, 1).reshape(W.shape[1], POSE * len(W))
    weighted = np.swapaxes(W @ V_inverse, 0, 1).reshape(W.shape[1], POSE * len(W))
    S = U + damping * np.diag(np.diag(U)) - weighted @ flat.T
    return Reduced(S, equations.g_shared[free.shared] - weighted @ equations.g_poses.ravel(), V_inverse)


def step(equations: NormalEquations, free: FreeUnknowns, damping: float) -> tuple[Array, Array]:
    """Solve for the damped Gauss-Newton step: shared (d,), poses (m, 6)."""
    reduced = reduce(equations, free, damping)
    shared = np.zeros(len(free.shared))
    shared[free.shared] = np.linalg.lstsq(reduced.S, reduced.b, rcond=None)[0]
    rest = equations.g_poses - np.swapaxes(equations.W, 1, 2) @ shared
    return shared, (reduced.V_inverse @ rest[..., None])[..., 0]


def information_of_each(linear: Linearised) -> tuple[Array, Array]:
    """Compute what each detection says of its shared unknowns, its own pose eliminated: information (s, k, k) and
    gradient (s, k), in the columns of ``by_shared``. Their sums are S and b where no pose is seen by two cameras."""
    products = _products(linear)
    k = products.shape[1] - POSE - 1
    weighted = products[:, :k, k:-1] @ _inverses(products[:, k:-1, k:-1])
    eliminated = products[:, :k] - weighted @ products[:, k:-1]
    return eliminated[:, :, :k], eliminated[:, :, -1]


def _products(linear: Linearised) -> Array:
    """Return (s, k + 7, k + 7) of each detection: J^T J with the residual as the last column."""
    J = np.concatenate([linear.by_shared, linear.by_pose, linear.residual[..., None]], axis=2)
    return np.swapaxes(J, 1, 2) @ J


def _inverses(V: Array, damping: float = 0.0) -> Array:
    floor = TINY * np.trace(V, axis1=1, axis2=2)[:, None, None] + 1e-300
    return np.linalg.inv(V + (damping * V + floor) * np.eye(POSE))


def _shared(state: State, layout: Layout) -> Array:
    """Lenses, scales and warps as laid out, zeros for the poses of cameras (no prior speaks of those)."""
    by_camera = np.zeros((layout.cameras, layout.width))
    by_camera[:, POSE:] = state.lens if layout.with_lens else 0.0
    by_target = np.column_stack([state.scale, state.board_warp])[:, : layout.target_width]
    return np.concatenate([by_camera.ravel(), by_target.ravel()])
