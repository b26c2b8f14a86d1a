"""Step 6: how well cameras, lenses and targets are known, where errors are not independent among other things.

From the normal equations of all corners, in the gauge of the solution: the reference (a camera, or one pose of a
target) is exact by definition, everything else is known relative to it.

    covariance = c P + sum over cameras of G Sigma_lens G^T,    P = (S + prior)^-1,    G = -P S_lens

S: reduced normal equations, in units of the noise (Huber's variance factor); G: what an error of the lens parameters,
held fixed, does to the poses.

P assumes that corners err independently. Real ones do not: a view is a little blurred, a target is bent or moves
between exposures, a shutter rolls, and then all corners at one pose of a target err together. The scatter of the poses'
scores (the sandwich estimator for errors that clusters share, Liang & Zeger 1986) tells by how much P promises too
much: c >= 1.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from capture_rig.lens import NEGLIGIBLE, Array

from .adjustment import HUBER, FreeUnknowns, normal_equations, normalised_lengths, reduce
from .robust_fit import Fit, whitened
from .state import Bools


class Covariance(NamedTuple):
    """of_shared (d, d): of all shared unknowns as laid out with their lenses, 0 where fixed: of a camera, rotation
    vector (rad, in the camera's frame) and centre (m, in the reference's frame).

    variance_factor: the corners' variance over the one given. inflation: the factor by which errors that poses share
    enlarge variances overall.
    """

    of_shared: Array
    variance_factor: float
    inflation: float


def covariance(fit: Fit, free: FreeUnknowns) -> Covariance:
    """Compute the covariances at the solution; ``free`` sets the gauge (and frees the lenses that were refined); lenses
    that are not adjusted are as uncertain as given."""
    scaled = fit.used.weighted(np.array(1 / fit.scale))
    equations = normal_equations(whitened(fit.rows_at_solution(), fit.displacement_m), scaled, fit.state, fit.prior)
    told = np.linalg.eigvalsh(equations.V[free.poses])  # six numbers of a pose, five of a wand's
    unknowns = int(free.shared.sum() + (told > NEGLIGIBLE * told[:, -1:]).sum())
    factor = variance_factor(normalised_lengths(fit.state, scaled)[scaled.weight > 0], unknowns)
    reduced = reduce(equations, FreeUnknowns(np.ones(fit.state.layout.size, bool), free.poses))
    information, score = reduced.information / factor, reduced.score / factor
    S = information.sum(axis=0)
    white = inverse_over(S + fit.prior.information, free.shared)
    # of each pose's score when the corners' noise is white: its own information less what the fit takes up
    expected = (information - information @ white @ information).sum(axis=0)
    inflation = max(float(np.trace(white @ (score.T @ score)) / max(np.trace(white @ expected), 1.0)), 1.0)
    total = inflation * white
    for row, name in enumerate(fit.problem.cameras):
        if name in fit.problem.lens_sd:
            G = white @ S[:, fit.state.layout.lens(row)] * fit.problem.lens_sd[name]
            total = total + G @ G.T
    return Covariance(total, factor * fit.scale**2, inflation)


def variance_factor(lengths: Array, unknowns: int) -> float:
    """Estimate the variance factor as Huber does: squared clipped residuals over the degrees of freedom, by the square
    of the share inside."""
    dof = max(2 * len(lengths) - unknowns, 1)
    inside = max(float(np.mean(lengths <= HUBER)), 0.5)
    return float(np.sum(np.minimum(lengths, HUBER) ** 2)) / dof / inside**2


def inverse_over(information: Array, free: Bools) -> Array:
    """Return the inverse over the free unknowns, zeros elsewhere; also where exact corners leave coefficients that make
    up for each other to rounding alone."""
    some = information[np.ix_(free, free)]
    unit = np.sqrt(np.maximum(np.diag(some), np.finfo(float).tiny))
    values, vectors = np.linalg.eigh(some / np.outer(unit, unit))
    known = np.maximum(values, np.finfo(float).eps * values[-1:])
    full = np.zeros_like(information)
    full[np.ix_(free, free)] = (vectors / known) @ vectors.T / np.outer(unit, unit)
    return full
