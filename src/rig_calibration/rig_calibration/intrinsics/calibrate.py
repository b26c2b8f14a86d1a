"""Intrinsics of one camera from views of a board (thesis 6.1), and which lens model they ask for.

Of two models the one is taken that explains the views better, and by more than chance; of two that explain them alike,
the one that has a ray for every pixel.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from capture_rig.errors import InputError
from capture_rig.lens import COEFFICIENTS
from capture_rig.rigid import transform
from capture_rig.verdict import judge

from ..boards.board import Board, TargetDetection
from ..bundle.robust_fit import RejectedDetection
from ..bundle.state import residuals_px
from .coverage import placement_of
from .lens_fit import LensFit, diagonal_m, fit_lens, usable_detections, view_squares
from .lens_model import FISHEYE, RATIONAL, LensModel, edge_sd_px
from .result import Intrinsics, ModelChoice, ViewResult, lens_findings

AUTO = "auto"
# Thresholds: judgement, no measurement.
WORTHWHILE = 0.02  # relative gain in rms for which more coefficients are taken (by chance they gain 0.0003)
MORE_OF_IMAGE = 0.005  # share of the image that a model must have rays for beyond the other: a finger in one corner


def calibrate_intrinsics(
    detections: Sequence[TargetDetection], board: Board, *, name: str, model: str = "plumb_bob"
) -> Intrinsics:
    """Calibrate the lens of camera ``name`` from what it saw of ``board``; the same detections, in any order, give the
    same bytes.

    ``model`` : plumb_bob, rational_polynomial, equidistant, or auto: the one that explains the views better.
    Raises InputError: images of several sizes, corners that the board has not, too few views that agree.
    """
    usable, poor = usable_detections(detections, board)
    # lens, poses and the board's warp together, without what the other views contradict
    choice, fit = choose_model(usable, board) if model == AUTO else (None, fit_lens(usable, board, LensModel(model)))
    result = _result(fit, board, name, (*poor, *fit.left_out), choice)
    # is it good enough, and if not, what to do
    return replace(result, verdict=judge(lens_findings(result)))


def _result(
    fit: LensFit, board: Board, name: str, left_out: tuple[RejectedDetection, ...], choice: ModelChoice | None
) -> Intrinsics:
    camera = replace(fit.camera, name=name)
    views = tuple(_view_results(fit, board))
    squares = np.concatenate([(view.residuals**2).sum(axis=1) for view in views])
    names, sd = fit.model.names, np.sqrt(np.diag(fit.covariance))
    return Intrinsics(
        camera=camera,
        rms_px=float(np.sqrt(squares.mean())),
        sigma_px=fit.sigma_px,
        sd=dict(zip(names, sd[: len(names)].tolist(), strict=True)),
        covariance=fit.of_lens,
        sd_enlarged_by=float(np.sqrt(fit.inflation)),
        board_diagonal_m=diagonal_m(board),
        warp_m=(float(fit.warp_m[0]), float(fit.warp_m[1])),
        warp_sd_m=(float(sd[-2]), float(sd[-1])),
        views=views,
        left_out=left_out,
        edge_sd_px=edge_sd_px(camera, fit.of_lens),
        choice=choice,
        verdict=judge(()),
    )


def _view_results(fit: LensFit, board: Board) -> list[ViewResult]:
    state, used = fit.fit.adjusted.state, fit.fit.used
    views = []
    for detection, residuals, weight, row in zip(
        fit.fit.detections, residuals_px(state, used), used.weight, used.pose, strict=True
    ):
        kept = np.flatnonzero(weight)  # in the order of the ids
        R, residual = state.R_pose[row], residuals[kept]
        T_camera_middle = transform(R, state.position[row])
        views.append(
            ViewResult(
                detection=detection,
                ids=detection.ids[kept],
                pixels=detection.pixels[kept],
                residuals=residual,
                rms_px=float(np.sqrt((residual**2).sum(axis=1).mean())),
                placement=placement_of(T_camera_middle, detection),
                T_camera_board=transform(R, state.position[row] - R @ board.corners_board.mean(axis=0)),
            )
        )
    return views


# --- Which lens model.


def choose_model(views: Sequence[TargetDetection], board: Board) -> tuple[ModelChoice, LensFit]:
    """Choose by how well each model explains each view, and return its fit. A richer model is taken where it explains
    the views better, or alike and has rays for more of the image. (A view has a hundred corners: more coefficients
    cannot adapt to its noise.) Raises InputError where the views contradict each other by every model."""
    fits: dict[str, LensFit] = {}
    for name in COEFFICIENTS:
        try:
            fits[name] = fit_lens(views, board, LensModel(name), wide=fits.get(FISHEYE))
        except InputError:  # a fisheye's views contradict each other by the other models
            if name == RATIONAL and not fits:
                raise
    rms_px = {name: float(np.sqrt(np.median(view_squares(fit)))) for name, fit in fits.items()}
    chosen, *richer = [name for name in fits if rms_px[name] <= (1 + WORTHWHILE) * min(rms_px.values())]
    why = ": no better, so the simpler one" if richer else ""
    for name in richer:
        lost, rest = (fits[each].camera.unused_share for each in (chosen, name))
        if lost > rest + MORE_OF_IMAGE:
            why = f": as good, and {chosen} has no rays for the outer {100 * lost:.1f} % of the image"
            chosen = name
    reason = "rms " + ", ".join(f"{rms_px[name]:.3f} px with {name}" for name in fits)
    return ModelChoice(chosen, rms_px, reason + why), fits[chosen]
