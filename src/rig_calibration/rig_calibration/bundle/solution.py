"""What the solver found, in the frame that was asked for, and how good it is."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from capture_rig.camera import CameraModel
from capture_rig.errors import InputError

from ..boards.board import TargetDetection
from .adjustment import FreeUnknowns, noise_scale, normal_equations, reduce, step
from .initial_poses import InitialPoses
from .outliers import LeftOut
from .problem import Problem
from .projection import residuals_px
from .rigid import Array, transform
from .robust_fit import Fit
from .state import State, camera_with
from .sync_error import whitened
from .view_graph import PoseKey, most_seen


@dataclass(frozen=True, eq=False)
class RigSolution:
    """The poses of all cameras and targets, in the frame of the ``reference``.

    reference : a camera's name, or (target, frame index): the target's own coordinate frame then.
    cameras : the cameras, with these poses as their ``T_camera_world`` (and refined lenses, if asked for).
    T_camera_reference : (4, 4) by camera. T_reference_target : (4, 4) by (target, frame).
    detections, residuals_px : what was used, ids as they proved right, and seen minus predicted pixels (n, 2) of each.
    rms_px : by camera, root mean square distance of its corners (sqrt(2) times the noise of one coordinate, as OpenCV
    reports it); rms_all_px of all of them.
    covariance : (6, 6) by camera, relative to the reference: rotation vector (rad, in the camera's frame), centre (m,
    in the reference's frame). inflation : by how much it exceeds what independent errors of corners would leave (1: not
    at all), because the cameras contradict one another: a target that moved between the exposures or is bent, a lens.
    noise : standard deviation of the corners over the one that their detections claim. sync_error_m : by how much (sd)
    the targets seem to have moved between the cameras' exposures, 0 where nothing says that they did.
    left_out : detections that took no part, with the reason (not those of a wand that no other camera saw, which tell
    nothing). renumbered : detections whose numbering was turned.
    undecided : cameras whose half turn nothing settles. scale_of : by target, the size that it has beside
    the most seen one (``scale_base``) over the size given, and its standard deviation; believed when consistent with
    1, else the solution uses the ratio. focal_of : by camera, the focal length that all views together ask for over the
    one given (or refined), and its standard deviation: far from 1, the intrinsics are not this camera's.
    """

    reference: str | PoseKey
    cameras: dict[str, CameraModel]
    T_camera_reference: dict[str, Array]
    T_reference_target: dict[PoseKey, Array]
    detections: tuple[TargetDetection, ...]
    residuals_px: tuple[Array, ...]
    rms_px: dict[str, float]
    rms_all_px: float
    covariance: dict[str, Array]
    inflation: float
    noise: float
    sync_error_m: float
    left_out: tuple[LeftOut, ...]
    renumbered: tuple[TargetDetection, ...]
    undecided: tuple[str, ...]
    scale_base: str
    scale_of: dict[str, tuple[float, float]]
    focal_of: dict[str, tuple[float, float]]
    iterations: int


# --- The coordinate frame of the solution: that of a camera, or of a target at one frame index.


def choose_reference(problem: Problem, reference: str | PoseKey | None, root: str) -> str | PoseKey:
    """Choose a camera's name or (target, frame); InputError when ``reference`` names neither, or a target that
    moved."""
    if reference is None:
        return root
    if isinstance(reference, str):
        if reference in problem.cameras:
            return reference
        keys = [key for key in problem.keys if key[0] == reference]
        if len(keys) > 1:
            raise InputError(
                f"target '{reference}' cannot be the reference: it was seen in {len(keys)} frames",
                remedy="Say at which: (target, frame).",
            )
        reference = keys[0] if keys else (reference, 0)
    if reference not in problem.keys:
        raise InputError(
            f"the reference {reference} is neither a camera nor a target that was seen",
            remedy=f"Cameras: {', '.join(problem.cameras)}.",
        )
    return reference


def in_gauge(fit: Fit, reference: str | PoseKey) -> Fit:
    """Transform the solution into the frame of the reference."""
    state, problem = fit.adjusted.state, fit.problem
    if isinstance(reference, str):
        row = list(problem.cameras).index(reference)
        R, origin = state.R_camera[row], state.centre[row]
    else:
        row = problem.keys.index(reference)
        if row not in fit.used.pose:
            raise InputError(
                f"the reference, target '{reference[0]}' in frame {reference[1]}, contradicts the rest",
                remedy="Take another reference, or take its pictures again.",
            )
        R, origin = state.R_pose[row].T, target_origin(problem, state, row)
    moved = replace(
        state,
        R_camera=state.R_camera @ R.T,
        centre=(state.centre - origin) @ R.T,
        R_pose=R @ state.R_pose,
        position=(state.position - origin) @ R.T,
    )
    return replace(fit, adjusted=replace(fit.adjusted, state=moved))


def target_origin(problem: Problem, state: State, row: int) -> Array:
    """Return (3,) where the origin of the target's own frame lies, for pose ``row``."""
    names = list(problem.shapes)
    name = problem.keys[row][0]
    return state.position[row] - state.scale[names.index(name)] * state.R_pose[row] @ problem.shapes[name].centroid


# --- A check of the focal lengths that were given.
#
# One Gauss-Newton step away from the solution, with focal lengths and principal points of all cameras set free: if the
# intrinsics are right, it changes them by no more than their standard deviations. (A board that only one camera sees
# tells little about them: a longer lens looks like a board farther away. Another camera knows where the board is.)

