"""Intrinsics of one camera from views of a board (thesis 6.1)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from capture_rig.verdict import judge

from ..boards.board import Board, TargetDetection
from ..bundle.outliers import LeftOut
from ..bundle.projection import residuals_px
from ..bundle.rigid import transform
from .coverage import placement_of
from .lens_fit import LensFit, diagonal_m, fit_lens, usable_detections
from .lens_model import LensModel
from .model_choice import AUTO, ModelChoice, choose_model
from .ray_uncertainty import edge_sd_px
from .result import Intrinsics, ViewResult
from .verdict import lens_findings


def calibrate_intrinsics(
    detections: Sequence[TargetDetection], board: Board, *, name: str, model: str = "plumb_bob"
) -> Intrinsics:
    """Calibrate the lens of camera ``name`` from what it saw of ``board``; the same detections, in any order, give the
    same bytes.

    ``model`` : plumb_bob, rational_polynomial, or auto: the one that explains the views better.
    Raises InputError: images of several sizes, corners that the board has not, too few views that agree.
    """
    usable, poor = usable_detections(detections, board)
    # lens, poses and the board's bending together, without what the other views contradict
    choice, fit = choose_model(usable, board) if model == AUTO else (None, fit_lens(usable, board, LensModel(model)))
    result = _result(fit, board, name, (*poor, *fit.left_out), choice)
    # is it good enough, and if not, what to do
    return replace(result, verdict=judge(lens_findings(result)))


def _result(
    fit: LensFit, board: Board, name: str, left_out: tuple[LeftOut, ...], choice: ModelChoice | None
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
        bow_m=(float(fit.bow_m[0]), float(fit.bow_m[1])),
        bow_sd_m=(float(sd[-2]), float(sd[-1])),
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
