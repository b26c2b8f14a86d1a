"""Intrinsics of one camera from views of a board (thesis 6.1)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import cv2
import numpy as np

from capture_rig.camera import CameraModel
from capture_rig.verdict import judge

from ..boards.board import Board, TargetDetection
from ..bundle.outliers import LeftOut
from ..bundle.projection import residuals_px
from ..bundle.rigid import transform
from .coverage import placement_of
from .lens_fit import LensFit, diagonal_m, fit_lens, usable_detections
from .lens_model import Array, LensModel
from .model_choice import AUTO, ModelChoice, choose_model
from .result import Intrinsics, ViewResult
from .verdict import lens_findings


def calibrate_intrinsics(
    detections: Sequence[TargetDetection], board: Board, *, name: str, model: str = "plumb_bob"
) -> Intrinsics:
    """Calibrate the lens of camera ``name`` from what it saw of ``board``; the same detections, in any order, give the
    same bytes.

    ``model`` : plumb_bob, rational_polynomial, or auto: the one that predicts views it has not seen better.
    Raises InputError: images of several sizes, corners that the board has not, too few views that agree.
    """
    usable, poor = usable_detections(detections, board)
    # which lens model
    choice = choose_model(usable, board) if model == AUTO else None
    # lens, poses and the board's bending together, without what the other views contradict
    fit = fit_lens(usable, board, LensModel(choice.model if choice else model))
    # how well the lens is known
    covariance, jackknife = fit.jackknife_covariance()
    result = _result(fit, board, name, covariance, jackknife, (*poor, *fit.left_out), choice)
    # is it good enough, and if not, what to do
    return replace(result, verdict=judge(lens_findings(result)))


def projection_sd(camera: CameraModel, covariance: Array, pixels: Array) -> Array:
    """(n,) px: how uncertain it is where a ray is seen that is seen at ``pixels`` (n, 2), apart from a common rotation
    of the camera, which extrinsics take up. The larger axis of the error ellipse; NaN where the lens has no ray.

    ``covariance`` : of the lens's parameters, in order."""
    ideal = camera.ideal_points(pixels)
    reached = np.isfinite(ideal).all(axis=1)
    sd = np.full(len(pixels), np.nan)
    if not reached.any():
        return sd
    rays = np.column_stack([ideal[reached], np.ones(int(reached.sum()))])
    _, jacobian = cv2.projectPoints(rays, np.zeros(3), np.zeros(3), camera.K, camera.D)
    by_rotation, by_lens = jacobian[:, :3], jacobian[:, 6 : 6 + len(covariance)]
    by_lens = by_lens - by_rotation @ np.linalg.lstsq(by_rotation, by_lens, rcond=None)[0]
    blocks = by_lens.reshape(len(rays), 2, -1)
    ellipses = blocks @ covariance @ blocks.transpose(0, 2, 1)
    sd[reached] = np.sqrt(np.linalg.eigvalsh(ellipses)[:, -1].clip(0.0))
    return sd


def _result(
    fit: LensFit,
    board: Board,
    name: str,
    covariance: Array,
    jackknife: float,
    left_out: tuple[LeftOut, ...],
    choice: ModelChoice | None,
) -> Intrinsics:
    camera = replace(fit.camera, name=name)
    views = tuple(_view_results(fit, board))
    squares = np.concatenate([(view.residuals**2).sum(axis=1) for view in views])
    names, sd = fit.model.names, np.sqrt(np.diag(covariance))
    of_lens = covariance[: len(names), : len(names)]
    corners = np.array([[x, y] for y in (0, camera.height - 1) for x in (0, camera.width - 1)], float)
    return Intrinsics(
        camera=camera,
        rms_px=float(np.sqrt(squares.mean())),
        sigma_px=fit.sigma_px,
        sd=dict(zip(names, sd[: len(names)].tolist(), strict=True)),
        covariance=of_lens,
        jackknife=jackknife,
        board_diagonal_m=diagonal_m(board),
        bow_m=(float(fit.bow_m[0]), float(fit.bow_m[1])),
        bow_sd_m=(float(sd[-2]), float(sd[-1])),
        views=views,
        left_out=left_out,
        edge_sd_px=float(np.nan_to_num(projection_sd(camera, of_lens, corners), nan=np.inf).max()),
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
