"""Error metrics of thesis 7.2, corrected: points, angles, rotations, with and without constant joint offsets.

Distances in metres, angles in radians. NaN marks entries unknown in the truth or missing in the estimate; they are left
out of every mean.
"""

from __future__ import annotations

import numpy as np

from .rotations import Array, wrap_pi

# Thresholds: judgement, no measurement.
LARGE_ERROR_M = 0.2
"""Default threshold of "a point is lost"."""


def point_errors(estimate: Array, truth: Array) -> Array:
    """Distance (F, 15) of each point in each frame, metres; NaN where either is unknown."""
    estimate, truth = np.asarray(estimate, float), np.asarray(truth, float)
    if estimate.shape != truth.shape:
        raise ValueError(f"estimate has shape {estimate.shape}, truth {truth.shape}")
    return np.linalg.norm(estimate - truth, axis=-1)


def rotation_angle(R_a: Array, R_b: Array) -> Array:
    """Angle (...,), rad, of the rotation R_a R_b^T between rotations (..., 3, 3).

    Thesis eq. 7.1 (corrected: arccos((tr - 1) / 2) fails when rounding lifts its argument above 1 and resolves
    nothing below 1e-8; atan2 of sine and cosine does both).
    """
    R = np.asarray(R_a, float) @ np.swapaxes(np.asarray(R_b, float), -1, -2)
    double_sine = np.linalg.norm(
        np.stack([R[..., 2, 1] - R[..., 1, 2], R[..., 0, 2] - R[..., 2, 0], R[..., 1, 0] - R[..., 0, 1]], -1), axis=-1
    )
    return np.arctan2(double_sine, np.trace(R, axis1=-2, axis2=-1) - 1.0)


def rmse_angles(estimate: Array, truth: Array) -> Array:
    """RMSE (18,) of each angle over the frames (F, 18), rad, of differences wrapped to [-pi, pi) (thesis eq. 7.2).

    Differences that are NaN are left out; NaN where nothing is known.
    """
    errors = wrap_pi(np.asarray(estimate, float) - np.asarray(truth, float))
    known = np.isfinite(errors)
    count = known.sum(0)
    mean_square = (np.where(known, errors, 0.0) ** 2).sum(0) / np.maximum(count, 1)
    return np.where(count > 0, np.sqrt(mean_square), np.nan)


def pelvis_rotations(points_world: Array) -> Array:
    """Pelvis to world rotations (F, 3, 3) of reference points (F, 15, 3): y to the left hip, z towards the neck."""
    points = np.asarray(points_world, float)
    y = _unit(points[:, 5] - points[:, 6])
    spine = points[:, 2] - 0.5 * (points[:, 5] + points[:, 6])
    x = _unit(np.cross(y, spine))
    return np.stack([x, y, np.cross(x, y)], axis=-1)


def joint_offsets(estimate: Array, truth: Array) -> Array:
    """Constant offset (15, 3) of each point, metres, pelvis frame: mean over frames of R_pelvis^T (estimate - truth).

    Where two systems mean different places by "shoulder" or "hip", that part of the error is not the tracker's.
    """
    in_pelvis = np.einsum("fji,fpj->fpi", pelvis_rotations(truth), np.asarray(estimate, float) - truth)
    known = np.isfinite(in_pelvis).all(-1, keepdims=True)
    count = np.maximum(known.sum(0), 1)
    return np.where(known, in_pelvis, 0.0).sum(0) / count


def without_offsets(estimate: Array, truth: Array) -> Array:
    """Return the estimate (F, 15, 3) with its constant joint offsets taken out, metres, world frame."""
    offsets = joint_offsets(estimate, truth)
    return np.asarray(estimate, float) - np.einsum("fij,pj->fpi", pelvis_rotations(truth), offsets)


def _unit(vectors: Array) -> Array:
    return vectors / np.linalg.norm(vectors, axis=-1, keepdims=True)
