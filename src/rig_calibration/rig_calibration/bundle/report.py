"""From the adjusted state to the solution that is handed out."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from capture_rig.camera import CameraModel

from .adjustment import noise_scale
from .covariance import covariance
from .fit import Fit, lens_covariances
from .focal_check import focal_ratios
from .gauge import target_origin
from .initial_poses import InitialPoses
from .normal_equations import Free
from .observations import Layout
from .outliers import LeftOut
from .projection import residuals_px
from .rigid import Array, transform
from .scales import most_seen
from .solution import RigSolution
from .view_graph import Key


def describe(fit: Fit, reference: str | Key, initial: InitialPoses) -> RigSolution:
    """The solution: poses, residuals, covariance relative to the reference, what was left out and why."""
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
    tau = fit.displacement[fit.rows]
    found = covariance(fit.adjusted, used, _free(fit, reference), lens_covariances(fit), tau, fit.prior)
    turned = tuple(s for s, turn in zip(problem.sightings, initial.turns, strict=True) if turn)
    cameras = {
        name: _camera(problem.cameras[name], lens, T_camera[name]) for name, lens in zip(names, state.lens, strict=True)
    }
    return RigSolution(
        reference=reference,
        cameras=cameras,
        T_camera_reference=T_camera,
        T_reference_target=T_target,
        sightings=fit.sightings,
        residuals_px=tuple(r[: len(s)] for r, s in zip(residuals, fit.sightings, strict=True)),
        rms_px={name: _rms(squares[used.camera == row], corners[used.camera == row]) for row, name in enumerate(names)},
        rms_all_px=_rms(squares, corners),
        covariance=dict(zip(names, found.cameras, strict=True)),
        inflation=found.inflation,
        noise=noise_scale(state, used) / float(np.sqrt(found.redundancy)),
        displacement_m=float(np.sqrt(np.mean(tau**2))),
        left_out=tuple(sorted(fit.left_out, key=_place)),
        turned=turned,
        undecided=_undecided(fit),
        scale_base=most_seen(fit.sightings, list(problem.shapes)),
        scale_of=fit.scale_of,
        focal_of=focal_ratios(fit),
        iterations=fit.adjusted.iterations,
    )


def _free(fit: Fit, reference: str | Key) -> Free:
    """All that moves when the reference holds the frame."""
    layout = Layout(fit.layout.cameras, fit.layout.targets, with_lens=True)
    free = fit.free(layout)
    shared, poses = free.shared.copy(), free.poses.copy()
    shared[layout.camera(fit.root)] = True
    if isinstance(reference, str):
        shared[layout.camera(list(fit.problem.cameras).index(reference))] = False
    else:
        poses[fit.problem.keys.index(reference)] = False
    return Free(shared, poses)


def _camera(camera: CameraModel, lens: Array, T_camera_reference: Array) -> CameraModel:
    K = np.array([[lens[0], 0, lens[2]], [0, lens[1], lens[3]], [0, 0, 1]])
    return replace(camera, K=K, D=lens[4 : 4 + len(camera.D)], T_camera_world=T_camera_reference)


def _rms(squares: Array, corners: np.ndarray) -> float:
    return float(np.sqrt(squares.sum() / max(int(corners.sum()), 1)))


def _place(out: LeftOut) -> tuple[str, int, str]:
    return out.sighting.target, out.sighting.moment, out.sighting.camera


def _undecided(fit: Fit) -> tuple[str, ...]:
    """Cameras linked to the others by a single pose of a target whose turns cannot be seen."""
    used = fit.used
    shared = np.bincount(used.pose)[used.pose] > 1
    links: dict[str, list[str]] = {name: [] for name in fit.problem.cameras}
    for sighting, linked in zip(fit.sightings, shared, strict=True):
        if linked:
            links[sighting.camera].append(sighting.target)
    hides = {name for name, shape in fit.problem.shapes.items() if len(shape.turns) > 1}
    return tuple(name for name, targets in links.items() if len(targets) == 1 and targets[0] in hides)
