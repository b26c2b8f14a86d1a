"""Steps 4 and 5 together: adjust, reject contradicting detections, adjust again.

A wrong order of corners, a target that moved between the exposures, corners found on something else: of three or more
cameras that saw the target, the one farthest off is left out; of two, both. Sizes of targets are free beside that of
the target seen most, with a prior, as are lenses that are to be refined: a size that is given wrongly would contradict
everything else.

Least squares would weigh the many corners of a target that moved between two exposures far too much, above all across
the line of sight, where a single picture measures a target's place to a fraction of a millimetre. So each detection is
allowed a displacement of its own, unknown but for its standard deviation tau (m), at which the contradictions between
cameras equal those of noise (Paule & Mandel 1982):

    covariance of a detection's residuals = I + tau^2 A A^T,    A: derivatives by the target's position
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import brentq

from capture_rig.lens import Array, is_fisheye
from capture_rig.rigid import inverse

from ..boards.board import TargetDetection
from .adjustment import (
    HUBER,
    RAYLEIGH_MEDIAN,
    FreeUnknowns,
    Prior,
    adjust,
    normal_equations,
    normalised_lengths,
    robust_rows,
    shared_of,
    step,
)
from .initial_poses import InitialPoses
from .problem import LINE, Problem, TargetView
from .state import POSE, WARP, BundleState, Ints, LinearisedRows, Observations, lens_of, observe, residuals_px

ROUNDS = 20
DISPLACEMENT_ROUNDS = 8
POSITION = slice(3, 6)
SINGLE = "its corners do not fit the target's shape (found on something else, or the target is bent)"
CONTRADICTS = "contradicts the others' views in that frame (wrong corners, or moved between the exposures)"
NO_POSE = "its corners are too few to tell where the target was, or fit no pose of it"
# Thresholds: judgement, no measurement.
SIZE_SD = 0.01  # of targets about the sizes given beside that of the one seen most
CLEAR_SDS = 5.0  # standard deviations beyond which something is wrong, not imprecise
WORST_FIRST = 0.7  # of the worst: detections beyond this are left out in one round
HARMLESS_PX = 0.3  # residual from slightly wrong lenses and delays


@dataclass(frozen=True, eq=False)
class RejectedDetection:
    """A detection that took no part, and why."""

    detection: TargetDetection
    reason: str


@dataclass(frozen=True, eq=False)
class RobustFit:
    """The state of the solver: all detections, those in use (``rows``), and the adjusted state.

    ``seen`` : observations of all detections, whose standard deviations are ``scale`` times those given. ``prior`` : of
    sizes, lenses and warps; those with one are adjusted, the others are held. ``displacement_m`` : standard deviation
    of the target's displacement for each detection.
    """

    problem: Problem
    all_detections: tuple[TargetDetection, ...]
    seen: Observations
    rows: Ints
    state: BundleState
    root: int
    left_out: tuple[RejectedDetection, ...]
    prior: Prior
    scale: float = 1.0
    displacement_m: float = 0.0

    @property
    def detections(self) -> tuple[TargetDetection, ...]:
        """The detections that take part."""
        return tuple(self.all_detections[row] for row in self.rows)

    @property
    def used(self) -> Observations:
        return self.seen.only(self.rows)

    @property
    def reasons(self) -> dict[str, str]:
        """The last reason, by camera, why a detection of it was left out."""
        return {out.detection.camera: out.reason for out in self.left_out}

    @property
    def free(self) -> FreeUnknowns:
        """What moves while the root camera holds the frame."""
        layout = self.state.layout
        shared = np.diag(self.prior.information) > 0
        for camera in range(layout.cameras):
            shared[layout.camera(camera)] = camera != self.root
        return FreeUnknowns(shared, np.isin(np.arange(len(self.state.position)), self.seen.pose[self.rows]))

    def rows_at_solution(self) -> LinearisedRows:
        """The residuals' rows at the solution: robustly weighted, in units of the noise found."""
        return robust_rows(self.state, self.used.weighted(np.array(1 / self.scale)))


def start_fit(problem: Problem, views: Sequence[TargetView], initial: InitialPoses) -> RobustFit:
    """Make the first state; detections whose target has no pose yet, or lies behind their camera, are left out."""
    keys, names, targets = problem.keys, list(problem.cameras), list(problem.shapes)
    detections = tuple(
        replace(view.detection, ids=view.shape.numbered(view.detection.ids, way))
        for view, way in zip(views, initial.ways, strict=True)
    )
    seen = observe(detections, names, keys, problem.shapes)
    state = _first_state(problem, initial)
    placed = np.array([key in initial.T_root_target for key in keys])[seen.pose]
    in_front = (np.isfinite(residuals_px(state, seen)).all(axis=2) | (seen.weight == 0)).all(axis=1)
    keep = placed & in_front
    on_a_line = np.array([view.shape.dimension == LINE for view in views], bool)  # one view of a wand is no mishap
    left_out = tuple(
        RejectedDetection(detections[i], CONTRADICTS if placed[i] else NO_POSE)
        for i in np.flatnonzero(~keep & (placed | ~on_a_line))
    )
    layout = state.layout
    sd = np.full(layout.size, np.inf)
    most_seen = int(np.bincount(seen.target, minlength=len(targets)).argmax())  # the others' sizes are compared with it
    sd[np.delete(layout.scales, most_seen)] = SIZE_SD
    prior = Prior(shared_of(state), np.diag(sd**-2.0))
    rows = np.flatnonzero(keep)
    return RobustFit(problem, detections, seen, rows, state, names.index(initial.root), left_out, prior)


