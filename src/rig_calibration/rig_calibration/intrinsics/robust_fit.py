"""The adjustment without the views and corners that the others contradict."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from capture_rig.errors import InputError

from ..boards.board import TargetDetection
from .adjustment import Fit, adjust, residuals
from .parameters import Array, LensModel
from .start import ROBUST_SIGMAS, fit_from, start_fit
from .views import MIN_CORNERS, MIN_VIEWS, View

ROUNDS = 2  # more would peel off, layer by layer, what a lens model that is too simple cannot explain
CORNER_SIGMAS = 5.0  # a corner this far off, in robust sds of all, is wrong
VIEW_FACTOR = 3.5  # a view whose median misfit is so many times the typical one is wrong as a whole
AGREEING_SHARE = 0.4  # of the views must agree, else it is anybody's guess who is right
NEGLIGIBLE_PX = 0.3  # misfits below are nobody's fault
MIN_SIGMA_PX = 1e-3  # for corners without any noise
MEDIAN_OF_RAYLEIGH = 1.1774  # median distance of a normal deviate in the plane, in sds of a coordinate


@dataclass(frozen=True, eq=False)
class LeftOut:
    """A view, or single corners of it, that the result does not rest on, and why."""

    detection: TargetDetection
    corners: tuple[int, ...]
    reason: str

    @property
    def whole(self) -> bool:
        return not self.corners


@dataclass(frozen=True, eq=False)
class RobustFit:
    """The fit of the ``views`` that agree, whose sigmas are scaled to their residuals; ``left_out`` is the rest."""

    fit: Fit
    views: tuple[View, ...]
    left_out: tuple[LeftOut, ...]
    sigma_px: float  # of a corner's coordinate, from the residuals; the typical view's


def robust_fit(views: Sequence[View], model: LensModel, *, theta: Array | None = None) -> RobustFit:
    """Adjust, leave out what is wrong, adjust again, until nothing more is wrong.

    ``theta`` (p,) : parameters to start from; by default nothing is known. Raises InputError when too few views agree.
    """
    fit = start_fit(views, model) if theta is None else fit_from(theta, views, model)
    kept: list[View] = list(views)
    left_out: list[LeftOut] = []
    for _ in range(ROUNDS):
        kept = _with_noise(fit, kept, model)
        fit = adjust(fit.theta, fit.poses, kept, model, fit.prior, robust=ROBUST_SIGMAS)
        kept, poses, wrong = _cleaned(fit, kept, model)
        left_out += wrong
        _require_enough(kept, len(views), left_out)
        fit = replace(fit, poses=poses)
        if not wrong:
            break
    # what agrees, by least squares; its noise from what is left
    fit = adjust(fit.theta, fit.poses, _with_noise(fit, kept, model), model, fit.prior)
    kept = _scaled(fit, _with_noise(fit, kept, model), model)
    fit = adjust(fit.theta, fit.poses, kept, model, fit.prior)
    return RobustFit(fit, tuple(kept), tuple(left_out), float(np.median([view.sigma_px for view in kept])))


def _cleaned(fit: Fit, views: Sequence[View], model: LensModel) -> tuple[list[View], Array, list[LeftOut]]:
    """The views, poses (V, 6) and corners that agree with ``fit``; what does not."""
    kept, poses, wrong = [], [], []
    for view, pose in zip(views, fit.poses, strict=True):
        expected = MEDIAN_OF_RAYLEIGH * view.sigma_px
        miss = np.hypot(*residuals(fit.theta, pose, view, model).T)
        off = miss > max(CORNER_SIGMAS * view.sigma_px, NEGLIGIBLE_PX)
        if np.median(miss) > max(VIEW_FACTOR * expected, NEGLIGIBLE_PX) or len(view) - off.sum() < MIN_CORNERS:
            wrong.append(
                LeftOut(
                    view.detection,
                    (),
                    f"its corners lie {np.median(miss):.1f} px from where the other "
                    f"views' lens puts them, against {expected:.2f} px elsewhere",
                )
            )
            continue
        if off.any():
            corners = tuple(map(int, view.ids[off]))
            wrong.append(LeftOut(view.detection, corners, f"up to {miss[off].max():.1f} px off"))
        kept.append(view.without(off))
        poses.append(pose)
    return kept, np.array(poses).reshape(-1, 6), wrong


def _with_noise(fit: Fit, views: Sequence[View], model: LensModel) -> list[View]:
    """The views with the corner noise that their residuals show.

    What the finder of the corners promises is noise of the image alone. Boards that are not quite flat or evenly
    printed, and lenses that the model does not quite describe, add the same to all views; what remains is a common
    factor. By medians: views that are wrong do not matter.
    """
    promised = np.array([max(view.detection.sigma_px, MIN_SIGMA_PX) for view in views])
    seen = np.array(
        [
            np.median(np.hypot(*residuals(fit.theta, pose, view, model).T)) / MEDIAN_OF_RAYLEIGH
            for pose, view in zip(fit.poses, views, strict=True)
        ]
    )
    added = max(float(np.median(seen**2 - promised**2)), 0.0)
    together = np.sqrt(promised**2 + added)
    together *= max(float(np.median(seen / together)), MIN_SIGMA_PX / float(together.min()))
    return [replace(view, sigma_px=float(sigma)) for view, sigma in zip(views, together, strict=True)]


def _scaled(fit: Fit, views: Sequence[View], model: LensModel) -> list[View]:
    """Sigmas so that the sum of squares is what the degrees of freedom let expect: unbiased for white noise."""
    squares, count = 0.0, 0
    for pose, view in zip(fit.poses, views, strict=True):
        squares += float(((residuals(fit.theta, pose, view, model) / view.sigma_px) ** 2).sum())
        count += 2 * len(view)
    scale = np.sqrt(squares / max(count - 6 * len(views) - model.size, 1))
    return [replace(view, sigma_px=max(view.sigma_px * float(scale), MIN_SIGMA_PX)) for view in views]


def _require_enough(views: Sequence[View], count: int, left_out: Sequence[LeftOut]) -> None:
    if len(views) < max(MIN_VIEWS, AGREEING_SHARE * count):
        raise InputError(
            f"the views contradict each other: only {len(views)} of {count} agree ({left_out[0].reason})",
            where=left_out[0].detection.camera,
            remedy="Film one flat board only, keep it and the lens (zoom, focus) fixed, and name the board as it is.",
        )
