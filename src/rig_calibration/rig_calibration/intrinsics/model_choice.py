"""Which lens model: the one that predicts views it has not seen better, and by more than chance."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from capture_rig.errors import InputError

from ..boards.board import Board, TargetDetection
from .lens_fit import MIN_VIEWS, fit_lens, held_out_squares
from .lens_model import LensModel

AUTO = "auto"
SIMPLE, RICH = "plumb_bob", "rational_polynomial"
FOLDS = 5
STANDARD_ERRORS = 2.0
WORTHWHILE = 0.02  # relative gain in rms for which three more coefficients are taken
LOST_PX = 10.0  # what a view counts for that cannot be predicted at all


@dataclass(frozen=True)
class ModelChoice:
    """``model`` and why; held_out_px: each model's rms at corners of views that it was not fitted to."""

    model: str
    held_out_px: dict[str, float]
    reason: str


def choose_model(views: Sequence[TargetDetection], board: Board) -> ModelChoice:
    """Choose by cross-validation in five folds over the views: each is predicted (but for its pose) by a fit to the
    others."""
    squares = {name: _held_out(views, board, LensModel(name)) for name in (SIMPLE, RICH)}
    rms = {name: float(np.sqrt(np.mean(value))) for name, value in squares.items()}
    gain = np.log(squares[SIMPLE]) - np.log(squares[RICH])  # of every view; logarithms: no view outweighs the others
    error = gain.std(ddof=1) / np.sqrt(len(gain))
    better = gain.mean() > max(STANDARD_ERRORS * error, 2 * WORTHWHILE)
    reason = f"held-out rms {rms[SIMPLE]:.3f} px with {SIMPLE}, {rms[RICH]:.3f} px with {RICH}"
    return ModelChoice(RICH if better else SIMPLE, rms, reason + ("" if better else ": no better, so the simpler one"))


def _held_out(views: Sequence[TargetDetection], board: Board, model: LensModel) -> np.ndarray:
    """(V,) mean squared residual of each view, px^2, by a fit to the views of the other folds."""
    everything = fit_lens(views, board, model).camera
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
    return np.array([max(squares.get(view.frame_index, LOST_PX**2), 1e-12) for view in views])
