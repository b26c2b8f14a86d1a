"""Steps 4 and 5 together: adjust, leave out what contradicts the rest, adjust again, compare the targets' sizes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from .adjustment import CONVERGED, ROUGHLY, Stop, adjust
from .covariance import covariance
from .fit import Fit, lens_covariances
from .lens_prior import lens_prior
from .normal_equations import Bools
from .observations import Layout
from .outliers import LeftOut, bad_corners, contradictions, readmissible
from .scales import comparable_targets, most_seen
from .weighing import allow_displacement, emphasis

MAX_ROUNDS, RETURNS = 12, 3
SCALE_SDS, SCALE_TOLERANCE = 3.0, 0.005


def fit_robustly(fit: Fit, refine_intrinsics: bool = False) -> Fit:
    """Adjusted, without contradictions, noisy sightings weighed down."""
    # Sizes first: a target whose size is given wrongly would contradict everything else.
    base = most_seen(fit.sightings, list(fit.problem.shapes))
    comparable = comparable_targets(fit.sightings, list(fit.problem.shapes), base)
    fit = _without_contradictions(replace(fit, free_scales=comparable))
    fit = _compare_sizes(fit)
    if refine_intrinsics:
        fit = replace(fit, prior=lens_prior(fit.problem, fit.adjusted.state))
    return _settled(fit)


def _settled(fit: Fit) -> Fit:
    """Adjusted with everything: contradictions left out, sightings weighed; what fits after all is taken back."""
    for _ in range(RETURNS):
        fit = allow_displacement(_weigh(_without_contradictions(fit)))
        back = _taken_back(fit)
        if back is fit:
            return fit
        fit = back
    return allow_displacement(_weigh(_narrowed(fit)))


def _without_contradictions(fit: Fit) -> Fit:
    fit = _narrowed(replace(fit, emphasis=np.ones(len(fit.emphasis))))
    back = _taken_back(fit)
    return fit if back is fit else _narrowed(back)


def _taken_back(fit: Fit) -> Fit:
    """With the sightings that were left out and fit now; the same object when there are none."""
    rows = readmissible(fit.adjusted, fit.seen, fit.rows)
    if not rows:
        return fit
    again = {id(fit.all_sightings[row]) for row in rows}
    left_out = tuple(out for out in fit.left_out if id(out.sighting) not in again)
    return replace(fit, rows=np.union1d(fit.rows, rows), left_out=left_out)


def _narrowed(fit: Fit) -> Fit:
    stop = ROUGHLY
    for _ in range(MAX_ROUNDS):
        fit = _adjusted(fit, stop)
        used = fit.used
        wrong = bad_corners(fit.adjusted, used)
        out = contradictions(fit.adjusted, used, fit.sightings, fit.problem.shapes)
        if out or wrong.any():
            fit = _leave_out(fit, wrong, out)
        elif stop is CONVERGED:
            return fit
        else:
            stop = CONVERGED
    return _adjusted(fit)


def _adjusted(fit: Fit, stop: Stop = CONVERGED) -> Fit:
    layout = fit.layout
    adjusted = adjust(fit.adjusted.state, fit.used, layout, fit.free(layout), fit.prior, stop)
    return replace(fit, adjusted=replace(adjusted, iterations=fit.adjusted.iterations + adjusted.iterations))


def _leave_out(fit: Fit, wrong: Bools, out: Sequence[tuple[int, str]]) -> Fit:
    weight = fit.seen.weight.copy()
    weight[fit.rows] = np.where(wrong, 0.0, weight[fit.rows])
    named = tuple(LeftOut(fit.all_sightings[fit.rows[row]], reason) for row, reason in out)
    rows = np.delete(fit.rows, [row for row, _ in out])
    return replace(fit, seen=replace(fit.seen, weight=weight), rows=rows, left_out=fit.left_out + named)


def _weigh(fit: Fit) -> Fit:
    weights = emphasis(fit)
    return _adjusted(replace(fit, emphasis=weights)) if weights.min() < 1 else fit


def _compare_sizes(fit: Fit) -> Fit:
    """The targets' sizes beside the base's; those that agree with what was given are held fixed from now on."""
    if not fit.free_scales.any():
        return fit
    with_lens = Layout(fit.layout.cameras, fit.layout.targets, with_lens=True)
    sd = covariance(
        fit.adjusted, fit.used, fit.free(with_lens), lens_covariances(fit), fit.displacement[fit.rows]
    ).scale
    ratio = fit.adjusted.state.scale
    agree = np.abs(ratio - 1) <= np.maximum(SCALE_SDS * sd, SCALE_TOLERANCE)
    names = list(fit.problem.shapes)
    scale_of = {names[k]: (float(ratio[k]), float(sd[k])) for k in np.flatnonzero(fit.free_scales)}
    state = replace(fit.adjusted.state, scale=np.where(agree, 1.0, ratio))
    return replace(
        fit, adjusted=replace(fit.adjusted, state=state), free_scales=fit.free_scales & ~agree, scale_of=scale_of
    )
