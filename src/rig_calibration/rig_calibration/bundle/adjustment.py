"""Step 4: bundle adjustment. All poses of cameras and targets at once, so that the corners fit best.

    minimise over cameras, poses [and scales, lenses]  sum rho(|pixel - predicted| / sigma)  [+ |lens - prior|^2]

with rho Huber's loss at 3 standard deviations, by Levenberg-Marquardt with iteratively reweighted least squares. The
scale of sigma is estimated from the residuals themselves (their median), because what detectors and lenses really do
is not known beforehand.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from .projection import Linearised, linearise, residuals_px
from .rigid import Array
from .state import Layout, Observations, State

# --- The normal equations of the adjustment, the targets' poses eliminated (Schur complement).
#
# Every corner depends on what is shared (cameras, lenses, scales: tens of unknowns) and on one pose of one target
# (hundreds of poses, six unknowns each, none of which meets another): with U, V and W the blocks of J^T J by shared, by
# pose and mixed,  (U - sum W V^-1 W^T) d_shared = g_shared - sum W V^-1 g_pose  (Triggs et al. 2000, section 6.1).

TINY = 1e-10  # keeps the turn of a wand about itself, which no picture shows, from being divided by zero

Bools = npt.NDArray[np.bool_]


@dataclass(frozen=True, eq=False)
class FreeUnknowns:
    """What may move: shared (d,) unknowns and poses (m,) of targets. What fixes the frame is not free."""

    shared: Bools
    poses: Bools


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
    """Sums of all detections, which are few enough in width to multiply one by one."""
    J = np.concatenate([linear.by_shared, linear.by_pose, linear.residual[..., None]], axis=2)
    products = np.swapaxes(J, 1, 2) @ J
    k = layout.width + 1
    columns, size = layout.columns(seen.camera, seen.target), layout.size
    U, W, V = np.zeros((size, size)), np.zeros((poses, size, 6)), np.zeros((poses, 6, 6))
    g_shared, g_poses = np.zeros(size), np.zeros((poses, 6))
    np.add.at(U, (columns[:, :, None], columns[:, None, :]), products[:, :k, :k])
    np.add.at(W, (seen.pose[:, None], columns), products[:, :k, k : k + 6])
    np.add.at(V, seen.pose, products[:, k : k + 6, k : k + 6])
    np.add.at(g_shared, columns, products[:, :k, -1])
    np.add.at(g_poses, seen.pose, products[:, k : k + 6, -1])
    return NormalEquations(U, W, V, g_shared, g_poses)


def reduce(equations: NormalEquations, free: FreeUnknowns, damping: float = 0.0) -> Reduced:
    """Eliminate the poses; ``damping`` as in Levenberg-Marquardt, relative to the diagonals."""
    V = equations.V.copy()
    diagonal = np.arange(6)
    floor = TINY * np.trace(V, axis1=1, axis2=2)[:, None] + 1e-300
    V[:, diagonal, diagonal] += damping * V[:, diagonal, diagonal] + floor
    V_inverse = np.asarray(np.linalg.inv(V) * free.poses[:, None, None], float)
    W = equations.W[:, free.shared]
    U = equations.U[np.ix_(free.shared, free.shared)]
    flat = np.swapaxes(W, 0, 1).reshape(W.shape[1], 6 * len(V))
    weighted = np.swapaxes(W @ V_inverse, 0, 1).reshape(W.shape[1], 6 * len(V))
    S = U + damping * np.diag(np.diag(U)) - weighted @ flat.T
    return Reduced(S, equations.g_shared[free.shared] - weighted @ equations.g_poses.ravel(), V_inverse)


def step(equations: NormalEquations, free: FreeUnknowns, damping: float) -> tuple[Array, Array]:
    """The damped Gauss-Newton step: shared (d,), poses (m, 6)."""
    reduced = reduce(equations, free, damping)
    shared = np.zeros(len(free.shared))
    shared[free.shared] = np.linalg.lstsq(reduced.S, reduced.b, rcond=None)[0]
    rest = equations.g_poses - np.swapaxes(equations.W, 1, 2) @ shared
    return shared, (reduced.V_inverse @ rest[..., None])[..., 0]


HUBER = 3.0  # standard deviations
RAYLEIGH_MEDIAN = 1.1774  # the median length of a two-dimensional residual of unit variance
MIN_SCALE_PX = 0.002
ROUNDS = 4


@dataclass(frozen=True)
class StopCriterion:
    """When to stop: after so many iterations, or when the cost falls by less than this share of itself."""

    iterations: int
    decrease: float


CONVERGED = StopCriterion(40, 1e-10)
ROUGHLY = StopCriterion(8, 1e-4)  # enough to see what contradicts the rest


@dataclass(frozen=True, eq=False)
class Prior:
    """What is known of the shared unknowns beforehand: mean (d,) as laid out, information (d, d)."""

    mean: Array
    information: Array


@dataclass(frozen=True, eq=False)
class Adjusted:
    """The adjusted state; ``scale``: the corners' standard deviations are that many times those given."""

    state: State
    scale: float
    iterations: int