def settled(fit: RobustFit) -> RobustFit:
    """Adjust and reject contradicting detections until there are none; then estimate the targets' motion between the
    cameras' exposures."""
    fit = adjusted(fit)
    for _ in range(ROUNDS):
        out = _contradictions(fit)
        if not out:
            break
        left_out = [RejectedDetection(fit.detections[row], reason) for row, reason in out]
        rows = np.delete(fit.rows, [row for row, _ in out])
        fit = adjusted(replace(fit, rows=rows, left_out=(*fit.left_out, *left_out)))
    return _with_displacement(fit)


def adjusted(fit: RobustFit) -> RobustFit:
    """Adjust with all detections that take part."""
    if len(fit.rows) == 0:
        return fit
    state, scale = adjust(fit.state, fit.used, fit.free, fit.prior)
    return replace(fit, state=state, scale=scale)


def _first_state(problem: Problem, initial: InitialPoses) -> BundleState:
    T_root_camera = inverse(np.array([initial.T_camera_root[name] for name in problem.cameras]))
    T = np.array([initial.T_root_target.get(key, np.eye(4)) for key in problem.keys])
    R_camera, centre = np.swapaxes(T_root_camera[:, :3, :3], 1, 2), T_root_camera[:, :3, 3]
    lens = np.array([lens_of(camera) for camera in problem.cameras.values()])
    fisheye = np.array([is_fisheye(camera.D) for camera in problem.cameras.values()])
    scale, warp = np.ones(len(problem.shapes)), np.zeros((len(problem.shapes), WARP))
    return BundleState(R_camera, centre, lens, T[:, :3, :3], T[:, :3, 3], scale, warp, fisheye)


def _contradictions(fit: RobustFit) -> list[tuple[int, str]]:
    """Find the rows of detections to leave out, with the reason; of one pose of a target, no more than needs be."""
    seen = fit.used
    # the median residual of each over the expected one: about 1 when all is well
    lengths = np.where(seen.weight > 0, normalised_lengths(fit.state, seen) / fit.scale, np.nan)
    misfit = np.nanmedian(lengths, axis=1) / RAYLEIGH_MEDIAN
    sigma_px = fit.scale / np.maximum(seen.weight.max(axis=1), 1e-300)
    # lesser ones may only be effects of the worst
    limit = max(CLEAR_SDS, WORST_FIRST * float(misfit.max(initial=0.0)))
    found: list[tuple[int, str]] = []
    for pose in np.unique(seen.pose[(misfit > limit) & (misfit * sigma_px * RAYLEIGH_MEDIAN > HARMLESS_PX)]):
        rows = np.flatnonzero(seen.pose == pose)
        if len(rows) > 2:  # the others outvote it: Huber's loss grows like the distance, and they agree
            found.append((int(rows[np.argmax(misfit[rows])]), CONTRADICTS))
        else:
            found += [(int(row), CONTRADICTS if len(rows) == 2 else SINGLE) for row in rows]
    return sorted(found)


# --- Detections with a displacement beside their corners' noise.


def _with_displacement(fit: RobustFit) -> RobustFit:
    """Where cameras contradict one another more than corners' noise explains, targets may have moved between them."""
    state, free = fit.state, fit.free
    for _ in range(DISPLACEMENT_ROUNDS):
        linear, corners = fit.rows_at_solution(), int((fit.used.weight > 0).sum())
        tau = displacement_of(linear, fit.used.pose, int(free.shared.sum()), corners)
        if tau == 0.0:
            return fit
        equations = normal_equations(whitened(linear, tau), fit.used, state, fit.prior)
        state = state.moved(*step(equations, free, 0.0))
        fit = replace(fit, state=state, displacement_m=tau)
    return fit


def displacement_of(linear: LinearisedRows, poses: Ints, shared: int, corners: int) -> float:
    """Estimate the displacement (sd, m) of detections; 0 where noise explains as much.

    ``poses`` (s,): the pose of each; ``shared``: free shared unknowns; ``corners``: their number.
    """
    A = linear.by_pose[:, :, POSITION]
    values, vectors = np.linalg.eigh(np.swapaxes(A, 1, 2) @ A)
    pull = (np.swapaxes(A @ vectors, 1, 2) @ linear.residual[..., None])[..., 0]
    values = np.maximum(values, 1e-300)
    squares = pull**2 / values
    left = 1 - len(np.unique(poses)) / len(poses) - shared / (POSE * len(poses))  # the share that fitting leaves
    dof, rest_dof = left * squares.size, 2 * corners - squares.size
    noise = (float((linear.residual**2).sum()) - squares.sum()) / max(rest_dof, 1)
    if dof < 1 or noise <= 0 or squares.sum() / noise < dof + HUBER * np.sqrt(2 * dof):
        return 0.0

    def excess(tau: float) -> float:
        return float((squares / (noise + tau**2 * values)).sum()) - dof

    return float(brentq(excess, 0.0, np.sqrt((squares / values).sum() / dof)))


def whitened(linear: LinearisedRows, tau: float) -> LinearisedRows:
    """Transform the rows so that the residuals are independent again; tau: sd of each detection's displacement, m."""
    A = linear.by_pose[:, :, POSITION]
    values, vectors = np.linalg.eigh(np.swapaxes(A, 1, 2) @ A)
    values = np.maximum(values, 1e-12 * values[:, -1:] + 1e-300)
    shrink = (1 - 1 / np.sqrt(1 + tau**2 * values)) / values
    M = (vectors * shrink[:, None]) @ np.swapaxes(vectors, 1, 2)

    def apply(rows: Array) -> Array:
        return rows - A @ (M @ (np.swapaxes(A, 1, 2) @ rows))

    return LinearisedRows(apply(linear.residual[..., None])[..., 0], apply(linear.by_shared), apply(linear.by_pose))
