"""Steps 4 and 5 together: adjust, leave out what contradicts the rest, adjust again, compare the targets' sizes.

Where cameras contradict one another more than the corners' noise explains, each detection may be displaced in the end
(:mod:`.uncertainty`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from capture_rig.lens import Array, is_fisheye
from capture_rig.rigid import inverse

from ..boards.board import TargetDetection
from .adjustment import (
    CONVERGED,
    HUBER,
    ROUGHLY,
    Adjusted,
    FreeUnknowns,
    Prior,
    StopCriterion,
    adjust,
    normal_equations,
    robust_rows,
    step,
    with_prior,
)
from .initial_poses import InitialPoses, comparable_targets, most_seen, with_symmetry
from .outliers import ODD_ONE, RIG_LIMITS, Limits, RejectedDetection, bad_corners, contradictions, readmissible
from .problem import LENS, LINE, Problem, View
from .state import WARP, Bools, Ints, Layout, Linearised, Observations, State, lens_of, observe, residuals_px
from .uncertainty import MIN_DOF, Covariance, covariance, first_tau, next_tau, pose_misfit, whitened

RETURNS = 3
SYNC_ERROR_ROUNDS, GAUSS_NEWTON_STEPS = 4, 2
NO_POSE = "its corners are too few to tell where the target was, or fit no pose of it"


@dataclass(frozen=True, eq=False)
class Fit:
    """The state of the solver: all detections, which of them still take part (``rows``), and the adjusted state.

    ``seen`` holds the observations of all detections; ``free_scales`` (k,) which targets' sizes are unknown;
    ``alone_px`` (s,) the rms distance of each detection's corners under the pose that fits it best alone;
    ``sync_error`` (s,), m, how far (sd) the target may have been elsewhere for each detection; ``prior`` of the lenses
    and warps, where these are adjusted; ``free_lenses`` (c, 12), ``free_warps`` (k, 2) which of them.
    """

    problem: Problem
    all_detections: tuple[TargetDetection, ...]
    seen: Observations
    rows: Ints
    adjusted: Adjusted
    root: int
    free_scales: Bools
    free_lenses: Bools
    free_warps: Bools
    left_out: tuple[RejectedDetection, ...]
    alone_px: Array
    sync_error: Array
    scale_of: dict[str, tuple[float, float]]
    prior: Prior | None = None

    @property
    def detections(self) -> tuple[TargetDetection, ...]:
        """The detections that take part."""
        return tuple(self.all_detections[row] for row in self.rows)

    @property
    def used(self) -> Observations:
        return self.seen.only(self.rows)

    @property
    def layout(self) -> Layout:
        return Layout(len(self.problem.cameras), len(self.problem.shapes), self.prior is not None)

    @property
    def reasons(self) -> dict[str, str]:
        """The commonest reason, by camera, why detections of it were left out."""
        by_camera: dict[str, list[str]] = {}
        for out in self.left_out:
            if out.whole:
                by_camera.setdefault(out.detection.camera, []).append(out.reason)
        return {name: max(sorted(set(reasons)), key=reasons.count) for name, reasons in by_camera.items()}

    def free(self, layout: Layout) -> FreeUnknowns:
        """Return what moves while the root camera holds the frame."""
        shared = np.ones(layout.size, bool)
        shared[layout.camera(self.root)] = False
        shared[layout.scales] = self.free_scales
        if layout.with_lens:
            shared[layout.warps] = self.free_warps
            for row, free in enumerate(self.free_lenses):
                shared[layout.lens(row)] = free
        return FreeUnknowns(shared, np.isin(np.arange(len(self.adjusted.state.position)), self.seen.pose[self.rows]))

    def covariance(self, free: FreeUnknowns) -> Covariance:
        """Covariances in the gauge that ``free`` sets; lenses that were not adjusted are as uncertain as given."""
        known = self.problem.lens_sd if self.prior is None else {}
        lenses = {row: known[name] for row, name in enumerate(self.problem.cameras) if name in known}
        return covariance(self.adjusted, self.used, free, lenses, self.sync_error[self.rows], self.prior)

    def rows_at_solution(self, with_lens: bool) -> Linearised:
        """The residuals' rows at the solution: robustly weighted, in units of the noise found."""
        scaled = self.used.weighted(np.array(1 / self.adjusted.scale))
        return robust_rows(self.adjusted.state, scaled, with_lens)


