"""Steps 4 and 5 together: adjust, leave out what contradicts the rest, adjust again, compare the targets' sizes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ..boards.board import TargetDetection
from .adjustment import (
    CONVERGED,
    ROUGHLY,
    Adjusted,
    Bools,
    FreeUnknowns,
    Prior,
    StopCriterion,
    adjust,
    fixed_camera,
    huber_weights,
    normal_equations,
    normalised_lengths,
    step,
    with_prior,
)
from .covariance import MIN_DOF, covariance
from .detection_poses import View
from .initial_poses import InitialPoses, with_symmetry
from .outliers import ODD_ONE, LeftOut, bad_corners, contradictions, readmissible
from .problem import Problem
from .projection import Linearised, linearise, residuals_px
from .rigid import Array, inverse
from .state import Ints, Layout, Observations, State, lens_of, observe
from .sync_error import first_tau, next_tau, pose_misfit, whitened
from .target_shape import LINE
from .view_graph import comparable_targets, most_seen

# --- The state of the solver between its steps.

NO_POSE = "its corners are too few to tell where the target was, or fit no pose of it"


@dataclass(frozen=True, eq=False)
class Fit:
    """The state of the solver: all detections, which of them still take part (``rows``), and the adjusted state.

    ``seen`` holds the observations of all detections; ``free_scales`` (k,) which targets' sizes are unknown;
    ``emphasis`` (s,) by what the weights of each detection's corners are multiplied; ``displacement`` (s,), m, how far
    (sd) the target may have been elsewhere for each detection; ``prior`` of the lenses, where these are refined.
    """

    problem: Problem
    all_detections: tuple[TargetDetection, ...]
    seen: Observations
    rows: Ints
    adjusted: Adjusted
    root: int
    free_scales: Bools
    left_out: tuple[LeftOut, ...]
    scale_of: dict[str, tuple[float, float]]
    reweighting: Array
    sync_error: Array
    prior: Prior | None = None

    @property
    def detections(self) -> tuple[TargetDetection, ...]:
        """Those that take part."""
        return tuple(self.all_detections[row] for row in self.rows)

    @property
    def used(self) -> Observations:
        return self.seen.only(self.rows).weighted(self.reweighting[self.rows, None])

    @property
    def layout(self) -> Layout:
        return Layout(len(self.problem.cameras), len(self.problem.shapes), self.prior is not None)

    @property
    def reasons(self) -> dict[str, str]:
        """By camera, the commonest reason why detections of it were left out."""
        by_camera: dict[str, list[str]] = {}
        for out in self.left_out:
            by_camera.setdefault(out.detection.camera, []).append(out.reason)
        return {name: max(sorted(set(reasons)), key=reasons.count) for name, reasons in by_camera.items()}

    def free(self, layout: Layout) -> FreeUnknowns:
        """What moves while the root camera holds the frame."""
        free = fixed_camera(layout, len(self.adjusted.state.position), self.root, self.free_scales, self._free_lenses())
        return FreeUnknowns(free.shared, np.isin(np.arange(len(free.poses)), self.seen.pose[self.rows]))

    def _free_lenses(self) -> Bools | None:
        if self.prior is None:
            return None
        return np.array([np.diag(self.problem.lens_covariance[name]) > 0 for name in self.problem.cameras])


def start_fit(problem: Problem, views: Sequence[View], initial: InitialPoses) -> Fit:
    """The first state; detections whose target has no pose yet, or lies behind their camera, are left out."""
    keys, names = problem.keys, list(problem.cameras)
    detections = tuple(with_symmetry(view, symmetry) for view, symmetry in zip(views, initial.symmetries, strict=True))
    seen = observe(detections, names, keys, problem.shapes)
    state = _first_state(problem, initial)
    placed = np.array([key in initial.T_root_target for key in keys])[seen.pose]
    in_front = (np.isfinite(residuals_px(state, seen)).all(axis=2) | (seen.weight == 0)).all(axis=1)
    keep = placed & in_front
    on_a_line = np.array([view.shape.dimension == LINE for view in views], bool)  # one view of a wand is no mishap
    left_out = tuple(
        LeftOut(detections[i], ODD_ONE if placed[i] else NO_POSE) for i in np.flatnonzero(~keep & (placed | ~on_a_line))
    )
    nothing = np.zeros(len(problem.shapes), bool)
    return Fit(
        problem,
        detections,
        seen,
        np.flatnonzero(keep),
        Adjusted(state, 1.0, 0),
        names.index(initial.root),
        nothing,
        left_out,
        {},
        np.ones(len(detections)),
        np.zeros(len(detections)),
    )


def lens_covariances(fit: Fit) -> dict[int, Array]:
    """By row of the camera, the covariance of its lens where that is known and the lens was not refined."""
    if fit.prior is not None:
        return {}
    known = fit.problem.lens_covariance
    return {row: known[name] for row, name in enumerate(fit.problem.cameras) if name in known}


def _first_state(problem: Problem, initial: InitialPoses) -> State:
    T_root_camera = inverse(np.array([initial.T_camera_root[name] for name in problem.cameras]))
    T = np.array([initial.T_root_target.get(key, np.eye(4)) for key in problem.keys])
    return State(
        np.swapaxes(T_root_camera[:, :3, :3], 1, 2),
        T_root_camera[:, :3, 3],
        np.array([lens_of(camera) for camera in problem.cameras.values()]),
        T[:, :3, :3],
        T[:, :3, 3],
        np.ones(len(problem.shapes)),
    )


# --- Detections that are believed less than their corners claim.

CLEAR = 3.0  # standard deviations above what is usual
SYNC_ERROR_ROUNDS, GAUSS_NEWTON_STEPS = 4, 2


def reweighting(fit: Fit) -> Array:
    """(s,) weights of all detections: those whose corners scatter clearly more than the others' (blurred) count less."""
    used = fit.used
    corners = np.maximum((used.weight > 0).sum(axis=1), 1)
    variance = (normalised_lengths(fit.adjusted.state, used) ** 2).sum(axis=1) / (2 * corners)
    weights = np.ones(len(fit.reweighting))
    weights[fit.rows] = np.maximum(variance / np.median(variance) / (1 + CLEAR / np.sqrt(corners)), 1.0) ** -0.5
    return weights


