"""Intrinsics of one camera from views of a board (thesis 6.1), and the choice of the lens model.

A lens is the bundle adjustment of a rig of one camera, which holds the frame. Free are its lens (with a wide prior),
the board's warp and its pose in each view. Of two models the one that explains the views better is chosen; of two that
explain them alike, the one that has a ray for every pixel.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from capture_rig.camera import CameraModel
from capture_rig.errors import InputError
from capture_rig.rigid import transform

from ..boards.board import Board, TargetDetection
from ..bundle.initial_poses import initial_poses
from ..bundle.problem import check_problem, shapes_of, views_of
from ..bundle.robust_fit import RobustFit, adjusted, settled, start_fit
from ..bundle.solve import covariance
from ..bundle.state import camera_with, residuals_px
from .lens_model import FISHEYE, MODELS, SIMPLE, LensModel, edge_sd_px
from .result import UNUSED_GOOD, Intrinsics, ViewResult

AUTO = "auto"
# Thresholds: judgement, no measurement.
WORTHWHILE = 0.02  # relative gain in rms that justifies more coefficients (by chance they gain 0.0003)
MIN_VIEWS = 3
FOCAL_TRIALS = np.geomspace(0.2, 5.0, 9)  # of the image's longer side: from a fisheye to a long lens
TRIAL_VIEWS = 12


def calibrate_intrinsics(
    detections: Sequence[TargetDetection], board: Board, *, name: str, model: str = SIMPLE
) -> Intrinsics:
    """Calibrate the lens of camera ``name`` from its detections of ``board``; the same detections, in any order, give
    the same bytes.

    ``model`` : one of MODELS, or auto: the one that explains the views better. Raises InputError: images of several
    sizes, too few views that agree.
    """
    views = sorted(detections, key=lambda detection: detection.frame_index)
    if len(views) < MIN_VIEWS:
        raise InputError(
            f"{len(views)} views of the board can be used, {MIN_VIEWS} are the least",
            where=name,
            remedy="Take 20 or more, tilted and all over the image; check the board's size.",
        )
    # lens, poses and the board's warp together, without contradicting views
    result = choose_model(views, board) if model == AUTO else fit_lens(views, board, LensModel(model))
    return replace(result, camera=replace(result.camera, name=name))


# --- Which lens model.


def choose_model(views: Sequence[TargetDetection], board: Board) -> Intrinsics:
    """Return the fit of the simple model, or of the fisheye's where that explains the typical view better, or alike and
    has rays for more of the image. (A view has a hundred corners: more coefficients cannot adapt to its noise; but
    which view is the median one may change, so models are compared view by view.) Raises InputError where the views
    contradict each other by both."""
    fits: dict[str, Intrinsics] = {}
    for name in MODELS:
        try:
            fits[name] = fit_lens(views, board, LensModel(name))
        except InputError:  # a fisheye's views contradict each other by the other model
            if name == FISHEYE and not fits:
                raise
    chosen, why = next(iter(fits.values())), ""
    if len(fits) > 1:
        simple, fisheye = fits[SIMPLE], fits[FISHEYE]
        wider = simple.camera.unused_share > fisheye.camera.unused_share + UNUSED_GOOD
        most = 1 + WORTHWHILE
        if typical_ratio(simple, fisheye) > most or (wider and typical_ratio(fisheye, simple) <= most):
            chosen, why = fisheye, f": {SIMPLE} has no rays for {simple.camera.unused_share:.1%} of the image" * wider
        else:
            why = ": no better, so the simpler one"
    rms_px = ", ".join(f"{fit.typical_px:.3f} px with {name}" for name, fit in fits.items())
    return replace(chosen, choice=f"{chosen.camera.distortion_model}, rms {rms_px}{why}")


def typical_ratio(fit: Intrinsics, other: Intrinsics) -> float:
    """Return the ratio of two fits' misfits in the median view; infinite, or 0, for a view that only one of them left
    out."""
    rms_px, others_px = ({view.detection.frame_index: view.rms_px for view in each.views} for each in (fit, other))
    frames = rms_px.keys() | others_px
    return float(np.median([rms_px.get(k, np.inf) / others_px[k] if k in others_px else 0.0 for k in frames]))


# --- The fit of one model.


def fit_lens(detections: Sequence[TargetDetection], board: Board, model: LensModel) -> Intrinsics:
    """Fit a lens of ``model`` to one camera's ``detections``, those that contradict the others left out. Raises
    InputError when too few views agree."""
    some = detections[:: max(1, len(detections) // TRIAL_VIEWS)]
    start = _camera_of(adjusted(_fit_from(_best_of_trials(some, board, model), some, board, model)))
    # only a roughly right lens distinguishes the plane's two solutions: poses anew
    fit = settled(_fit_from(start, detections, board, model))
    if len(fit.rows) < MIN_VIEWS:
        reason = fit.left_out[0].reason if fit.left_out else "too few fit any pose of the board"
        raise InputError(
            f"the views contradict each other: only {len(fit.rows)} of {len(detections)} agree ({reason})",
            where=detections[0].camera,
            remedy="Film one flat board only, keep it and the lens (zoom, focus) fixed, and name the board as it is.",
        )
    return _result_of(fit, model, board)


def _best_of_trials(detections: Sequence[TargetDetection], board: Board, model: LensModel) -> CameraModel:
    """Return the focal length that explains the views' perspective best."""
    size = detections[0].image_size
    trials = [model.camera(detections[0].camera, share * max(size), size) for share in FOCAL_TRIALS]
    shapes = shapes_of({detections[0].target: board.corners_board})

    def typical_misfit(camera: CameraModel) -> float:
        poses = [view.poses for view in views_of(detections, {camera.name: camera}, shapes)]
        return float(np.median([np.inf if found is None else found.rms_px[0] for found in poses]))

    return min(trials, key=typical_misfit)