def adjust(
    state: State,
    seen: Observations,
    layout: Layout,
    free: FreeUnknowns,
    prior: Prior | None = None,
    stop: StopCriterion = CONVERGED,
) -> Adjusted:
    """Adjust robustly, estimating the scale of the noise and the state in turns."""
    scale, iterations = noise_scale(state, seen), 0
    for _ in range(ROUNDS):
        state, used = _levenberg_marquardt(state, seen.weighted(np.array(1 / scale)), layout, free, prior, stop)
        before, scale, iterations = scale, noise_scale(state, seen), iterations + used
        if abs(scale - before) < 0.01 * before:
            break
    return Adjusted(state, scale, iterations)


def noise_scale(state: State, seen: Observations) -> float:
    """The residuals' standard deviation over the one given, by the median: outliers do not count."""
    lengths = np.linalg.norm(residuals_px(state, seen), axis=2)
    corners = seen.weight > 0
    floor = MIN_SCALE_PX * float(np.median(seen.weight[corners]))
    return max(float(np.median((lengths * seen.weight)[corners])) / RAYLEIGH_MEDIAN, floor)


def huber_weights(lengths: Array) -> Array:
    """Weights of squared residuals that make least squares Huber's estimate."""
    return np.minimum(1.0, HUBER / np.maximum(lengths, 1e-300))


def normalised_lengths(state: State, seen: Observations) -> Array:
    """(s, n) lengths of the residuals in standard deviations; 0 where there is no corner."""
    with np.errstate(invalid="ignore"):
        lengths = np.linalg.norm(residuals_px(state, seen), axis=2) * seen.weight
    return np.where(seen.weight > 0, lengths, 0.0)


def robust_equations(
    state: State, seen: Observations, layout: Layout, poses: int, prior: Prior | None = None
) -> NormalEquations:
    """The normal equations at a state, corners beyond Huber's limit weighed down."""
    weighted = seen.weighted(np.sqrt(huber_weights(normalised_lengths(state, seen))))
    equations = normal_equations(linearise(state, weighted, layout.with_lens), weighted, layout, poses)
    return with_prior(equations, prior, state, layout)


def with_prior(equations: NormalEquations, prior: Prior | None, state: State, layout: Layout) -> NormalEquations:
    """What is known of the lenses beforehand, added."""
    if prior is None:
        return equations
    U = equations.U + prior.information
    g = equations.g_shared + prior.information @ (prior.mean - _shared(state, layout))
    return NormalEquations(U, equations.W, equations.V, g, equations.g_poses)


def fixed_camera(layout: Layout, poses: int, camera: int, scales: Bools, lenses: Bools | None = None) -> FreeUnknowns:
    """Everything moves but one camera, and but the scales and lens parameters (c, 12) that are not marked."""
    shared = np.ones(layout.size, bool)
    shared[layout.camera(camera)] = False
    for index in range(layout.cameras if layout.with_lens else 0):
        shared[layout.lens(index)] = False if lenses is None else lenses[index]
    shared[layout.size - layout.targets :] = scales
    return FreeUnknowns(shared, np.ones(poses, bool))


def _levenberg_marquardt(
    state: State, seen: Observations, layout: Layout, free: FreeUnknowns, prior: Prior | None, stop: StopCriterion
) -> tuple[State, int]:
    damping, cost = 1e-4, _cost(state, seen, layout, prior)
    if not np.isfinite(cost):
        return state, 0
    for iteration in range(stop.iterations):
        equations = robust_equations(state, seen, layout, len(free.poses), prior)
        while True:
            trial = state.moved(*step(equations, free, damping))
            trial_cost = _cost(trial, seen, layout, prior)
            if trial_cost <= cost:
                break
            damping *= 10
            if damping > 1e8:
                return state, iteration
        gained, state, cost, damping = cost - trial_cost, trial, trial_cost, max(damping / 10, 1e-12)
        if gained <= stop.decrease * cost:
            return state, iteration + 1
    return state, stop.iterations


def _cost(state: State, seen: Observations, layout: Layout, prior: Prior | None) -> float:
    lengths = normalised_lengths(state, seen)
    inside = np.minimum(lengths, HUBER)
    cost = float(np.sum(inside * (2 * lengths - inside)))
    if prior is not None:
        away = _shared(state, layout) - prior.mean
        cost += float(away @ prior.information @ away)
    return cost if np.isfinite(cost) and np.all(state.scale > 0) else np.inf


def _shared(state: State, layout: Layout) -> Array:
    """Lenses and scales where the layout has them, zeros for the poses of cameras (no prior speaks of those)."""
    by_camera = np.zeros((layout.cameras, layout.width))
    if layout.with_lens:
        by_camera[:, 6:] = state.lens
    return np.concatenate([by_camera.ravel(), state.scale])
