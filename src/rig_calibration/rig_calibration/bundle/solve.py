"""The solver of the rig: from detections of targets of known size to the poses of all cameras, with covariance."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
import numpy.typing as npt

from capture_rig.camera import CameraModel
from capture_rig.errors import InputError

from ..boards.board import TargetDetection
from .detection_poses import all_undistorted, views_of
from .initial_poses import initial_poses
from .problem import Problem, check_problem
from .robust_fit import NO_POSE, fit_robustly, start_fit
from .solution import RigSolution, choose_reference, in_gauge, to_solution
from .view_graph import PoseKey, require_connected

__all__ = ["RigSolution", "solve_rig"]


def solve_rig(
    cameras: Mapping[str, CameraModel],
    detections: Sequence[TargetDetection],
    targets: Mapping[str, npt.ArrayLike],
    *,
    reference: str | PoseKey | None = None,
    symmetry_orders: Mapping[str, int] | None = None,
    intrinsics_covariance: Mapping[str, npt.ArrayLike] | None = None,
    refine_intrinsics: bool = False,
) -> RigSolution:
    """Solve for the poses of all ``cameras`` (their own poses are ignored) from ``detections`` of rigid ``targets`` of
    known size.

    targets : by name, (n, 3) corners in the target's frame, m. What several cameras see of a target in the same frame
    is in one place. reference : whose frame the poses are in: a camera, a target that was seen in one frame only, or
    (target, frame); the best linked camera by default. symmetry_orders : of targets whose turns a picture does not
    show (:func:`.problem.symmetry_order_of`): their numbering is settled by what the cameras agree on.
    intrinsics_covariance : by camera, of fx fy cx cy and the distortion (standard deviations or a matrix); it enlarges
    the poses' covariance. refine_intrinsics : adjust the lenses as well, with that covariance as the prior.

    The same input gives the same result to the last bit, in whatever order detections and names come. Raises InputError
    for detections without camera, target or fitting image size, for cameras that see nothing and for groups of cameras
    that share no view (both also when nothing is left after contradictory detections were left out).
    """
    problem = check_problem(cameras, detections, targets, symmetry_orders or {}, intrinsics_covariance or {})
    problem = _within_reach(problem)
    _check_refinement(problem, refine_intrinsics)
    # 1. The pose of each target in each picture by itself: all solutions.
    views = views_of(problem.detections, problem.cameras, problem.shapes)
    # 2. Are all cameras tied together by common views?
    useless = {view.detection.camera: NO_POSE for view in views if not view.links}
    require_connected(problem.cameras, [view.detection for view in views if view.links], useless)
    # 3. First poses, by consensus of pairs of cameras and of the views of each target.
    initial = initial_poses(problem.cameras, views)
    # 4, 5. Bundle adjustment; what contradicts the rest is left out, and named; the targets' sizes are compared.
    fit = fit_robustly(start_fit(problem, views, initial), refine_intrinsics)
    require_connected(problem.cameras, fit.detections, fit.reasons)
    # 6. The frame asked for, and the covariance in it.
    chosen = choose_reference(problem, reference, initial.root)
    return to_solution(in_gauge(fit, chosen), chosen, initial)


def _within_reach(problem: Problem) -> Problem:
    """Leave out the corners for which a lens has no ray: its model folds inside the image, and puts no place there."""
    pixels = all_undistorted(problem.detections, problem.cameras)
    reached = [np.isfinite(ideal).all(axis=1) for ideal in pixels]
    within = (
        seen if has.all() else replace(seen, ids=seen.ids[has], pixels=seen.pixels[has])
        for seen, has in zip(problem.detections, reached, strict=True)
    )
    return replace(problem, detections=tuple(within))


def _check_refinement(problem: Problem, refine_intrinsics: bool) -> None:
    missing = sorted(set(problem.cameras) - set(problem.lens_covariance))
    if refine_intrinsics and missing:
        raise InputError(
            f"the intrinsics of {', '.join(missing)} are to be refined, but how well they are known is not given",
            remedy="Calibrate them (sagoma calibrate intrinsics) and keep the reports beside them; or do not refine.",
        )