def estimate_sync_error(fit: Fit) -> Fit:
    """Where cameras contradict one another more than corners' noise explains, targets may have moved between them."""
    linear = _weighted_rows(fit)
    misfit, shared = pose_misfit(linear), int(fit.free(fit.layout).shared.sum())
    ratio, dof = misfit.ratio(linear.residual, int((fit.used.weight > 0).sum()), fit.used.pose, shared)
    if dof < MIN_DOF or ratio < 1 + CLEAR * np.sqrt(2 / dof):
        return fit
    tau = np.full(len(fit.rows), first_tau(linear, misfit, dof))
    for _ in range(SYNC_ERROR_ROUNDS):
        for _ in range(GAUSS_NEWTON_STEPS):
            fit = _whitened_step(fit, tau)
        tau = next_tau(tau, whitened(_weighted_rows(fit), tau), fit.used.pose)
    sync_error = np.zeros(len(fit.sync_error))
    sync_error[fit.rows] = tau
    return replace(_whitened_step(fit, tau), sync_error=sync_error)


def _weighted_rows(fit: Fit) -> Linearised:
    used = fit.used.weighted(np.array(1 / fit.adjusted.scale))
    robust = np.sqrt(huber_weights(normalised_lengths(fit.adjusted.state, used)))
    return linearise(fit.adjusted.state, used.weighted(robust), fit.layout.with_lens)


def _whitened_step(fit: Fit, tau: Array) -> Fit:
    state, layout = fit.adjusted.state, fit.layout
    equations = normal_equations(whitened(_weighted_rows(fit), tau), fit.used, layout, len(state.position))
    moved = state.moved(*step(with_prior(equations, fit.prior, state, layout), fit.free(layout), 0.0))
    return replace(fit, adjusted=replace(fit.adjusted, state=moved, iterations=fit.adjusted.iterations + 1))


# --- What is known of the lenses before they are refined.


def lens_prior(problem: Problem, state: State) -> Prior:
    """The covariances given, as a prior around the lenses of ``state``."""
    layout = Layout(len(problem.cameras), len(problem.shapes), with_lens=True)
    mean, information = np.zeros(layout.size), np.zeros((layout.size, layout.size))
    for row, name in enumerate(problem.cameras):
        block = layout.lens(row)
        mean[block] = state.lens[row]
        known = np.diag(problem.lens_covariance[name]) > 0
        inner = np.arange(layout.size)[block][known]
        information[np.ix_(inner, inner)] = _information(problem.lens_covariance[name][np.ix_(known, known)])
    return Prior(mean, information)


def _information(Sigma: Array) -> Array:
    """The inverse, taken among correlations: variances of focal lengths and of k3 differ by many powers of ten."""
    sd = np.sqrt(np.diag(Sigma))
    return np.linalg.pinv(Sigma / np.outer(sd, sd), rcond=1e-12, hermitian=True) / np.outer(sd, sd)


