"""Step 6: how well cameras, lenses and targets are known.

From the normal equations of all corners, in the gauge of the solution: the reference (a camera, or one pose of a
target) is exact by definition, everything else is known relative to it.

    covariance = S^-1 v F + sum over cameras of G Sigma_lens G^T,    G = -S^-1 S_lens

S: reduced normal equations of the free unknowns; v: variance factor of the robust residuals; F >= 1: by how much
cameras contradict one another (:mod:`.sync_error`) beyond the noise of corners and what displacements explain; G: what
an error of the lens parameters, held fixed, does to the poses.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from .adjustment import HUBER, Adjusted, FreeUnknowns, Prior, normal_equations, normalised_lengths, reduce, robust_rows
from .rigid import Array
from .state import Bools, Layout, Observations
from .sync_error import pose_dof, pose_misfit, whitened

MIN_DOF = 18  # of the comparison between cameras: with less it tells nothing


@dataclass(frozen=True, eq=False)
class Covariance:
    """cameras (c, 6, 6): rotation vector (rad, in the camera's frame) and centre (m, in the reference's frame).

    scale (k,): standard deviations of the targets' scales, 0 where fixed. variance_factor: the corners' variance over
    the one given. inflation: the factor F by which the covariance exceeds what independent corners would leave.
    redundancy: the share of the corners' coordinates that the unknowns do not use up.
    """

    cameras: Array
    scale: Array
    variance_factor: float
    inflation: float
    redundancy: float


def covariance(
    fit: Adjusted,
    seen: Observations,
    free: FreeUnknowns,
    lens_covariance: Mapping[int, Array],
    sync_error: Array,
    prior: Prior | None = None,
) -> Covariance:
    """Compute the covariances at the solution ``fit``; ``free`` sets the gauge (and frees the lenses that were
    refined).

    ``lens_covariance``: by row of the camera, (12, 12) of its lens parameters, where these were held fixed;
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
    total = inverse * factor * inflation + _lens_effect(inverse, S, layout, lens_covariance)
    blocks = [layout.camera(c) for c in range(layout.cameras)]
    return Covariance(
        cameras=np.array([total[b, b] for b in blocks]),
        scale=np.sqrt(np.diag(total)[layout.scales]),
        variance_factor=factor * fit.scale**2,
        inflation=inflation,
        redundancy=max(2 * corners - unknowns, 1) / (2 * corners),
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


def _lens_effect(inverse: Array, S: Array, layout: Layout, lens_covariance: Mapping[int, Array]) -> Array:
    total = np.zeros_like(S)
    for camera, Sigma in sorted(lens_covariance.items()):
        G = -inverse @ S[:, layout.lens(camera)]
        total += G @ Sigma @ G.T
    return total
