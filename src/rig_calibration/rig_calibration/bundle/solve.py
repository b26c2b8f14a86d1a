"""The solver of the rig: from sightings of targets of known size to the poses of all cameras, with covariance."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy.typing as npt

from capture_rig.camera import CameraModel
from capture_rig.errors import InputError

from ..boards.sighting import Sighting
from .fit import NO_POSE, start_fit
from .gauge import choose_reference, in_gauge
from .initial_poses import initial_poses
from .problem import Problem, check_problem
from .report import describe
from .robust_fit import fit_robustly
from .solution import RigSolution
from .view import views_of
from .view_graph import Key, require_connected

__all__ = ["RigSolution", "solve_rig"]


def solve_rig(
    cameras: Mapping[str, CameraModel],
    sightings: Sequence[Sighting],
    targets: Mapping[str, npt.ArrayLike],
    *,
    reference: str | Key | None = None,
    turnable: Mapping[str, int] | None = None,
    intrinsics_covariance: Mapping[str, npt.ArrayLike] | None = None,
    refine_intrinsics: bool = False,
) -> RigSolution:
    """Poses of all ``cameras`` (their own poses are ignored) from ``sightings`` of rigid ``targets`` of known size.

    targets : by name, (n, 3) corners in the target's frame, m. What several cameras see of a target at the same moment
    is in one place. reference : whose frame the poses are in: a camera, a target that was seen at one moment only, or
    (target, moment); the best linked camera by default. turnable : targets whose turns a picture does not show
    (:func:`.target_shape.turns_of`): their numbering is settled by what the cameras agree on. intrinsics_covariance :
    by camera, of fx fy cx cy and the distortion (standard deviations or a matrix); it enlarges the poses' covariance.
    refine_intrinsics : adjust the lenses as well, with that covariance as the prior.

    The same input gives the same result to the last bit, in whatever order sightings and names come. Raises InputError
    for sightings without camera, target or fitting image size, for cameras that see nothing and for groups of cameras
    that share no view (both also when nothing is left after contradictory sightings were left out).
    """
    problem = check_problem(cameras, sightings, targets, turnable or {}, intrinsics_covariance or {})
    _check_refinement(problem, refine_intrinsics)
    # 1. The pose of each target in each picture by itself: all solutions.
    views = views_of(problem.sightings, problem.cameras, problem.shapes)
    # 2. Do the cameras hang together?
    useless = {view.sighting.camera: NO_POSE for view in views if not view.links}
    require_connected(problem.cameras, [view.sighting for view in views if view.links], useless)
    # 3. First poses, by consensus of pairs of cameras and of the views of each target.
    initial = initial_poses(problem.cameras, views)
    # 4, 5. Bundle adjustment; what contradicts the rest is left out, and named; the targets' sizes are compared.
    fit = fit_robustly(start_fit(problem, views, initial), refine_intrinsics)
    require_connected(problem.cameras, fit.sightings, fit.reasons)
    # 6. The frame asked for, and the covariance in it.
    chosen = choose_reference(problem, reference, initial.root)
    return describe(in_gauge(fit, chosen), chosen, initial)


def _check_refinement(problem: Problem, refine_intrinsics: bool) -> None:
    missing = sorted(set(problem.cameras) - set(problem.lens_covariance))
    if refine_intrinsics and missing:
        raise InputError(
            f"the intrinsics of {', '.join(missing)} are to be refined, but how well they are known is not given",
            remedy="Give their covariance, or do not refine them.",
        )
