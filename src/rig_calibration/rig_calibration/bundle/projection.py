"""Where the state puts the corners, lens distortion included, and how that changes with the state."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from .lens_derivatives import by_coefficients, by_point, distort
from .rigid import Array
from .state import Observations, State

MIN_DEPTH = 1e-6  # m


@dataclass(frozen=True, eq=False)
class Linearised:
    """residual (s, 2n) seen minus predicted, over its standard deviation; derivatives of the prediction, likewise:
    by_shared (s, 2n, width + 1) and by_pose (s, 2n, 6)."""

    residual: Array
    by_shared: Array
    by_pose: Array


def residuals_px(state: State, seen: Observations) -> Array:
    """(s, n, 2) seen minus predicted pixels; infinite for a corner behind its camera."""
    x = _in_camera(state, seen, _arm(state, seen))
    z = x[..., 2:]
    lens = state.lens[seen.camera][:, None]
    with np.errstate(all="ignore"):
        predicted = distort(x[..., :2] / z, lens[..., 4:]) * lens[..., :2] + lens[..., 2:4]
    return np.where(z > MIN_DEPTH, seen.pixels - predicted, np.inf)


def linearise(state: State, seen: Observations, with_lens: bool = False) -> Linearised:
    """The residuals and their analytic derivatives, at a state in which all corners lie in front of their cameras.

    x_camera = R_camera (x - centre),  x = arm + position,  arm = scale R_pose x_target; with q a row of
    d(pixel)/d(x):  by the camera's rotation x_camera x (row by x_camera), by its centre -q, by the target's rotation
    arm x q, by its position q, by its scale q.arm / scale.
    """
    arm = _arm(state, seen)
    x = _in_camera(state, seen, arm)
    by_x = _by_camera_point(state, seen, x)  # (s, n, 2, 3)
    q = by_x @ state.R_camera[seen.camera][:, None]
    scale = state.scale[seen.target][:, None, None]
    shared = [np.cross(x[:, :, None], by_x), -q]
    if with_lens:
        shared.append(_by_lens(state, seen, x))
    shared.append((q @ arm[..., None]) / scale[..., None])
    weight = seen.weight[..., None]
    rows = lambda a: (a * weight[..., None]).reshape(len(a), 2 * a.shape[1], -1)  # noqa: E731
    residual = (residuals_px(state, seen) * weight).reshape(len(x), -1)
    by_pose = np.concatenate([np.cross(arm[:, :, None], q), q], axis=-1)
    return Linearised(residual, rows(np.concatenate(shared, axis=-1)), rows(by_pose))


def _arm(state: State, seen: Observations) -> Array:
    scaled = state.R_pose[seen.pose] * state.scale[seen.target][:, None, None]
    return seen.points @ np.swapaxes(scaled, 1, 2)


def _in_camera(state: State, seen: Observations, arm: Array) -> Array:
    x = arm + (state.position[seen.pose] - state.centre[seen.camera])[:, None]
    return x @ np.swapaxes(state.R_camera[seen.camera], 1, 2)


def _by_camera_point(state: State, seen: Observations, x: Array) -> Array:
    """(s, n, 2, 3) d(pixel) / d(x_camera)."""
    lens = state.lens[seen.camera][:, None]
    ideal, z = x[..., :2] / x[..., 2:], x[..., 2, None, None]
    by_ideal = by_point(ideal, lens[..., 4:]) * lens[..., :2, None]
    return np.concatenate([by_ideal, -(by_ideal @ ideal[..., None])], axis=-1) / z


def _by_lens(state: State, seen: Observations, x: Array) -> Array:
    """(s, n, 2, 12) d(pixel) / d(fx fy cx cy k1 ... k6)."""
    lens = state.lens[seen.camera][:, None]
    ideal = x[..., :2] / x[..., 2:]
    focal = distort(ideal, lens[..., 4:])[..., None] * np.eye(2)
    centre = np.broadcast_to(np.eye(2), focal.shape)
    return np.concatenate([focal, centre, by_coefficients(ideal, lens[..., 4:]) * lens[..., :2, None]], axis=-1)