MAX_ROUNDS, RETURNS = 12, 3
SCALE_SDS, SCALE_TOLERANCE = 3.0, 0.005


def fit_robustly(fit: Fit, refine_intrinsics: bool = False) -> Fit:
    """Adjusted, without contradictions, noisy detections weighed down."""
    # Sizes first: a target whose size is given wrongly would contradict everything else.
    base = most_seen(fit.detections, list(fit.problem.shapes))
    comparable = comparable_targets(fit.detections, list(fit.problem.shapes), base)
    fit = _without_contradictions(replace(fit, free_scales=comparable))
    fit = _compare_sizes(fit)
    if refine_intrinsics:
        fit = replace(fit, prior=lens_prior(fit.problem, fit.adjusted.state))
    return _settled(fit)


def _settled(fit: Fit) -> Fit:
    """Adjusted with everything: contradictions left out, detections weighed; what fits after all is taken back."""
    for _ in range(RETURNS):
        fit = estimate_sync_error(_reweighted(_without_contradictions(fit)))
        back = _taken_back(fit)
        if back is fit:
            return fit
        fit = back
    return estimate_sync_error(_reweighted(_narrowed(fit)))


def _without_contradictions(fit: Fit) -> Fit:
    fit = _narrowed(replace(fit, reweighting=np.ones(len(fit.reweighting))))
    back = _taken_back(fit)
    return fit if back is fit else _narrowed(back)


def _taken_back(fit: Fit) -> Fit:
    """With the detections that were left out and fit now; the same object when there are none."""
    rows = readmissible(fit.adjusted, fit.seen, fit.rows)
    if not rows:
        return fit
    again = {id(fit.all_detections[row]) for row in rows}
    left_out = tuple(out for out in fit.left_out if id(out.detection) not in again)
    return replace(fit, rows=np.union1d(fit.rows, rows), left_out=left_out)


def _narrowed(fit: Fit) -> Fit:
    stop = ROUGHLY
    for _ in range(MAX_ROUNDS):
        fit = _adjusted(fit, stop)
        used = fit.used
        wrong = bad_corners(fit.adjusted, used)
        out = contradictions(fit.adjusted, used, fit.detections, fit.problem.shapes)
        if out or wrong.any():
            fit = _leave_out(fit, wrong, out)
        elif stop is CONVERGED:
            return fit
        else:
            stop = CONVERGED
    return _adjusted(fit)


def _adjusted(fit: Fit, stop: StopCriterion = CONVERGED) -> Fit:
    layout = fit.layout
    adjusted = adjust(fit.adjusted.state, fit.used, layout, fit.free(layout), fit.prior, stop)
    return replace(fit, adjusted=replace(adjusted, iterations=fit.adjusted.iterations + adjusted.iterations))


def _leave_out(fit: Fit, wrong: Bools, out: Sequence[tuple[int, str]]) -> Fit:
    weight = fit.seen.weight.copy()
    weight[fit.rows] = np.where(wrong, 0.0, weight[fit.rows])
    named = tuple(LeftOut(fit.all_detections[fit.rows[row]], reason) for row, reason in out)
    rows = np.delete(fit.rows, [row for row, _ in out])
    return replace(fit, seen=replace(fit.seen, weight=weight), rows=rows, left_out=fit.left_out + named)


def _reweighted(fit: Fit) -> Fit:
    weights = reweighting(fit)
    return _adjusted(replace(fit, reweighting=weights)) if weights.min() < 1 else fit


def _compare_sizes(fit: Fit) -> Fit:
    """The targets' sizes beside the base's; those that agree with what was given are held fixed from now on."""
    if not fit.free_scales.any():
        return fit
    with_lens = Layout(fit.layout.cameras, fit.layout.targets, with_lens=True)
    sd = covariance(fit.adjusted, fit.used, fit.free(with_lens), lens_covariances(fit), fit.sync_error[fit.rows]).scale
    ratio = fit.adjusted.state.scale
    agree = np.abs(ratio - 1) <= np.maximum(SCALE_SDS * sd, SCALE_TOLERANCE)
    names = list(fit.problem.shapes)
    scale_of = {names[k]: (float(ratio[k]), float(sd[k])) for k in np.flatnonzero(fit.free_scales)}
    state = replace(fit.adjusted.state, scale=np.where(agree, 1.0, ratio))
    return replace(
        fit, adjusted=replace(fit.adjusted, state=state), free_scales=fit.free_scales & ~agree, scale_of=scale_of
    )