def start_fit(problem: Problem, views: Sequence[View], initial: InitialPoses) -> Fit:
    """Make the first state; detections whose target has no pose yet, or lies behind their camera, are left out."""
    keys, names, targets = problem.keys, list(problem.cameras), len(problem.shapes)
    detections = tuple(with_symmetry(view, symmetry) for view, symmetry in zip(views, initial.symmetries, strict=True))
    seen = observe(detections, names, keys, problem.shapes)
    state = _first_state(problem, initial)
    placed = np.array([key in initial.T_root_target for key in keys])[seen.pose]
    in_front = (np.isfinite(residuals_px(state, seen)).all(axis=2) | (seen.weight == 0)).all(axis=1)
    keep = placed & in_front
    on_a_line = np.array([view.shape.dimension == LINE for view in views], bool)  # one view of a wand is no mishap
    left_out = tuple(
        RejectedDetection(detections[i], ODD_ONE if placed[i] else NO_POSE)
        for i in np.flatnonzero(~keep & (placed | ~on_a_line))
    )
    return Fit(
        problem=problem,
        all_detections=detections,
        seen=seen,
        rows=np.flatnonzero(keep),
        adjusted=Adjusted(state, 1.0),
        root=names.index(initial.root),
        free_scales=np.zeros(targets, bool),
        free_lenses=np.zeros((len(names), LENS), bool),
        free_warps=np.zeros((targets, WARP), bool),
        left_out=left_out,
        alone_px=np.array([_alone_px(view) for view in views]),
        sync_error=np.zeros(len(detections)),
        scale_of={},
    )


def _alone_px(view: View) -> float:
    """How far its corners are from the target's shape; infinite where they fit no pose, 0 where none would tell."""
    if view.poses is None:
        return 0.0 if view.shape.dimension == LINE else np.inf
    return float(view.poses.rms_px.min())


def fit_robustly(fit: Fit, refine_intrinsics: bool = False) -> Fit:
    """Adjust, leave contradictions out, weigh noisy detections down."""
    # Sizes first: a target whose size is given wrongly would contradict everything else.
    base = most_seen(fit.detections, list(fit.problem.shapes))
    comparable = comparable_targets(fit.detections, list(fit.problem.shapes), base)
    fit = _compare_sizes(without_contradictions(replace(fit, free_scales=comparable)))
    return settled(_with_free_lenses(fit) if refine_intrinsics else fit)


def settled(fit: Fit, limits: Limits = RIG_LIMITS) -> Fit:
    """Adjust, contradictions left out, targets allowed to have moved between the cameras' exposures."""
    return _estimate_sync_error(without_contradictions(fit, limits))


def without_contradictions(fit: Fit, limits: Limits = RIG_LIMITS) -> Fit:
    """Adjust, leave out what contradicts the rest, and take back what fits after all."""
    fit = _narrowed(fit, limits)
    for _ in range(RETURNS):
        back = _taken_back(fit, limits)
        if back is fit:
            break
        fit = _narrowed(back, limits)
    return fit


def adjusted(fit: Fit, stop: StopCriterion = CONVERGED) -> Fit:
    """Adjust with all detections that take part."""
    if len(fit.rows) == 0:
        return fit
    layout = fit.layout
    return replace(fit, adjusted=adjust(fit.adjusted.state, fit.used, layout, fit.free(layout), fit.prior, stop))


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
        np.zeros((len(problem.shapes), WARP)),
        np.array([is_fisheye(camera.D) for camera in problem.cameras.values()]),
    )


# --- Leaving out and taking back.


def _narrowed(fit: Fit, limits: Limits) -> Fit:
    stop = ROUGHLY
    for _ in range(limits.rounds):
        fit = adjusted(fit, stop)
        used = fit.used
        wrong = bad_corners(fit.adjusted, used, limits)
        out = contradictions(fit.adjusted, used, fit.alone_px[fit.rows], limits)
        if out or wrong.any():
            fit = _leave_out(fit, wrong, out)
        elif stop is CONVERGED:
            return fit
        else:
            stop = CONVERGED
    return adjusted(fit)


