"""Intrinsics of one camera from views of a board (thesis 6.1), and which lens model they ask for.

A lens is the bundle adjustment of a rig of one camera, which holds the frame. Free are its lens (with a wide prior),
the board's warp and its pose in each view. Of two models the one is taken that explains the views better; of two that
explain them alike, the one that has a ray for every pixel.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from capture_rig.camera import CameraModel
from capture_rig.errors import InputError
from capture_rig.lens import COEFFICIENTS, Array
from capture_rig.rigid import transform

from ..boards.board import Board, TargetDetection
from ..bundle.initial_poses import initial_poses
from ..bundle.problem import THIN, check_problem, shapes_of, views_of
from ..bundle.robust_fit import Fit, RejectedDetection, adjusted, settled, start_fit
from ..bundle.state import camera_with, residuals_px
from .lens_model import FISHEYE, RATIONAL, LensModel, edge_sd_px, rational_prior
from .result import UNUSED_GOOD, Intrinsics, ModelChoice, ViewResult

AUTO = "auto"
# Thresholds: judgement, no measurement.
WORTHWHILE = 0.02  # relative gain in rms for which more coefficients are taken (by chance they gain 0.0003)
MIN_CORNERS = 8
MIN_VIEWS = 3
FOCAL_TRIALS = np.geomspace(0.2, 5.0, 9)  # of the image's longer side: from a fisheye to a long lens
TRIAL_VIEWS = 12


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
    result = choose_model(usable, board) if model == AUTO else fit_lens(usable, board, LensModel(model))
    return replace(result, camera=replace(result.camera, name=name), left_out=(*poor, *result.left_out))


# --- Which lens model.


def choose_model(views: Sequence[TargetDetection], board: Board) -> Intrinsics:
    """Return the fit of the model that explains the typical view best. A richer model is taken where it explains the
    views better, or alike and has rays for more of the image. (A view has a hundred corners: more coefficients cannot
    adapt to its noise; but which view is the median one may change, so models are compared view by view.) Raises
    InputError where the views contradict each other by every model."""
    fits: dict[str, Intrinsics] = {}
    for name in COEFFICIENTS:
        try:
            fits[name] = fit_lens(views, board, LensModel(name), fits.get(FISHEYE))
        except InputError:  # a fisheye's views contradict each other by the other models
            if name == RATIONAL and not fits:
                raise
    rms_px = {name: fit.typical_px for name, fit in fits.items()}
    best = min(fits.values(), key=lambda fit: fit.typical_px)
    chosen, *richer = [name for name, fit in fits.items() if typical_ratio(fit, best) <= 1 + WORTHWHILE]
    why = ": no better, so the simpler one" if richer else ""
    for name in richer:
        lost, rest = (fits[each].camera.unused_share for each in (chosen, name))
        if lost > rest + UNUSED_GOOD:
            why = f": as good, and {chosen} has no rays for the outer {100 * lost:.1f} % of the image"
            chosen = name
    reason = "rms " + ", ".join(f"{rms_px[name]:.3f} px with {name}" for name in fits)
    return replace(fits[chosen], choice=ModelChoice(chosen, rms_px, reason + why))


def typical_ratio(fit: Intrinsics, other: Intrinsics) -> float:
    """Return by what factor one fit's misfit exceeds another's in the median view; it is infinite, or 0, where only one
    of them left the view out."""
    rms_px, others_px = ({view.detection.frame_index: view.rms_px for view in each.views} for each in (fit, other))
    frames = rms_px.keys() | others_px
    return float(np.median([rms_px.get(k, np.inf) / others_px[k] if k in others_px else 0.0 for k in frames]))


# --- The fit of one model.


def fit_lens(
    detections: Sequence[TargetDetection], board: Board, model: LensModel, wide: Intrinsics | None = None
) -> Intrinsics:
    """Fit a lens of ``model`` to one camera's usable ``detections``, those that contradict the others left out.

    ``wide`` : the fisheye fitted to the same, where a rational lens is wanted and there is one already. Raises
    InputError when too few views agree.
    """
    radial, some = None, detections[:: max(1, len(detections) // TRIAL_VIEWS)]
    if model.name == RATIONAL:
        # its many coefficients are free where no board was seen: there the lens goes on as lenses do
        fisheye = (wide or fit_lens(detections, board, LensModel(FISHEYE))).camera
        radial = rational_prior(fisheye)
        start = replace(fisheye, distortion_model=RATIONAL, D=radial[0])
    else:
        start = _camera_of(adjusted(_fit_from(_best_of_trials(some, board, model), some, board, model)))
    # the plane's two solutions can be told apart only with a lens that is roughly right: poses anew
    fit = settled(_fit_from(start, detections, board, model, radial))
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


def _fit_from(
    camera: CameraModel,
    detections: Sequence[TargetDetection],
    board: Board,
    model: LensModel,
    radial: tuple[Array, Array] | None = None,
) -> Fit:
    """Return the solver's first state: poses by that lens, lens and warp free with their prior."""
    target = detections[0].target
    problem = check_problem({camera.name: camera}, detections, {target: board.corners_board}, (), {})
    views = views_of(problem.detections, problem.cameras, problem.shapes)
    fit = start_fit(problem, views, initial_poses(problem.cameras, views))
    focal_px = float(camera.K.diagonal()[:2].mean())
    prior = model.prior(focal_px, (camera.width, camera.height), diagonal_m(board), radial)
    return replace(fit, prior=prior)


