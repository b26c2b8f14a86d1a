"""The solver of the rig: from detections of targets of known size to the poses of all cameras, with covariance."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from capture_rig.camera import CameraModel
from capture_rig.errors import InputError
from capture_rig.lens import NEGLIGIBLE, Array
from capture_rig.rigid import transform

from ..boards.board import TargetDetection
from .adjustment import HUBER, FreeUnknowns, Prior, normal_equations, normalised_lengths, reduce, shared_of, step
from .initial_poses import cameras_by_pose, initial_poses, require_connected
from .problem import PoseKey, Problem, check_problem, views_of
from .robust_fit import NO_POSE, RejectedDetection, RobustFit, settled, start_fit, whitened
from .state import Bools, BundleState, camera_with, residuals_px


@dataclass(frozen=True, eq=False)
class RigSolution:
    """The poses of all cameras and targets, in the frame of the reference, with their quality.

    cameras : the cameras, with these poses as their ``T_camera_world`` (and refined lenses, if asked for).
    T_reference_target : (4, 4) by (target, frame).
    detections, residuals_px : those used, with corrected ids, and seen minus predicted pixels (n, 2) of each.
    rms_px : by camera, root mean square distance of its corners (sqrt(2) times the noise of one coordinate, as OpenCV
    reports it).
    covariance : (6, 6) by camera, relative to the reference: rotation vector (rad, in the camera's frame), centre (m,
    in the reference's frame). inflation : its ratio to the covariance from independent corner errors (1: equal), as the
    errors of the corners at one pose of a target are correlated: by motion between the exposures, a bent board, a lens.
    sync_error_m : motion (sd) of the targets between the cameras' exposures, 0 if there is no evidence of any.
    left_out : rejected detections, with the reason (without those of a wand that no other camera saw).
    undecided : cameras whose half turn is not determined. scale_of : by target, its size against the most seen one over
    the size given, and its standard deviation (SIZE_SD if they were not compared). focal_of : by camera, the focal
    length that fits all views over the one given (or refined), and its standard deviation: far from 1, the intrinsics
    are not this camera's.
    """

    cameras: dict[str, CameraModel]
    T_reference_target: dict[PoseKey, Array]
    detections: tuple[TargetDetection, ...]
    residuals_px: tuple[Array, ...]
    rms_px: dict[str, float]
    covariance: dict[str, Array]
    inflation: float
    sync_error_m: float
    left_out: tuple[RejectedDetection, ...]
    undecided: tuple[str, ...]
    scale_of: dict[str, tuple[float, float]]
    focal_of: dict[str, tuple[float, float]]


def solve_rig(
    cameras: Mapping[str, CameraModel],
    detections: Sequence[TargetDetection],
    targets: Mapping[str, npt.ArrayLike],
    *,
    reference: PoseKey | None = None,
    alike: Collection[str] = (),
    intrinsics_sd: Mapping[str, Sequence[float]] | None = None,
) -> RigSolution:
    """Solve for the poses of all ``cameras`` (their own poses are ignored) from ``detections`` of rigid ``targets`` of
    known size.

    targets : by name, (n, 3) corners in the target's frame, m. In one frame of all cameras a target is in one place.
    reference : (target, frame) whose frame the poses are in; by default that of the camera that is linked best. alike :
    targets that look the same after half a turn: their numbering is settled by agreement of the cameras.
    intrinsics_sd : by camera, standard deviations of fx fy cx cy [and the distortion]; they enlarge the poses'
    covariance.

    The same input gives the same result to the last bit, in whatever order detections and names come. Raises InputError
    for detections of another image size, for cameras that see nothing and groups that share no view (both also
    when nothing is left after contradictory detections were left out), and for a reference that contradicts the rest.
    """
    problem = check_problem(cameras, detections, targets, alike, intrinsics_sd or {})
    # 1. The pose of each target in each picture by itself: all solutions.
    views = views_of(problem.detections, problem.cameras, problem.shapes)
    # 2. Are all cameras tied together by common views?
    useless = {view.detection.camera: NO_POSE for view in views if not view.links}
    require_connected(problem.cameras, [view.detection for view in views if view.links], useless)
    # 3. First poses, by consensus of pairs of cameras and of the views of each target.
    initial = initial_poses(problem.cameras, views)
    # 4, 5. Bundle adjustment; contradicting detections are left out, and named.
    fit = settled(start_fit(problem, views, initial))
    require_connected(problem.cameras, fit.detections, fit.reasons)
    # 6. The requested frame, and the covariance in it.
    row = None if reference is None else problem.keys.index(reference)
    if row is not None and row not in fit.used.pose:
        what = f"the reference, target '{problem.keys[row][0]}' in frame {problem.keys[row][1]}, contradicts the rest"
        raise InputError(what, remedy="Take its pictures again.")
    return _solution(fit if row is None else _in_frame_of(row, fit), row)


# --- The frame of the solution.


def _in_frame_of(row: int, fit: RobustFit) -> RobustFit:
    """Transform the solution into the target's own frame at pose ``row``."""
    state = fit.state
    R, origin = state.R_pose[row].T, _target_origin(fit.problem, state, row)
    moved = replace(
        state,
        R_camera=state.R_camera @ R.T,
        centre=(state.centre - origin) @ R.T,
        R_pose=R @ state.R_pose,
        position=(state.position - origin) @ R.T,
    )
    return replace(fit, state=moved)


def _target_origin(problem: Problem, state: BundleState, row: int) -> Array:
    """Return (3,) where the origin of the target's own frame lies, for pose ``row``."""
    names = list(problem.shapes)
    name = problem.keys[row][0]
    return state.position[row] - state.scale[names.index(name)] * state.R_pose[row] @ problem.shapes[name].centroid


# --- A check of the focal lengths that were given.
#
# One Gauss-Newton step away from the solution, with focal lengths and principal points of all cameras set free: if the
# intrinsics are right, it changes them by no more than their standard deviations. (A board that only one camera sees
# tells little about them: a longer lens looks like a board farther away. Another camera knows where the board is.)

WIDE = 0.1  # of the focal length: standard deviation of the prior of all four
PINHOLE = 4


def _focal_ratios(fit: RobustFit) -> dict[str, tuple[float, float]]:
    """Return, by camera, the ratio of the focal length that fits all views to the given one, and its standard
    deviation."""
    state, names = fit.state, list(fit.problem.cameras)
    layout = state.layout
    focal_px = np.sqrt(state.lens[:, 0] * state.lens[:, 1])
    pinholes = np.array([np.arange(layout.size)[layout.lens(row)][:PINHOLE] for row in range(len(names))])
    information = fit.prior.information.copy()
    information[pinholes, pinholes] = (WIDE * focal_px[:, None]) ** -2.0
    fit = replace(fit, prior=Prior(shared_of(state), information))
    linear = whitened(fit.rows_at_solution(), fit.displacement_m)
    equations = normal_equations(linear, fit.used, state, fit.prior)
    change = step(equations, fit.free, 0.0)[0]
    S = reduce(equations, fit.free).information.sum(axis=0) + information
    variance = np.diag(inverse_over(S, fit.free.shared))
    found = {}
    for row, (name, focal) in enumerate(zip(names, pinholes[:, :2], strict=True)):
        ratio = float(np.mean(1 + change[focal] / state.lens[row, :2]))
        found[name] = ratio, float(np.sqrt(variance[focal].mean()) / focal_px[row])
    return found


def _solution(fit: RobustFit, reference: int | None) -> RigSolution:
    """Make the solution: poses, residuals, covariance relative to the reference, rejected detections with reasons."""
    problem, state, used, layout = fit.problem, fit.state, fit.used, fit.state.layout
    names = list(problem.cameras)
    T_camera = transform(state.R_camera, -(state.R_camera @ state.centre[..., None])[..., 0])
    T_target = {
        key: transform(state.R_pose[row], _target_origin(problem, state, row))
        for row, key in enumerate(problem.keys)
        if row in used.pose
    }
    residuals = residuals_px(state, used)
    squares = np.where(used.weight > 0, (residuals**2).sum(axis=2), np.nan)
    rms_px = [float(np.sqrt(np.nanmean(squares[used.camera == row]))) for row in range(len(names))]
    found = covariance(fit, _free(fit, reference))
    posed = zip(names, state.lens, T_camera, strict=True)
    return RigSolution(
        cameras={name: camera_with(problem.cameras[name], lens, T) for name, lens, T in posed},
        T_reference_target=T_target,
        detections=fit.detections,
        residuals_px=tuple(r[: len(s)] for r, s in zip(residuals, fit.detections, strict=True)),
        rms_px=dict(zip(names, rms_px, strict=True)),
        covariance={name: found.of_shared[layout.camera(row), layout.camera(row)] for row, name in enumerate(names)},
        inflation=found.inflation,
        sync_error_m=fit.displacement_m,
        left_out=tuple(sorted(fit.left_out, key=_place)),
        undecided=_undecided(fit),
        scale_of={
            name: (float(state.scale[row]), float(np.sqrt(found.of_shared[scale, scale])))
            for row, (name, scale) in enumerate(zip(problem.shapes, layout.scales, strict=True))
            if fit.prior.information[scale, scale] > 0
        },
        focal_of=_focal_ratios(fit),
    )


def _free(fit: RobustFit, reference: int | None) -> FreeUnknowns:
    """Return all that moves when the reference holds the frame; without one the root camera does."""
    free = fit.free
    if reference is None:
        return free
    shared, poses = free.shared.copy(), free.poses.copy()
    shared[fit.state.layout.camera(fit.root)] = True
    poses[reference] = False
    return FreeUnknowns(shared, poses)


def _place(out: RejectedDetection) -> tuple[str, int, str]:
    return out.detection.target, out.detection.frame_index, out.detection.camera


def _undecided(fit: RobustFit) -> tuple[str, ...]:
    """Return the cameras linked to the others by a single pose of a target that looks alike after half a turn."""
    shared = [(target, names) for (target, _), names in cameras_by_pose(fit.detections).items() if len(names) > 1]
    links = {name: [target for target, names in shared if name in names] for name in fit.problem.cameras}
    return tuple(name for name, of in links.items() if len(of) == 1 and len(fit.problem.shapes[of[0]].ways) > 1)


# --- How well cameras, lenses and targets are known, where errors are not independent among other things.
#
# From the normal equations of all corners, in the gauge of the solution: the reference (a camera, or one pose of a
# target) is exact by definition, everything else is known relative to it.
#
#     covariance = c P + sum over cameras of G Sigma_lens G^T,    P = (S + prior)^-1,    G = -P S_lens
#
# S: reduced normal equations, in units of the noise (Huber's variance factor); G: what an error of the lens parameters,
# held fixed, does to the poses.
#
# P assumes that corners err independently. Real ones do not: a view is a little blurred, a target is bent or moves
# between exposures, a shutter rolls, and then all corners at one pose of a target err together. The scatter of the
# poses' scores (the sandwich estimator for errors that clusters share, Liang & Zeger 1986) tells by how much P promises
# too much: c >= 1.


class Covariance(NamedTuple):
    """of_shared (d, d): of all shared unknowns as laid out with their lenses, 0 where fixed: of a camera, rotation
    vector (rad, in the camera's frame) and centre (m, in the reference's frame).

    variance_factor: the corners' variance over the one given. inflation: the factor by which errors that poses share
    enlarge variances overall.
    """

    of_shared: Array
    variance_factor: float
    inflation: float


def covariance(fit: RobustFit, free: FreeUnknowns) -> Covariance:
    """Compute the covariances at the solution; ``free`` sets the gauge (and frees the lenses that were refined); lenses
    that are not adjusted are as uncertain as given."""
    scaled = fit.used.weighted(np.array(1 / fit.scale))
    equations = normal_equations(whitened(fit.rows_at_solution(), fit.displacement_m), scaled, fit.state, fit.prior)
    told = np.linalg.eigvalsh(equations.V[free.poses])  # six numbers of a pose, five of a wand's
    unknowns = int(free.shared.sum() + (told > NEGLIGIBLE * told[:, -1:]).sum())
    # Huber's variance factor: squared clipped residuals over the degrees of freedom, by the square of the share inside
    lengths = normalised_lengths(fit.state, scaled)[scaled.weight > 0]
    inside = max(float(np.mean(lengths <= HUBER)), 0.5)
    factor = float(np.sum(np.minimum(lengths, HUBER) ** 2)) / max(2 * len(lengths) - unknowns, 1) / inside**2
    reduced = reduce(equations, FreeUnknowns(np.ones(fit.state.layout.size, bool), free.poses))
    information, score = reduced.information / factor, reduced.score / factor
    S = information.sum(axis=0)
    white = inverse_over(S + fit.prior.information, free.shared)
    # of each pose's score when the corners' noise is white: its own information less what the fit takes up
    expected = (information - information @ white @ information).sum(axis=0)
    inflation = max(float(np.trace(white @ (score.T @ score)) / max(np.trace(white @ expected), 1.0)), 1.0)
    total = inflation * white
    for row, name in enumerate(fit.problem.cameras):
        if name in fit.problem.lens_sd:
            G = white @ S[:, fit.state.layout.lens(row)] * fit.problem.lens_sd[name]
            total = total + G @ G.T
    return Covariance(total, factor * fit.scale**2, inflation)


def inverse_over(information: Array, free: Bools) -> Array:
    """Return the inverse over the free unknowns, zeros elsewhere; also where exact corners leave coefficients that make
    up for each other to rounding alone."""
    some = information[np.ix_(free, free)]
    unit = np.sqrt(np.maximum(np.diag(some), np.finfo(float).tiny))
    values, vectors = np.linalg.eigh(some / np.outer(unit, unit))
    known = np.maximum(values, np.finfo(float).eps * values[-1:])
    full = np.zeros_like(information)
    full[np.ix_(free, free)] = (vectors / known) @ vectors.T / np.outer(unit, unit)
    return full