def _leave_out(fit: Fit, wrong: Bools, out: Sequence[tuple[int, str]]) -> Fit:
    weight = fit.seen.weight.copy()
    weight[fit.rows] = np.where(wrong, 0.0, weight[fit.rows])
    detections = fit.detections
    far = np.linalg.norm(residuals_px(fit.adjusted.state, fit.used), axis=2)
    named = [RejectedDetection(detections[row], reason) for row, reason in out]
    for row in np.flatnonzero(wrong.any(axis=1)):
        corners = detections[row].ids[np.flatnonzero(wrong[row])]
        named.append(
            RejectedDetection(
                detections[row], f"up to {far[row][wrong[row]].max():.1f} px off", tuple(corners.tolist())
            )
        )
    rows = np.delete(fit.rows, [row for row, _ in out])
    return replace(fit, seen=replace(fit.seen, weight=weight), rows=rows, left_out=(*fit.left_out, *named))


def _taken_back(fit: Fit, limits: Limits) -> Fit:
    """Return the fit with those detections taken back that fit now; the same object when there are none."""
    rows = readmissible(fit.adjusted, fit.seen, fit.rows, limits)
    if len(rows) == 0:
        return fit
    again = {id(fit.all_detections[row]) for row in rows}
    left_out = tuple(out for out in fit.left_out if not out.whole or id(out.detection) not in again)
    return replace(fit, rows=np.union1d(fit.rows, rows), left_out=left_out)


# --- Detections that are believed less than their corners claim.


def _estimate_sync_error(fit: Fit) -> Fit:
    """Where cameras contradict one another more than corners' noise explains, targets may have moved between them."""
    linear = fit.rows_at_solution(fit.layout.with_lens)
    misfit, shared = pose_misfit(linear), int(fit.free(fit.layout).shared.sum())
    ratio, dof = misfit.ratio(linear.residual, int((fit.used.weight > 0).sum()), fit.used.pose, shared)
    if dof < MIN_DOF or ratio < 1 + HUBER * np.sqrt(2 / dof):
        return fit
    tau = np.full(len(fit.rows), first_tau(linear, misfit, dof))
    for _ in range(SYNC_ERROR_ROUNDS):
        for _ in range(GAUSS_NEWTON_STEPS):
            fit = _whitened_step(fit, tau)
        tau = next_tau(tau, whitened(fit.rows_at_solution(fit.layout.with_lens), tau), fit.used.pose)
    sync_error = np.zeros(len(fit.sync_error))
    sync_error[fit.rows] = tau
    return replace(_whitened_step(fit, tau), sync_error=sync_error)


def _whitened_step(fit: Fit, tau: Array) -> Fit:
    state, layout = fit.adjusted.state, fit.layout
    linear = whitened(fit.rows_at_solution(layout.with_lens), tau)
    equations = with_prior(normal_equations(linear, fit.used, layout, len(state.position)), fit.prior, state, layout)
    moved = state.moved(*step(equations, fit.free(layout), 0.0))
    return replace(fit, adjusted=replace(fit.adjusted, state=moved))


# --- Sizes of targets, and lenses.


def _compare_sizes(fit: Fit) -> Fit:
    """Return the targets' sizes beside the base's; those that agree with what was given are held fixed from now on."""
    if not fit.free_scales.any():
        return fit
    sd = fit.covariance(fit.free(replace(fit.layout, with_lens=True))).scale
    ratio = fit.adjusted.state.scale
    agree = np.abs(ratio - 1) <= HUBER * sd
    names = list(fit.problem.shapes)
    scale_of = {names[k]: (float(ratio[k]), float(sd[k])) for k in np.flatnonzero(fit.free_scales)}
    state = replace(fit.adjusted.state, scale=np.where(agree, 1.0, ratio))
    return replace(
        fit, adjusted=replace(fit.adjusted, state=state), free_scales=fit.free_scales & ~agree, scale_of=scale_of
    )


def _with_free_lenses(fit: Fit) -> Fit:
    """Lenses free, with a prior around those given that is as wide as their standard deviations."""
    layout = replace(fit.layout, with_lens=True)
    mean, information = np.zeros(layout.size), np.zeros((layout.size, layout.size))
    sd = np.array([fit.problem.lens_sd[name] for name in fit.problem.cameras])
    for row, deviations in enumerate(sd):
        mean[layout.lens(row)] = fit.adjusted.state.lens[row]
        known = np.arange(layout.size)[layout.lens(row)][deviations > 0]
        information[known, known] = deviations[deviations > 0] ** -2.0
    return replace(fit, free_lenses=sd > 0, prior=Prior(mean, information))
