"""Step 6: how well cameras, lenses and targets are known, where errors are not independent among other things.

From the normal equations of all corners, in the gauge of the solution: the reference (a camera, or one pose of a
target) is exact by definition, everything else is known relative to it.

    covariance = D P D + sum over cameras of G Sigma_lens G^T,    P = (S + prior)^-1,    G = -P S_lens

S: reduced normal equations, in units of the noise (Huber's variance factor); G: what an error of the lens parameters,
held fixed, does to the poses.

P assumes that corners err independently. Real ones do not: a view is a little blurred, a target is bent or moves
between exposures, a shutter rolls, and then all corners at one pose of a target err together. The scatter of the poses'
scores (the sandwich estimator for errors that clusters share, Liang & Zeger 1986) tells by how much P promises too
much, and D enlarges it by that.

Least squares would believe the many corners of a target that moved between two exposures far too much, above all across
the line of sight, where a single picture tells a target's place to a fraction of a millimetre. So each detection is
allowed a displacement of its own, unknown but for its standard deviation tau (m): the one with which the cameras
contradict one another no more than noise does (Paule & Mandel 1982):

    covariance of a detection's residuals = I + tau^2 A A^T,    A: derivatives by the target's position
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np
from scipy.optimize import brentq

from capture_rig.lens import NEGLIGIBLE, Array

from .adjustment import HUBER, FreeUnknowns, Prior, normal_equations, normalised_lengths, reduce, robust_rows
from .state import POSE, Bools, Ints, Layout, Linearised, Observations, State

POSITION = slice(3, 6)


class Covariance(NamedTuple):
    """of_shared (d, d): of all shared unknowns as laid out with their lenses, 0 where fixed: of a camera, rotation
    vector (rad, in the camera's frame) and centre (m, in the reference's frame).

    variance_factor: the corners' variance over the one given. inflation: the factor by which errors that poses share
    enlarge variances overall.
    """

    of_shared: Array
    variance_factor: float
    inflation: float


def covariance(
    state: State,
    scale: float,
    seen: Observations,
    free: FreeUnknowns,
    lens_sd: Mapping[int, Array],
    displacement_m: float,
    prior: Prior,
) -> Covariance:
    """Compute the covariances at the solution; ``free`` sets the gauge (and frees the lenses that were
    refined).

    ``lens_sd``: by row of the camera, (12,) of its lens parameters, where these were held fixed; ``displacement_m``:
    how far (sd) the target may have moved between exposures.
    """
    layout = state.layout
    scaled = seen.weighted(np.array(1 / scale))
    equations = normal_equations(whitened(robust_rows(state, scaled), displacement_m), scaled, state, prior)
    told = np.linalg.eigvalsh(equations.V[free.poses])  # six numbers of a pose, five of a wand's
    unknowns = int(free.shared.sum() + (told > NEGLIGIBLE * told[:, -1:]).sum())
    factor = variance_factor(normalised_lengths(state, scaled)[scaled.weight > 0], unknowns)
    reduced = reduce(equations, FreeUnknowns(np.ones(layout.size, bool), free.poses))
    information, score = reduced.information / factor, reduced.score / factor
    S = information.sum(axis=0)
    white = inverse_over(S + prior.information, free.shared)
    enlarged, inflation = _enlarged(white, information, score)
    total = enlarged + _lens_effect(white, S, layout, lens_sd)
    return Covariance(total, factor * scale**2, inflation)


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


def _enlarged(white: Array, information: Array, score: Array) -> tuple[Array, float]:
    """Enlarge the covariance by what the poses' scores (m, d) scatter beyond what their information (m, d, d) lets
    expect; and the factor >= 1 overall.

    Each parameter's own factor lies half-way between that and what its own scatter says, which is few numbers (nearer
    to the former where few poses tell), and is never smaller than the overall one.
    """
    # of each score when the corners' noise is white: its own information less what the fit takes up
    expected = (information - information @ white @ information).sum(axis=0)
    scatter = score.T @ score
    overall = max(float(np.trace(white @ scatter) / max(np.trace(white @ expected), 1.0)), 1.0)
    variance = np.maximum(np.diag(white), 1e-300)
    own = overall * variance + np.diag(white @ scatter @ white)
    factors = np.sqrt(np.maximum(overall, own / (variance + np.diag(white @ expected @ white))))
    return white * np.outer(factors, factors), overall


def _lens_effect(inverse: Array, S: Array, layout: Layout, lens_sd: Mapping[int, Array]) -> Array:
    total = np.zeros_like(S)
    for camera, sd in sorted(lens_sd.items()):
        G = inverse @ S[:, layout.lens(camera)] * sd
        total += G @ G.T
    return total


# --- How far apart cameras see a target.


def displacement_of(linear: Linearised, poses: Ints, shared: int, corners: int) -> float:
    """Estimate the displacement (sd, m) of detections; 0 where noise explains as much.

    ``poses`` (s,): the pose of each; ``shared``: free shared unknowns; ``corners``: how many there are.
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


def whitened(linear: Linearised, tau: float) -> Linearised:
    """Transform the rows so that the residuals are independent again; tau: sd of each detection's displacement, m."""
    A = linear.by_pose[:, :, POSITION]
    values, vectors = np.linalg.eigh(np.swapaxes(A, 1, 2) @ A)
    values = np.maximum(values, 1e-12 * values[:, -1:] + 1e-300)
    shrink = (1 - 1 / np.sqrt(1 + tau**2 * values)) / values
    M = (vectors * shrink[:, None]) @ np.swapaxes(vectors, 1, 2)

    def apply(rows: Array) -> Array:
        return rows - A @ (M @ (np.swapaxes(A, 1, 2) @ rows))

    return Linearised(apply(linear.residual[..., None])[..., 0], apply(linear.by_shared), apply(linear.by_pose))
