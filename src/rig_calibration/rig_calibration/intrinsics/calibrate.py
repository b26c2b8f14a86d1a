"""Intrinsics of one camera from views of a board (thesis 6.1)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import cv2
import numpy as np

from capture_rig.camera import CameraModel
from capture_rig.verdict import judge

from ..boards.board import Board, TargetDetection
from .adjustment import residuals
from .model_choice import AUTO, ModelChoice, choose_model
from .parameters import Array, LensModel
from .result import Intrinsics, ViewResult
from .robust_fit import LeftOut, RobustFit, robust_fit
from .start import placement_of
from .uncertainty import jackknife_covariance, projection_sd
from .verdict import lens_findings
from .views import View, diagonal_m, make_views


def calibrate_intrinsics(
    detections: Sequence[TargetDetection], board: Board, *, name: str, model: str = "plumb_bob"
) -> Intrinsics:
    """The lens of camera ``name`` from what it saw of ``board``; the same detections give the same bytes, in any order.

    ``model`` : plumb_bob, rational_polynomial, or auto: the one that predicts views it has not seen better.
    Raises InputError: images of several sizes, corners that the board has not, too few views that agree.
    """
    views, poor = make_views(detections, board)
    # which lens model
    choice = choose_model(views) if model == AUTO else None
    lens_model = LensModel(choice.model if choice else model)
    # camera, poses and the board's bending together, without what the other views contradict
    robust = robust_fit(views, lens_model)
    # how well the camera is known
    covariance, jackknife = jackknife_covariance(robust.fit)
    left_out = (*(LeftOut(detection, (), reason) for detection, reason in poor), *robust.left_out)
    result = _result(robust, lens_model, board, name, covariance, jackknife, left_out, choice)
    # is it good enough, and if not, what to do
    return replace(result, verdict=judge(lens_findings(result)))


def _result(
    robust: RobustFit,
    model: LensModel,
    board: Board,
    name: str,
    covariance: Array,
    jackknife: float,
    left_out: tuple[LeftOut, ...],
    choice: ModelChoice | None,
) -> Intrinsics:
    theta, unit_m = robust.fit.theta, diagonal_m(board)
    width, height = robust.views[0].detection.image_size
    camera = CameraModel(name, width, height, model.K(theta), model.name, model.D(theta), np.eye(4))
    views = tuple(
        _view_result(theta, pose, view, model, board) for pose, view in zip(robust.fit.poses, robust.views, strict=True)
    )
    squares = np.concatenate([(view.residuals**2).sum(axis=1) for view in views])
    sd = np.sqrt(np.diag(covariance))
    corners = np.array([[0, 0], [width - 1, 0], [0, height - 1], [width - 1, height - 1]], float)
    return Intrinsics(
        camera=camera,
        rms_px=float(np.sqrt(squares.mean())),
        sigma_px=robust.sigma_px,
        sd=dict(zip(model.names, sd[model.camera].tolist(), strict=True)),
        covariance=covariance[model.camera, model.camera],
        jackknife=jackknife,
        board_diagonal_m=unit_m,
        bow_m=(float(theta[-2] * unit_m), float(theta[-1] * unit_m)),
        bow_sd_m=(float(sd[-2] * unit_m), float(sd[-1] * unit_m)),
        views=views,
        left_out=left_out,
        edge_sd_px=float(np.nan_to_num(projection_sd(theta, covariance, model, corners), nan=np.inf).max()),
        choice=choice,
        verdict=judge(()),
    )


def _view_result(theta: Array, pose: Array, view: View, model: LensModel, board: Board) -> ViewResult:
    residual = residuals(theta, pose, view, model)
    rms = float(np.sqrt((residual**2).sum(axis=1).mean()))
    T = np.eye(4)
    T[:3, :3] = cv2.Rodrigues(pose[:3])[0]
    T[:3, 3] = pose[3:] * diagonal_m(board) - T[:3, :3] @ board.corners_board.mean(axis=0)
    return ViewResult(view.detection, view.ids, view.pixels, residual, rms, placement_of(pose, view), T)
