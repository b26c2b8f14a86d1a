"""What is known of the lenses before they are refined."""

from __future__ import annotations

import numpy as np

from .adjustment import Prior
from .observations import Layout, State
from .problem import Problem
from .rigid import Array


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