def _camera_of(fit: Fit) -> CameraModel:
    return camera_with(next(iter(fit.problem.cameras.values())), fit.state.lens[0], np.eye(4))


def _result_of(fit: Fit, model: LensModel, board: Board) -> Intrinsics:
    found, used, state = fit.covariance(fit.free), fit.used, fit.state
    sigma_px = float(np.median(1 / used.weight.max(axis=1)) * np.sqrt(found.variance_factor))
    columns, count = model.columns, len(model.names)
    covariance = found.of_shared[columns[:, None], columns]
    sd = np.sqrt(np.diag(covariance)).tolist()
    gone = {out.detection.frame_index for out in fit.left_out if out.whole}
    left_out = [out for out in fit.left_out if out.whole or out.detection.frame_index not in gone]
    views, middle = [], board.corners_board.mean(axis=0)
    for detection, residuals, weight, row in zip(
        fit.detections, residuals_px(state, used), used.weight, used.pose, strict=True
    ):
        kept = np.flatnonzero(weight)  # in the order of the ids
        corners = replace(detection, ids=detection.ids[kept], pixels=detection.pixels[kept])
        R = state.R_pose[row]
        views.append(ViewResult(corners, residuals[kept], transform(R, state.position[row] - R @ middle)))
    camera = _camera_of(fit)
    return Intrinsics(
        camera=camera,
        sigma_px=sigma_px,
        sd=dict(zip(model.names, sd[:count], strict=True)),
        covariance=covariance[:count, :count],
        sd_enlarged_by=float(np.sqrt(found.inflation)),
        board_diagonal_m=diagonal_m(board),
        warp_m=tuple(state.board_warp[0].tolist()),
        warp_sd_m=tuple(sd[count:]),
        views=tuple(views),
        left_out=tuple(sorted(left_out, key=lambda out: out.detection.frame_index)),
        edge_sd_px=edge_sd_px(camera, covariance[:count, :count]),
    )


# --- Which detections can be used.


def usable_detections(
    detections: Sequence[TargetDetection], board: Board
) -> tuple[list[TargetDetection], list[RejectedDetection]]:
    """Select the detections worth adjusting, ordered by frame; those that show too little, with the reason.

    Raises InputError for images of several sizes, and for fewer than three views.
    """
    ordered = sorted(detections, key=lambda detection: detection.frame_index)
    require_one_size(ordered)
    reasons = [why_useless(detection, board) for detection in ordered]
    kept = [detection for detection, reason in zip(ordered, reasons, strict=True) if not reason]
    if len(kept) < MIN_VIEWS:
        raise InputError(
            f"{len(kept)} views of the board can be used, {MIN_VIEWS} are the least",
            where=ordered[0].camera if ordered else "",
            remedy="Take 20 or more, tilted and all over the image; check the board's size.",
        )
    return kept, [RejectedDetection(detection, why) for detection, why in zip(ordered, reasons, strict=True) if why]


def require_one_size(detections: Sequence[TargetDetection]) -> None:
    """Raise InputError for images of several sizes, naming the first frame of each."""
    first = {detection.image_size: detection.frame_index for detection in reversed(detections)}
    if len(first) > 1:
        listed = ", ".join(f"{w} x {h} (first: frame {first[w, h]})" for w, h in sorted(first))
        raise InputError(
            f"the images have several sizes: {listed}",
            where=detections[0].camera,
            remedy="Give images of one size: the one that the camera will work with.",
        )


def why_useless(detection: TargetDetection, board: Board) -> str:
    """Say why a detection is too little to fix the board's pose, "" when it is not."""
    if len(detection) < MIN_CORNERS:
        return f"shows {len(detection)} corners only"
    seen = board.corners_board[detection.ids, :2]
    spread = np.linalg.svd(seen - seen.mean(axis=0), compute_uv=False)
    return "shows corners on one line only" if spread[1] < THIN * spread[0] else ""


def diagonal_m(board: Board) -> float:
    """Return the diagonal of the board's corners, m."""
    return float(np.linalg.norm(np.ptp(board.corners_board, axis=0)))
