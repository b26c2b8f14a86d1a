"""Step 6: how well cameras, lenses and targets are known, where cameras contradict one another among other things.

From the normal equations of all corners, in the gauge of the solution: the reference (a camera, or one pose of a
target) is exact by definition, everything else is known relative to it.

    covariance = S^-1 v F + sum over cameras of G Sigma_lens G^T,    G = -S^-1 S_lens

S: reduced normal equations of the free unknowns; v: variance factor of the robust residuals; F >= 1: by how much
cameras contradict one another beyond the noise of corners and what displacements explain; G: what an error of the lens
parameters, held fixed, does to the poses.

Whether cameras contradict one another by more than the noise of corners explains is an analysis of variance. The
corners of one detection err together as if the target lay elsewhere when it moved between exposures, is bent, or a lens
is not quite known: that part of a residual is its projection on what a change of the target's pose does to the picture.
Cameras and targets, too, act on a detection only through that pose, so the rest of the residual is noise of corners.

Least squares would believe the many corners of such a detection far too much, above all across the line of sight, where
a single picture tells a target's place to a fraction of a millimetre. So each detection is allowed a displacement of
its own, unknown but for its standard deviation tau (m), which is estimated from how far the cameras contradict one
another; weighing frames down by the target's speed would do the same, but needs speed and delay:

    covariance of a detection's residuals = I + tau^2 A A^T,    A: derivatives by the target's position
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from capture_rig.lens import Array

from .adjustment import (
    HUBER,
    TINY,
    Adjusted,
    FreeUnknowns,
    Prior,
    normal_equations,
    normalised_lengths,
    reduce,
    robust_rows,
)
from .state import Bools, Ints, Layout, Linearised, Observations

MIN_DOF = 18  # of the comparison between cameras: with less it tells nothing
POSITION = slice(3, 6)
# Thresholds: judgement, no measurement.
PRIOR_DOF = 6  # degrees of freedom of the prior that holds a frame's displacement to that of all
MAX_CHANGE = 4  # of tau^2 in one round


@dataclass(frozen=True, eq=False)
class Covariance:
    """cameras (c, 6, 6): rotation vector (rad, in the camera's frame) and centre (m, in the reference's frame).

    scale (k,): standard deviations of the targets' scales, 0 where fixed. variance_factor: the corners' variance over
    the one given. inflation: the factor F by which the covariance exceeds what independent corners would leave.
    """

    cameras: Array
    scale: Array
    variance_factor: float
    inflation: float


def covariance(
    fit: Adjusted,
    seen: Observations,
    free: FreeUnknowns,
    lens_sd: Mapping[int, Array],
    sync_error: Array,
    prior: Prior | None = None,
) -> Covariance:
    """Compute the covariances at the solution ``fit``; ``free`` sets the gauge (and frees the lenses that were
    refined).

    ``lens_sd``: by row of the camera, (12,) of its lens parameters, where these were held fixed;
    ``sync_error`` (s,): how far the target may have moved between exposures, sd, m.
    """
    layout = Layout(len(fit.state.centre), len(fit.state.scale), with_lens=True)
    scaled = seen.weighted(np.array(1 / fit.scale))
    linear = whitened(robust_rows(fit.state, scaled, with_lens=True), sync_error)
    equations = normal_equations(linear, scaled, layout, len(free.poses))
    S = reduce(equations, FreeUnknowns(np.ones(layout.size, bool), free.poses)).S
    inverse = _inverse(S if prior is None else S + prior.information, free.shared)
    misfit, shared, corners = pose_misfit(linear), int(free.shared.sum()), int((scaled.weight > 0).sum())
    unknowns = shared + pose_dof(scaled.pose, misfit.dof)
    lengths = normalised_lengths(fit.state, scaled)[scaled.weight > 0]
    factor = variance_factor(lengths, unknowns)
    ratio, dof = misfit.ratio(linear.residual, corners, scaled.pose, shared)
    inflation = max(ratio, 1.0) if dof >= MIN_DOF else 1.0
    total = inverse * factor * inflation + _lens_effect(inverse, S, layout, lens_sd)
    blocks = [layout.camera(c) for c in range(layout.cameras)]
    return Covariance(
        cameras=np.array([total[b, b] for b in blocks]),
        scale=np.sqrt(np.diag(total)[layout.scales]),
        variance_factor=factor * fit.scale**2,
        inflation=inflation,
    )


def variance_factor(lengths: Array, unknowns: int) -> float:
    """Estimate the variance factor as Huber does: squared clipped residuals over the degrees of freedom, by the square
    of the share inside."""
    dof = max(2 * len(lengths) - unknowns, 1)
    inside = max(float(np.mean(lengths <= HUBER)), 0.5)
    return float(np.sum(np.minimum(lengths, HUBER) ** 2)) / dof / inside**2


def _inverse(information: Array, free: Bools) -> Array:
    """Return the inverse over the free unknowns, zeros elsewhere."""
    full = np.zeros_like(information)
    full[np.ix_(free, free)] = np.linalg.pinv(information[np.ix_(free, free)], rcond=1e-14, hermitian=True)
    return full


def _lens_effect(inverse: Array, S: Array, layout: Layout, lens_sd: Mapping[int, Array]) -> Array:
    total = np.zeros_like(S)
    for camera, sd in sorted(lens_sd.items()):
        G = inverse @ S[:, layout.lens(camera)] * sd
        total += G @ G.T
    return total


# --- How far cameras contradict one another.


@dataclass(frozen=True, eq=False)
class PoseMisfit:
    """squares (s,): squared length, in standard deviations, of the part of each detection's residual that a change of
    pose would explain; dof (s,): how many numbers that is (6 or, for a wand, 5)."""

    squares: Array
    dof: Ints

    def ratio(self, residual: Array, corners: int, poses: Ints, shared: int) -> tuple[float, int]:
        """Variance of the pose-like part over that of the rest (1: corners err independently), and its degrees of
        freedom. residual (s, 2n) weighted; poses (s,): the pose of each; shared: free shared unknowns."""
        dof = int(self.dof.sum()) - pose_dof(poses, self.dof) - shared
        rest_dof = 2 * corners - int(self.dof.sum())
        rest = float((residual**2).sum() - self.squares.sum())
        if dof <= 0 or rest_dof <= 0 or rest <= 0:
            return 1.0, max(dof, 0)
        return float(self.squares.sum() / dof / (rest / rest_dof)), dof


def pose_misfit(linear: Linearised) -> PoseMisfit:
    """Find the pose-like part of the residuals of each detection."""
    V = np.swapaxes(linear.by_pose, 1, 2) @ linear.by_pose
    g = (np.swapaxes(linear.by_pose, 1, 2) @ linear.residual[..., None])[..., 0]
    values, vectors = np.linalg.eigh(V)
    along = (np.swapaxes(vectors, 1, 2) @ g[..., None])[..., 0]
    seen = values > TINY * values[:, -1:]
    squares = np.where(seen, along**2 / np.where(seen, values, 1.0), 0.0)
    return PoseMisfit(squares.sum(axis=1), seen.sum(axis=1))


def pose_dof(poses: Ints, dof: Ints) -> int:
    """Count how many numbers the poses that were seen have: six each, five for a wand."""
    most = np.zeros(int(poses.max(initial=-1)) + 1, np.int64)
    np.maximum.at(most, poses, dof)
    return int(most.sum())


def whitened(linear: Linearised, tau: Array) -> Linearised:
    """Transform the rows so that the residuals are independent again; tau (s,), m."""
    A = linear.by_pose[:, :, POSITION]
    values, vectors = np.linalg.eigh(np.swapaxes(A, 1, 2) @ A)
    values = np.maximum(values, 1e-12 * values[:, -1:] + 1e-300)
    shrink = (1 - 1 / np.sqrt(1 + tau[:, None] ** 2 * values)) / values
    M = (vectors * shrink[:, None]) @ np.swapaxes(vectors, 1, 2)

    def apply(rows: Array) -> Array:
        return rows - A @ (M @ (np.swapaxes(A, 1, 2) @ rows))

    return Linearised(apply(linear.residual[..., None])[..., 0], apply(linear.by_shared), apply(linear.by_pose))


def first_tau(linear: Linearised, misfit: PoseMisfit, dof: int) -> float:
    """Estimate the displacement (m) that makes the residuals' part along it as large as it is, the same for all
    detections."""
    A = linear.by_pose[:, :, POSITION]
    information = np.swapaxes(A, 1, 2) @ A
    pull = np.swapaxes(A, 1, 2) @ linear.residual[..., None]
    squares = float((np.swapaxes(pull, 1, 2) @ np.linalg.pinv(information, hermitian=True) @ pull).sum())
    left = max(dof, 1) / misfit.dof.sum()  # the share that fitting poses leaves
    excess = squares / left - 3 * len(A)
    return float(np.sqrt(max(excess, 0.0) / np.trace(information, axis1=1, axis2=2).sum()))


def next_tau(tau: Array, linear: Linearised, poses: Ints) -> Array:
    """Improve the displacements (s,), pose by pose, from what contradiction is left in whitened residuals."""
    misfit = pose_misfit(linear)
    squares, total = np.bincount(poses, misfit.squares), np.bincount(poses, misfit.dof)
    own = np.zeros(len(total))
    np.maximum.at(own, poses, misfit.dof)
    ratio = (PRIOR_DOF + squares) / (PRIOR_DOF + total - own)
    return tau * np.sqrt(np.clip(ratio, 1 / MAX_CHANGE, MAX_CHANGE))[poses]
