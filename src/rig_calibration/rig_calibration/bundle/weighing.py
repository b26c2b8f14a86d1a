"""Sightings that are believed less than their corners claim."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from .adjustment import huber_weights, normalised_lengths, with_prior
from .covariance import LEAST_FREEDOM
from .displacement import first_tau, next_tau, whitened
from .fit import Fit
from .normal_equations import normal_equations, step
from .pose_misfit import pose_misfit
from .projection import Linearised, linearise
from .rigid import Array

CLEAR = 3.0  # standard deviations above what is usual
DISPLACEMENT_ROUNDS, GAUSS_NEWTON_STEPS = 4, 2


def emphasis(fit: Fit) -> Array:
    """(s,) weights of all sightings: those whose corners scatter clearly more than the others' (blurred) count less."""
    used = fit.used
    corners = np.maximum((used.weight > 0).sum(axis=1), 1)
    variance = (normalised_lengths(fit.adjusted.state, used) ** 2).sum(axis=1) / (2 * corners)
    weights = np.ones(len(fit.emphasis))
    weights[fit.rows] = np.maximum(variance / np.median(variance) / (1 + CLEAR / np.sqrt(corners)), 1.0) ** -0.5
    return weights


def allow_displacement(fit: Fit) -> Fit:
    """Where cameras contradict one another more than corners' noise explains, targets may have moved between them."""
    linear = _weighted_rows(fit)
    misfit, shared = pose_misfit(linear), int(fit.free(fit.layout).shared.sum())
    ratio, freedom = misfit.ratio(linear.residual, int((fit.used.weight > 0).sum()), fit.used.pose, shared)
    if freedom < LEAST_FREEDOM or ratio < 1 + CLEAR * np.sqrt(2 / freedom):
        return fit
    tau = np.full(len(fit.rows), first_tau(linear, misfit, freedom))
    for _ in range(DISPLACEMENT_ROUNDS):
        for _ in range(GAUSS_NEWTON_STEPS):
            fit = _whitened_step(fit, tau)
        tau = next_tau(tau, whitened(_weighted_rows(fit), tau), fit.used.pose)
    displacement = np.zeros(len(fit.displacement))
    displacement[fit.rows] = tau
    return replace(_whitened_step(fit, tau), displacement=displacement)


def _weighted_rows(fit: Fit) -> Linearised:
    used = fit.used.weighted(np.array(1 / fit.adjusted.scale))
    robust = np.sqrt(huber_weights(normalised_lengths(fit.adjusted.state, used)))
    return linearise(fit.adjusted.state, used.weighted(robust), fit.layout.with_lens)


def _whitened_step(fit: Fit, tau: Array) -> Fit:
    state, layout = fit.adjusted.state, fit.layout
    equations = normal_equations(whitened(_weighted_rows(fit), tau), fit.used, layout, len(state.position))
    moved = state.moved(*step(with_prior(equations, fit.prior, state, layout), fit.free(layout), 0.0))
    return replace(fit, adjusted=replace(fit.adjusted, state=moved, iterations=fit.adjusted.iterations + 1))
