"""Which lens model: the one that predicts views it has not seen better, and by more than chance; of two that predict
them alike, the one that has a ray for every pixel."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from capture_rig.errors import InputError

from ..boards.board import Board, TargetDetection
from .lens_fit import MIN_VIEWS, fit_lens, held_out_squares
from .lens_model import RATIONAL, LensModel
from .ray_uncertainty import edge_sd_px

AUTO = "auto"
SIMPLE, RICH = "plumb_bob", RATIONAL
FOLDS = 5
STANDARD_ERRORS = 2.0
WORTHWHILE = 0.02  # relative gain in rms for which three more coefficients are taken
LOST_PX = 10.0  # what a view counts for that cannot be predicted at all
# a model has rays where they are known to that share of the image's width; where they are not, none at all are better
KNOWN_RAYS = 0.05
MORE_OF_IMAGE = 0.005  # share of the image that a model must have rays for beyond the other: a finger in one corner


@dataclass(frozen=True)
class ModelChoice:
    """``model`` and why; held_out_px: each model's rms at corners of views that it was not fitted to."""

    model: str
    held_out_px: dict[str, float]
    reason: str


@dataclass(frozen=True, eq=False)
class _Trial:
    """A model's mean squared residual of each view (V,), px^2, by fits to the other views; and the share of the image
    that it has no ray for; edge_sd: uncertainty of its outermost rays, as a share of the image's width."""

    squares: np.ndarray
    unused_share: float
    edge_sd: float

    @property
    def rms_px(self) -> float:
        return float(np.sqrt(np.mean(self.squares)))


def choose_model(views: Sequence[TargetDetection], board: Board) -> ModelChoice:
    """Choose by cross-validation in five folds over the views: each is predicted (but for its pose) by a fit to the
    others. The simpler model that folds inside the image gives way to one that does not and predicts as well."""
    trials = {name: _try(views, board, LensModel(name)) for name in (SIMPLE, RICH)}
    simple, rich = trials[SIMPLE], trials[RICH]
    gain = np.log(simple.squares) - np.log(rich.squares)  # of every view; logarithms: no view outweighs the others
    margin = max(STANDARD_ERRORS * gain.std(ddof=1) / np.sqrt(len(gain)), 2 * WORTHWHILE)
    better = gain.mean() > margin
    wider = simple.unused_share > rich.unused_share + MORE_OF_IMAGE and rich.edge_sd < KNOWN_RAYS
    wider &= bool(gain.mean() > -margin)
    reason = f"held-out rms {simple.rms_px:.3f} px with {SIMPLE}, {rich.rms_px:.3f} px with {RICH}"
    if wider and not better:
        reason += f": as good, and {SIMPLE} has no rays for the outer {100 * simple.unused_share:.1f} % of the image"
    elif not better:
        reason += ": no better, so the simpler one"
    chosen = RICH if better or wider else SIMPLE
    return ModelChoice(chosen, {name: trial.rms_px for name, trial in trials.items()}, reason)


def _try(views: Sequence[TargetDetection], board: Board, model: LensModel) -> _Trial:
    """Fit to all views, then to those of all folds but one in turn."""
    fit = fit_lens(views, board, model)
    everything, of_lens = fit.camera, fit.jackknife_covariance()[0][: len(model.names), : len(model.names)]
    folds = min(FOLDS, len(views))
    squares: dict[int, float] = {}
    for fold in range(folds):
        others = [view for i, view in enumerate(views) if i % folds != fold]
        if len(others) >= MIN_VIEWS:
            try:
                lens = fit_lens(others, board, model, start=everything)
            except InputError:
                continue
            squares |= held_out_squares(lens, views[fold::folds], board)
    of_views = [max(squares.get(view.frame_index, LOST_PX**2), 1e-12) for view in views]
    edge_sd = edge_sd_px(everything, of_lens) / max(everything.width, everything.height)
    return _Trial(np.array(of_views), everything.unused_share, edge_sd)
