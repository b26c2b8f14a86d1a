"""Step 3 for wands, whose markers lie on a line and have no pose in a single picture.

Pairs of cameras are related by their essential matrix (Hartley & Zisserman 2004, chapter 9), the wand's length gives
the scale, and the wand itself is triangulated.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import cv2
import numpy as np
from scipy.spatial.transform import Rotation

from capture_rig.camera import CameraModel
from capture_rig.lens import Array
from capture_rig.rigid import transform

from .problem import View

MIN_POINTS = 12  # the essential matrix needs five; with fewer than this, wrong labels cannot be told
INLIER_PX, CONFIDENCE = 3.0, 0.9999


class RelativePose(NamedTuple):
    """``T_b_a`` (4, 4) maps coordinates in camera a to camera b; ``support``: how many frames it is worth."""

    T_b_a: Array
    support: float


Pair = tuple[Array, Array, Array]  # the same markers of a frame: ideal points (n, 2) in a and b, positions (n, 3)


def relative_pose_of_line(common: Sequence[tuple[View, View]], a: CameraModel, b: CameraModel) -> RelativePose | None:
    """Find the pose of camera b relative to a from wands that both saw in the same frames; None when there are too few.

    Where a wand's ends cannot be told apart, each frame's numbering in b is tried both ways round.
    """
    ways = [_ways_round(u, v) for u, v in common]
    choices = [pairs for pairs in ways if len(pairs[0][0])]
    if sum(len(pairs[0][0]) for pairs in choices) < MIN_POINTS:
        return None
    tolerance = INLIER_PX / float(np.sqrt(a.K[0, 0] * b.K[0, 0]))
    E = _essential([pair for pairs in choices for pair in pairs], tolerance)  # wrong ways round are outliers
    if len(E) == 0:
        return None
    chosen = [min(pairs, key=lambda pair: _epipolar_distance(E, pair).max()) for pairs in choices]
    fitting = [pair for pair in chosen if _epipolar_distance(E, pair).max() < tolerance]
    return _with_scale(E, fitting) if fitting else None


def line_pose(seen: Sequence[tuple[View, Array]]) -> tuple[Array | None, list[int]]:
    """Find the pose of a wand in one frame by triangulation, and the way round that each view needs.

    ``seen``: its views, each with the pose T_camera_root of its camera. None when fewer than two views tell it.
    """
    best: tuple[float, Array | None, list[int]] = (np.inf, None, [0] * len(seen))
    if len(seen) < 2:
        return None, best[2]
    for second in range(len(seen[0][0].shape.symmetries)):  # the first view stays as it is, the second decides
        symmetries = [0, second]
        pose, _ = _fit_line(seen[:2], symmetries)
        if pose is None:
            continue
        for view, T in seen[2:]:  # the others follow
            symmetries.append(int(np.argmin([_miss(pose, view, T, way) for way in range(len(view.shape.symmetries))])))
        pose, miss = _fit_line(seen, symmetries)
        if pose is not None and miss < best[0]:
            best = miss, pose, symmetries
    return best[1], best[2]


def _ways_round(u: View, v: View) -> list[Pair]:
    pairs = []
    for symmetry in u.shape.symmetries:
        ids, rows_u, rows_v = np.intersect1d(
            u.detection.ids, symmetry.permutation[v.detection.ids], return_indices=True
        )
        pairs.append((u.ideal[rows_u], v.ideal[rows_v], u.shape.points[ids]))
    return pairs


def _essential(chosen: Sequence[Pair], tolerance: float) -> Array:
    """Return (3, 3), or (0, 3) when there is none."""
    points_a, points_b = (np.concatenate([pair[side] for pair in chosen]) for side in (0, 1))
    E, _ = cv2.findEssentialMat(points_a, points_b, np.eye(3), cv2.RANSAC, CONFIDENCE, tolerance)
    return np.empty((0, 3)) if E is None or E.shape[0] < 3 else np.asarray(E[:3], float)


def _epipolar_distance(E: Array, pair: Pair) -> Array:
    """Return (n,) Sampson distances, in units of the focal length."""
    a, b = (np.column_stack([pair[side], np.ones(len(pair[side]))]) for side in (0, 1))
    line_b, line_a = a @ E.T, b @ E
    slope = np.sqrt((line_b[:, :2] ** 2).sum(1) + (line_a[:, :2] ** 2).sum(1))
    return np.abs((b * line_b).sum(1)) / np.maximum(slope, 1e-12)


def _with_scale(E: Array, fitting: Sequence[Pair]) -> RelativePose:
    points_a, points_b = (np.concatenate([pair[side] for pair in fitting]) for side in (0, 1))
    _, R, direction, _ = cv2.recoverPose(E, points_a, points_b, np.eye(3))
    T = transform(np.asarray(R, float), np.asarray(direction, float).reshape(3))
    ratios = []
    for ideal_a, ideal_b, points in fitting:
        ends = [int(np.argmin(points @ points[-1])), int(np.argmax(points @ points[-1]))]
        seen = [_triangulate([ideal_a[end], ideal_b[end]], [np.eye(4), T]) for end in ends]
        ratios.append(np.linalg.norm(points[ends[1]] - points[ends[0]]) / np.linalg.norm(seen[1] - seen[0]))
    T[:3, 3] *= np.median(ratios)
    return RelativePose(T, len(fitting))


def _triangulate(ideal: Sequence[Array], T_camera_root: Sequence[Array]) -> Array:
    """Return the point (3,) in the root frame, by the linear method (Hartley & Zisserman 2004, 12.2)."""
    rows = [point[axis] * T[2] - T[axis] for point, T in zip(ideal, T_camera_root, strict=True) for axis in (0, 1)]
    solution = np.linalg.svd(np.array(rows))[2][-1]
    return solution[:3] / solution[3]


def _fit_line(seen: Sequence[tuple[View, Array]], symmetries: Sequence[int]) -> tuple[Array | None, float]:
    """The wand's pose from all markers that two views show, and how far (share of the distance) they are from it."""
    shape = seen[0][0].shape
    ids = [
        shape.symmetries[symmetry].permutation[view.detection.ids]
        for (view, _), symmetry in zip(seen, symmetries, strict=True)
    ]
    found, where = [], []
    for marker in range(len(shape.points)):
        shown = [
            (view.ideal[np.flatnonzero(rows == marker)[0]], T)
            for (view, T), rows in zip(seen, ids, strict=True)
            if marker in rows
        ]
        if len(shown) >= 2:
            found.append(_triangulate([ideal for ideal, _ in shown], [T for _, T in shown]))
            where.append(marker)
    if len(found) < 2 or not np.isfinite(found).all():
        return None, np.inf
    points, model = np.array(found, float), shape.points[where]
    R = Rotation.align_vectors(points[-1] - points[0], model[-1] - model[0])[0].as_matrix()  # the smallest that does
    pose = transform(R, (points - model @ R.T).mean(0))
    return pose, float(
        np.mean([_miss(pose, view, T, symmetry) for (view, T), symmetry in zip(seen, symmetries, strict=True)])
    )


def _miss(pose: Array, view: View, T_camera_root: Array, symmetry: int) -> float:
    ids = view.shape.symmetries[symmetry].permutation[view.detection.ids]
    T = T_camera_root @ pose
    seen = T[:3, :3] @ view.shape.points[ids].T + T[:3, 3:]
    if np.any(seen[2] <= 0):
        return np.inf
    return float(np.mean(np.linalg.norm(seen[:2] / seen[2] - view.ideal.T, axis=0)))