def _fit_from(camera: CameraModel, detections: Sequence[TargetDetection], board: Board, model: LensModel) -> RobustFit:
    """Return the solver's first state: poses by that lens, lens and warp free with their prior."""
    target = detections[0].target
    problem = check_problem({camera.name: camera}, detections, {target: board.corners_board}, (), {})
    views = views_of(problem.detections, problem.cameras, problem.shapes)
    fit = start_fit(problem, views, initial_poses(problem.cameras, views))
    focal_px = float(camera.K.diagonal()[:2].mean())
    prior = model.prior(focal_px, (camera.width, camera.height), diagonal_m(board))
    return replace(fit, prior=prior)


def _camera_of(fit: RobustFit) -> CameraModel:
    return camera_with(next(iter(fit.problem.cameras.values())), fit.state.lens[0], np.eye(4))


def _result_of(fit: RobustFit, model: LensModel, board: Board) -> Intrinsics:
    found, used, state = covariance(fit, fit.free), fit.used, fit.state
    sigma_px = float(np.median(1 / used.weight.max(axis=1)) * np.sqrt(found.variance_factor))
    columns, count = model.columns, len(model.names)
    of_lens_and_board = found.of_shared[columns[:, None], columns]
    of_lens = of_lens_and_board[:count, :count]
    sd = np.sqrt(np.diag(of_lens_and_board)).tolist()
    views, middle = [], board.corners_board.mean(axis=0)
    for detection, residuals, row in zip(fit.detections, residuals_px(state, used), used.pose, strict=True):
        R = state.R_pose[row]
        T_camera_board = transform(R, state.position[row] - R @ middle)
        views.append(ViewResult(detection, residuals[: len(detection)], T_camera_board))
    camera = _camera_of(fit)
    return Intrinsics(
        camera=camera,
        sigma_px=sigma_px,
        sd=dict(zip(model.names, sd[:count], strict=True)),
        covariance=of_lens,
        sd_enlarged_by=float(np.sqrt(found.inflation)),
        board_diagonal_m=diagonal_m(board),
        warp_m=tuple(state.board_warp[0].tolist()),
        warp_sd_m=tuple(sd[count:]),
        views=tuple(views),
        left_out=tuple(sorted(fit.left_out, key=lambda out: out.detection.frame_index)),
        edge_sd_px=edge_sd_px(camera, of_lens),
    )


def diagonal_m(board: Board) -> float:
    """Return the diagonal of the board's corners, m."""
    return float(np.linalg.norm(np.ptp(board.corners_board, axis=0)))
