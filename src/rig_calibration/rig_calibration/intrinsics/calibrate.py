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
from ..bundle.outliers import RejectedDetection
from ..bundle.state import residuals_px
from .coverage import placement_of
from .lens_fit import LensFit, diagonal_m, fit_lens, usable_detections, view_squares
from .lens_model import FISHEYE, RATIONAL, LensModel, edge_sd_px
from .result import Intrinsics, ModelChoice, ViewResult, lens_findings

AUTO = "auto"
# Thresholds: judgement, no measurement.
STANDARD_ERRORS = 2.0
WORTHWHILE = 0.02  # relative gain in rms for which more coefficients are taken (by chance they gain 0.0003)
LOST_PX = 10.0  # at most, of a view that a model cannot explain at all
# a model has rays where they are known to that share of the image's width; where they are not, none at all are better
KNOWN_RAYS = 0.05
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
    covariance, enlarged_by = fit.covariance()
    camera = replace(fit.camera, name=name)
    views = tuple(_view_results(fit, board))
    squares = np.concatenate([(view.residuals**2).sum(axis=1) for view in views])
    names, sd = fit.model.names, np.sqrt(np.diag(covariance))
    of_lens = covariance[: len(names), : len(names)]
    return Intrinsics(
        camera=camera,
        rms_px=float(np.sqrt(squares.mean())),
        sigma_px=fit.sigma_px,
        sd=dict(zip(names, sd[: len(names)].tolist(), strict=True)),
        covariance=of_lens,
        sd_enlarged_by=enlarged_by,
        board_diagonal_m=diagonal_m(board),
        warp_m=(float(fit.warp_m[0]), float(fit.warp_m[1])),
        warp_sd_m=(float(sd[-2]), float(sd[-1])),
        views=views,
        left_out=left_out,
        edge_sd_px=edge_sd_px(camera, of_lens),
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
    squares = {name: _squares(fit, views) for name, fit in fits.items()}
    rms_px = {name: float(np.sqrt(np.median(of_views))) for name, of_views in squares.items()}
    chosen, *richer = fits
    reason = "rms " + ", ".join(f"{rms_px[name]:.3f} px with {name}" for name in fits)
    why = ": no better, so the simpler one" if richer else ""
    for name in richer:
        gain = np.log(squares[chosen]) - np.log(squares[name])  # logarithms: no view outweighs the others
        margin = max(STANDARD_ERRORS * gain.std(ddof=1) / np.sqrt(len(gain)), 2 * WORTHWHILE)
        lost, sd = fits[chosen].camera.unused_share, _edge_sd(fits[name])
        wider = lost > fits[name].camera.unused_share + MORE_OF_IMAGE and sd < KNOWN_RAYS
        if gain.mean() > margin:
            chosen, why = name, ""
        elif gain.mean() > -margin and wider:
            why = f": as good, and {chosen} has no rays for the outer {100 * lost:.1f} % of the image"
            chosen = name
    return ModelChoice(chosen, rms_px, reason + why), fits[chosen]


def _squares(fit: LensFit, views: Sequence[TargetDetection]) -> np.ndarray:
    """(V,) px^2 of each view."""
    found = view_squares(fit)
    return np.clip([found[view.frame_index] for view in views], 1e-12, LOST_PX**2)


def _edge_sd(fit: LensFit) -> float:
    """Uncertainty of the outermost rays, as a share of the image's longer side."""
    count = len(fit.model.names)
    return edge_sd_px(fit.camera, fit.covariance()[0][:count, :count]) / max(fit.camera.width, fit.camera.height)