WIDE = 0.1  # of the focal length: standard deviation of what is assumed of all four beforehand
PINHOLE = 4


def focal_ratios(fit: Fit) -> dict[str, tuple[float, float]]:
    """Compare, by camera, the focal length that all views together ask for with the one given: their ratio and its
    standard deviation."""
    state, names = fit.adjusted.state, list(fit.problem.cameras)
    layout = replace(fit.layout, with_lens=True)
    linear = whitened(fit.rows_at_solution(with_lens=True), fit.sync_error[fit.rows])
    equations = normal_equations(linear, fit.used, layout, len(state.position))
    focal_px = np.sqrt(state.lens[:, 0] * state.lens[:, 1])
    free, U = fit.free(layout), equations.U.copy()
    shared = free.shared.copy()
    for row in range(len(names)):
        pinhole = np.arange(layout.size)[layout.lens(row)][:PINHOLE]
        shared[pinhole] = True
        U[pinhole, pinhole] += (WIDE * focal_px[row]) ** -2.0
    asked = replace(equations, U=U)
    free = FreeUnknowns(shared, free.poses)
    change = step(asked, free, 0.0)[0]
    variance = np.zeros(layout.size)
    variance[shared] = np.diag(np.linalg.pinv(reduce(asked, free).S, rcond=1e-14, hermitian=True))
    found = {}
    for row, name in enumerate(names):
        focal = np.arange(layout.size)[layout.lens(row)][:2]
        ratio = float(np.mean(1 + change[focal] / state.lens[row, :2]))
        found[name] = ratio, float(np.sqrt(variance[focal].mean()) / focal_px[row])
    return found


def to_solution(fit: Fit, reference: str | PoseKey, initial: InitialPoses) -> RigSolution:
    """Make the solution: poses, residuals, covariance relative to the reference, what was left out and why."""
    problem, state, used = fit.problem, fit.adjusted.state, fit.used
    names = list(problem.cameras)
    T_camera = {
        name: transform(R, -R @ centre) for name, R, centre in zip(names, state.R_camera, state.centre, strict=True)
    }
    T_target = {
        key: transform(state.R_pose[row], target_origin(problem, state, row))
        for row, key in enumerate(problem.keys)
        if row in used.pose
    }
    residuals = residuals_px(state, used)
    corners = used.weight > 0
    squares = np.where(corners, (residuals**2).sum(axis=2), 0.0)
    found = fit.covariance(_free(fit, reference))
    renumbered = tuple(s for s, symmetry in zip(problem.detections, initial.symmetries, strict=True) if symmetry)
    cameras = {
        name: camera_with(problem.cameras[name], lens, T_camera[name])
        for name, lens in zip(names, state.lens, strict=True)
    }
    return RigSolution(
        reference=reference,
        cameras=cameras,
        T_camera_reference=T_camera,
        T_reference_target=T_target,
        detections=fit.detections,
        residuals_px=tuple(r[: len(s)] for r, s in zip(residuals, fit.detections, strict=True)),
        rms_px={name: _rms(squares[used.camera == row], corners[used.camera == row]) for row, name in enumerate(names)},
        rms_all_px=_rms(squares, corners),
        covariance=dict(zip(names, found.cameras, strict=True)),
        inflation=found.inflation,
        noise=noise_scale(state, used) / float(np.sqrt(found.redundancy)),
        sync_error_m=float(np.sqrt(np.mean(fit.sync_error[fit.rows] ** 2))),
        left_out=tuple(sorted((out for out in fit.left_out if out.whole), key=_place)),
        renumbered=renumbered,
        undecided=_undecided(fit),
        scale_base=most_seen(fit.detections, list(problem.shapes)),
        scale_of=fit.scale_of,
        focal_of=focal_ratios(fit),
        iterations=fit.adjusted.iterations,
    )


def _free(fit: Fit, reference: str | PoseKey) -> FreeUnknowns:
    """Return all that moves when the reference holds the frame."""
    layout = replace(fit.layout, with_lens=True)
    free = fit.free(layout)
    shared, poses = free.shared.copy(), free.poses.copy()
    shared[layout.camera(fit.root)] = True
    if isinstance(reference, str):
        shared[layout.camera(list(fit.problem.cameras).index(reference))] = False
    else:
        poses[fit.problem.keys.index(reference)] = False
    return FreeUnknowns(shared, poses)


def _rms(squares: Array, corners: np.ndarray) -> float:
    return float(np.sqrt(squares.sum() / max(int(corners.sum()), 1)))


def _place(out: LeftOut) -> tuple[str, int, str]:
    return out.detection.target, out.detection.frame_index, out.detection.camera


def _undecided(fit: Fit) -> tuple[str, ...]:
    """Cameras linked to the others by a single pose of a target whose turns cannot be seen."""
    used = fit.used
    shared = np.bincount(used.pose)[used.pose] > 1
    links: dict[str, list[str]] = {name: [] for name in fit.problem.cameras}
    for detection, linked in zip(fit.detections, shared, strict=True):
        if linked:
            links[detection.camera].append(detection.target)
    hides = {name for name, shape in fit.problem.shapes.items() if len(shape.symmetries) > 1}
    return tuple(name for name, targets in links.items() if len(targets) == 1 and targets[0] in hides)
