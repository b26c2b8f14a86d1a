"""Where the state puts the corners, lens distortion included, and how that changes with the state."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from capture_rig.lens import derivatives, distort

from .rigid import Array
from .state import Observations, State

MIN_DEPTH = 1e-6  # m


@dataclass(frozen=True, eq=False)
class Linearised:
    """residual (s, 2n) seen minus predicted, over its standard deviation; derivatives of the prediction, likewise:
    by_shared (s, 2n, width + target_width), as :meth:`.state.Layout.columns` has them, and by_pose (s, 2n, 6)."""

    residual: Array
    by_shared: Array
    by_pose: Array


def residuals_px(state: State, seen: Observations) -> Array:
    """Compute (s, n, 2) seen minus predicted pixels; infinite for a corner behind its camera."""
    x = _in_camera(state, seen, _arm(state, seen))
    lens = state.lens[seen.camera][:, None]
    with np.errstate(all="ignore"):
        predicted = distort(x[..., :2] / x[..., 2:], lens[..., 4:]) * lens[..., :2] + lens[..., 2:4]
    return np.where(x[..., 2:] > MIN_DEPTH, seen.pixels - predicted, np.inf)


def linearise(state: State, seen: Observations, with_lens: bool = False) -> Linearised:
    """Compute the residuals and their analytic derivatives, at a state in which all corners lie in front of their
    cameras.

    x_camera = R_camera (x - centre),  x = arm + position,  arm = scale R_pose (x_target + bend bow e_z); with q a row
    of d(pixel)/d(x):  by the camera's rotation x_camera x (row by x_camera), by its centre -q, by the target's rotation
    arm x q, by its position q, by its scale q.arm / scale, by its bow q.(scale R_pose e_z) bend.
    """
    arm = _arm(state, seen)
    x = _in_camera(state, seen, arm)
    lens, scale = state.lens[seen.camera][:, None], state.scale[seen.target][:, None, None]
    ideal = x[..., :2] / x[..., 2:]
    distorted, by_ideal, by_coefficients = derivatives(ideal, lens[..., 4:])
    residual = np.where(x[..., 2:] > MIN_DEPTH, seen.pixels - distorted * lens[..., :2] - lens[..., 2:4], np.inf)
    by_ideal = by_ideal * lens[..., :2, None]
    by_x = np.concatenate([by_ideal, -(by_ideal @ ideal[..., None])], axis=-1) / x[..., 2, None, None]  # x_camera
    q = by_x @ state.R_camera[seen.camera][:, None]
    shared = [np.cross(x[:, :, None], by_x), -q]
    if with_lens:
        focal = distorted[..., None] * np.eye(2)
        shared += [focal, np.broadcast_to(np.eye(2), focal.shape), by_coefficients * lens[..., :2, None]]
    shared.append((q @ arm[..., None]) / scale[..., None])
    if with_lens:
        normal = scale * state.R_pose[seen.pose][:, None, :, 2]
        shared.append((q @ normal[..., None]) * seen.bend[:, :, None])
    weight = seen.weight[..., None]
    rows = lambda a: (a * weight[..., None]).reshape(len(a), 2 * a.shape[1], -1)  # noqa: E731
    by_pose = np.concatenate([np.cross(arm[:, :, None], q), q], axis=-1)
    return Linearised((residual * weight).reshape(len(x), -1), rows(np.concatenate(shared, axis=-1)), rows(by_pose))


def _arm(state: State, seen: Observations) -> Array:
    """Return (s, n, 3) from the target's centroid to its corners, common frame."""
    points = seen.points.copy()
    points[..., 2] += (seen.bend @ state.bow[seen.target][:, :, None])[..., 0]
    scaled = state.R_pose[seen.pose] * state.scale[seen.target][:, None, None]
    return points @ np.swapaxes(scaled, 1, 2)


def _in_camera(state: State, seen: Observations, arm: Array) -> Array:
    x = arm + (state.position[seen.pose] - state.centre[seen.camera])[:, None]
    return x @ np.swapaxes(state.R_camera[seen.camera], 1, 2)
