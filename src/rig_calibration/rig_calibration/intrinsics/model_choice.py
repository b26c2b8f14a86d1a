"""Which lens model: the one that explains the views better, and by more than chance; of two that explain them alike,
the one that has a ray for every pixel."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ..boards.board import Board, TargetDetection
from .lens_fit import LensFit, fit_lens, view_squares
from .lens_model import RATIONAL, LensModel
from .ray_uncertainty import edge_sd_px

AUTO = "auto"
SIMPLE, RICH = "plumb_bob", RATIONAL
# Thresholds: judgement, no measurement.
STANDARD_ERRORS = 2.0
WORTHWHILE = 0.02  # relative gain in rms for which three more coefficients are taken (by chance they gain 0.0003)
LOST_PX = 10.0  # at most, of a view that a model cannot explain at all
# a model has rays where they are known to that share of the image's width; where they are not, none at all are better
KNOWN_RAYS = 0.05
MORE_OF_IMAGE = 0.005  # share of the image that a model must have rays for beyond the other: a finger in one corner


@dataclass(frozen=True)
class ModelChoice:
    """``model`` and why; rms_px: of a corner's coordinate in the median view, by model."""

    model: str
    rms_px: dict[str, float]
    reason: str


def choose_model(views: Sequence[TargetDetection], board: Board) -> tuple[ModelChoice, LensFit]:
    """Choose by how well each model explains each view, and return its fit. The simpler model that folds inside the
    image gives way to one that does not and explains as well. (A view has a hundred corners: the three coefficients
    more cannot adapt to its noise.)"""
    fits = {name: fit_lens(views, board, LensModel(name)) for name in (SIMPLE, RICH)}
    squares = {name: _squares(fit, views) for name, fit in fits.items()}
    rms_px = {name: float(np.sqrt(np.median(of_views))) for name, of_views in squares.items()}
    gain = np.log(squares[SIMPLE]) - np.log(squares[RICH])  # of every view; logarithms: no view outweighs the others
    margin = max(STANDARD_ERRORS * gain.std(ddof=1) / np.sqrt(len(gain)), 2 * WORTHWHILE)
    unused_share = {name: fit.camera.unused_share for name, fit in fits.items()}
    better = gain.mean() > margin
    wider = unused_share[SIMPLE] > unused_share[RICH] + MORE_OF_IMAGE and _edge_sd(fits[RICH]) < KNOWN_RAYS
    wider &= bool(gain.mean() > -margin)
    reason = f"rms {rms_px[SIMPLE]:.3f} px with {SIMPLE}, {rms_px[RICH]:.3f} px with {RICH}"
    if wider and not better:
        reason += f": as good, and {SIMPLE} has no rays for the outer {100 * unused_share[SIMPLE]:.1f} % of the image"
    elif not better:
        reason += ": no better, so the simpler one"
    chosen = RICH if better or wider else SIMPLE
    return ModelChoice(chosen, rms_px, reason), fits[chosen]


def _squares(fit: LensFit, views: Sequence[TargetDetection]) -> np.ndarray:
    """(V,) px^2 of each view."""
    found = view_squares(fit)
    return np.clip([found[view.frame_index] for view in views], 1e-12, LOST_PX**2)


def _edge_sd(fit: LensFit) -> float:
    """Uncertainty of the outermost rays, as a share of the image's longer side."""
    count = len(fit.model.names)
    return edge_sd_px(fit.camera, fit.covariance()[0][:count, :count]) / max(fit.camera.width, fit.camera.height)
