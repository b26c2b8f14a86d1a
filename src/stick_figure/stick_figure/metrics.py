"""Error metrics of thesis 7.2, corrected: points, angles, rotations, with and without constant joint offsets.

Distances in metres, angles in radians. NaN marks what is unknown in the truth or missing in the estimate; such
entries are left out of every mean and counted by :attr:`Summary.points_compared`.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from .rotations import Array, wrap_pi

# Thresholds: judgement, no measurement.
LARGE_ERROR_M = 0.2
"""Default threshold of "a point is lost"."""


@dataclass(frozen=True)
class Summary:
    """Errors of a sequence; metres.

    rmse_per_point (15,)     root mean square over the frames of each point's distance (thesis eq. 7.3, corrected:
                             it sums signed differences, so that +10 and -10 mm would cancel to 0)
    thesis_mean              mean of those 15, the figure of thesis Table 7.2's last line
    mean, median, p95        over all compared points of all frames
    share_over               share of frames with any point further off than the threshold
    points_compared          number of (frame, point) pairs that had both truth and estimate
    """

    rmse_per_point: Array
    thesis_mean: float
    mean: float
    median: float
    p95: float
    share_over: float
    points_compared: int


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


def angle_errors(estimate: Array, truth: Array) -> Array:
    """Angle differences (..., 18), rad, wrapped to [-pi, pi)."""
    return wrap_pi(np.asarray(estimate, float) - np.asarray(truth, float))


def rmse_angles(estimate: Array, truth: Array) -> Array:
    """RMSE (18,) of each angle over the frames (F, 18), rad, of wrapped differences (thesis eq. 7.2)."""
    return _root_mean_square(angle_errors(estimate, truth))


def share_over(errors: Array, threshold_m: float = LARGE_ERROR_M) -> float:
    """Share of the frames of errors (F, 15) in which any known point is further off than the threshold."""
    errors = np.asarray(errors)
    known = np.isfinite(errors).any(axis=1)
    return float((np.nan_to_num(errors[known]) > threshold_m).any(axis=1).mean()) if known.any() else float("nan")


def pelvis_rotations(points_world: Array) -> Array:
    """Pelvis to world rotations (F, 3, 3) of reference points (F, 15, 3): y to the left hip, z towards the neck."""
    points = np.asarray(points_world, float)
    y = _unit(points[:, 5] - points[:, 6])
    spine = points[:, 2] - 0.5 * (points[:, 5] + points[:, 6])
    x = _unit(np.cross(y, spine))
    return np.stack([x, y, np.cross(x, y)], axis=-1)


def joint_offsets(estimate: Array, truth: Array) -> Array:
    """Constant offset (15, 3) of each point, metres, pelvis frame: mean over frames of R_pelvis^T (estimate - truth).

    Where two systems mean different places by "shoulder" or "hip", that part of the error says nothing about tracking.
    """
    in_pelvis = np.einsum("fji,fpj->fpi", pelvis_rotations(truth), np.asarray(estimate, float) - truth)
    known = np.isfinite(in_pelvis).all(-1, keepdims=True)
    count = np.maximum(known.sum(0), 1)
    return np.where(known, in_pelvis, 0.0).sum(0) / count


def without_offsets(estimate: Array, truth: Array) -> Array:
    """Return the estimate (F, 15, 3) with its constant joint offsets taken out, metres, world frame."""
    offsets = joint_offsets(estimate, truth)
    return np.asarray(estimate, float) - np.einsum("fij,pj->fpi", pelvis_rotations(truth), offsets)


def summary(estimate: Array, truth: Array, threshold_m: float = LARGE_ERROR_M) -> Summary:
    """All point figures of a sequence (F, 15, 3); use it on `without_offsets` for the second column of a table."""
    errors = point_errors(estimate, truth)
    known = errors[np.isfinite(errors)]
    if known.size == 0:
        raise ValueError("no frame has both an estimate and a truth")
    per_point = _root_mean_square(errors)
    return Summary(
        rmse_per_point=per_point,
        thesis_mean=float(per_point[np.isfinite(per_point)].mean()),
        mean=float(known.mean()),
        median=float(np.median(known)),
        p95=float(np.percentile(known, 95)),
        share_over=share_over(errors, threshold_m),
        points_compared=int(known.size),
    )


def _root_mean_square(errors: Array) -> Array:
    """Over the first axis, NaN left out; NaN where nothing is known."""
    known = np.isfinite(errors)
    count = known.sum(0)
    total = np.where(known, errors, 0.0)
    mean_square = (total**2).sum(0) / np.maximum(count, 1)
    return np.where(count > 0, np.sqrt(mean_square), np.nan)


def _unit(vectors: Array) -> Array:
    return vectors / np.linalg.norm(vectors, axis=-1, keepdims=True)
