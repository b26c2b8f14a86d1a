"""Is the track as sure as it should be: the share of errors inside their own ellipsoids, and the NEES."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.stats import chi2

DIMENSIONS = 3
INSIDE_95 = float(chi2.ppf(0.95, DIMENSIONS))
"""Squared Mahalanobis distance that 95 % of honest errors stay below."""


@dataclass(frozen=True, eq=False)
class Honesty:
    """How the errors of the 15 points compare with the covariances that the track states.

    point_inside_95 : (15,) share of each point's errors inside its 95 % ellipsoid; inside_95 : of all points' together.
    point_nees : (15,) mean normalised estimation error squared, e^T P^-1 e: 3 for honest covariances, more for an
    overconfident track (Bar-Shalom, Li & Kirubarajan, Estimation with Applications to Tracking and Navigation, 5.4);
    nees : of all points together.
    nees_95 : where 95 % of the means of one point's NEES lie for an honest track whose frames err independently of each
    other: chi-square of 3 N degrees over N. Errors that last for many frames spread further.
    NaN where nothing could be compared.
    """

    point_inside_95: np.ndarray
    inside_95: float
    point_nees: np.ndarray
    nees: float
    nees_95: tuple[float, float]


def honesty(errors: np.ndarray, covariance: np.ndarray) -> Honesty:
    """From errors (F, 15, 3) m, NaN where unknown, and the covariances (F, 15, 3, 3) m^2 stated for them."""
    squared = squared_distances(errors, covariance)
    known = np.isfinite(errors).all(-1)
    inside = np.where(known, squared <= INSIDE_95, np.nan)
    count = known.sum(0).max(initial=0)
    interval = chi2.ppf([0.025, 0.975], DIMENSIONS * count) / count if count else [np.nan, np.nan]
    return Honesty(
        _mean(inside, 0),
        float(_mean(inside)),
        _mean(squared, 0),
        float(_mean(squared)),
        (float(interval[0]), float(interval[1])),
    )


def squared_distances(errors: np.ndarray, covariance: np.ndarray) -> np.ndarray:
    """NEES (F, 15) of each error, e^T P^-1 e; NaN where unknown, infinite where P claims certainty."""
    known = np.isfinite(errors).all(-1) & np.isfinite(covariance).all((-2, -1))
    out = np.full(errors.shape[:-1], np.nan)
    certain = known.copy()
    certain[known] = np.linalg.det(covariance[known]) <= 0.0
    out[certain] = np.inf
    regular = known & ~certain
    solved = np.linalg.solve(covariance[regular], errors[regular][..., None])[..., 0]
    out[regular] = np.einsum("ni,ni->n", errors[regular], solved)
    return out


def _mean(values: np.ndarray, axis: int | None = None) -> np.ndarray:
    """Over the known values; NaN where there is none."""
    known = ~np.isnan(values)
    count = known.sum(axis)
    return np.where(count > 0, np.where(known, values, 0.0).sum(axis) / np.maximum(count, 1), np.nan)
