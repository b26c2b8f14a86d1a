"""Step 3 for wands, whose markers lie on a line and have no pose in a single picture.

Pairs of cameras are related by their essential matrix (Hartley & Zisserman 2004, chapter 9), the wand's length gives
the scale, and the wand itself is triangulated. A view of a wand shows all its markers; of one that looks the same from
both ends, in either order (way 1).
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


Pair = tuple[Array, Array, Array]  # a wand in a frame: its markers' ideal points (k, 2) in a and b, positions (k, 3)


def relative_pose_of_line(common: Sequence[tuple[View, View]], a: CameraModel, b: CameraModel) -> RelativePose | None:
    """Find the pose of camera b relative to a from wands that both saw in the same frames; None when there are too few.

    Where a wand's ends cannot be told apart, each frame's numbering in b is tried both ways round.
    """
    ways = range(len(common[0][0].shape.ways)) if common else ()
    choices = [[(u.ideal, _turned(v.ideal, way), u.shape.points) for way in ways] for u, v in common]
    if sum(len(u.ideal) for u, _ in common) < MIN_POINTS:
        return None
    tolerance = INLIER_PX / float(np.sqrt(a.K[0, 0] * b.K[0, 0]))
    points_a, points_b = (np.concatenate([pair[side] for pairs in choices for pair in pairs]) for side in (0, 1))
    found, _ = cv2.findEssentialMat(points_a, points_b, np.eye(3), cv2.RANSAC, CONFIDENCE, tolerance)
    if found is None or len(found) < 3:
        return None
    E = np.asarray(found[:3], float)  # wrong ways round are outliers
    chosen = [min(pairs, key=lambda pair: _epipolar_distance(E, pair)) for pairs in choices]
    fitting = [pair for pair in chosen if _epipolar_distance(E, pair) < tolerance]
    return _with_scale(E, fitting) if fitting else None


def line_pose(seen: Sequence[tuple[View, Array]]) -> tuple[Array | None, list[int]]:
    """Find the pose of a wand in one frame by triangulation, and the way round that each view shows it.

    ``seen``: its views, each with the pose T_camera_root of its camera. None when fewer than two views tell it.
    """
    best: tuple[float, Array | None, list[int]] = (np.inf, None, [0] * len(seen))
    if len(seen) < 2:
        return None, best[2]
    every = range(len(seen[0][0].shape.ways))
    for second in every:  # the first view stays as it is, the second decides
        pose, _ = _fit_line(seen[:2], [0, second])
        if pose is None:
            continue
        others = [int(np.argmin([_miss(pose, *one, way) for way in every])) for one in seen[2:]]  # they follow
        pose, miss = _fit_line(seen, [0, second, *others])
        if pose is not None and miss < best[0]:
            best = miss, pose, [0, second, *others]
    return best[1], best[2]


def _turned(ideal: Array, way: int) -> Array:
    return ideal[::-1] if way else ideal


def _epipolar_distance(E: Array, pair: Pair) -> float:
    """Return the largest Sampson distance, in units of the focal length."""
    a, b = (np.column_stack([pair[side], np.ones(len(pair[side]))]) for side in (0, 1))
    line_b, line_a = a @ E.T, b @ E
    slope = np.sqrt((line_b[:, :2] ** 2).sum(1) + (line_a[:, :2] ** 2).sum(1))
    return float((np.abs((b * line_b).sum(1)) / np.maximum(slope, 1e-12)).max())


def _with_scale(E: Array, fitting: Sequence[Pair]) -> RelativePose:
    points_a, points_b = (np.concatenate([pair[side] for pair in fitting]) for side in (0, 1))
    _, R, direction, _ = cv2.recoverPose(E, points_a, points_b, np.eye(3))
    T = transform(np.asarray(R, float), np.asarray(direction, float).reshape(3))
    ratios = []
    for ideal_a, ideal_b, points in fitting:
        first, last = (_triangulate([ideal_a[end], ideal_b[end]], [np.eye(4), T]) for end in (0, -1))
        ratios.append(np.linalg.norm(points[-1] - points[0]) / np.linalg.norm(last - first))
    T[:3, 3] *= np.median(ratios)
    return RelativePose(T, len(fitting))


def _triangulate(ideal: Sequence[Array], T_camera_root: Sequence[Array]) -> Array:
    """Return the point (3,) in the root frame, by the linear method (Hartley & Zisserman 2004, 12.2)."""
    rows = [point[axis] * T[2] - T[axis] for point, T in zip(ideal, T_camera_root, strict=True) for axis in (0, 1)]
    solution = np.linalg.svd(np.array(rows))[2][-1]
    return solution[:3] / solution[3]


def _fit_line(seen: Sequence[tuple[View, Array]], ways: Sequence[int]) -> tuple[Array | None, float]:
    """The wand's pose, and how far (share of the distance) its markers are seen from it."""
    model, places = seen[0][0].shape.points, [T for _, T in seen]
    shown = [_turned(view.ideal, way) for (view, _), way in zip(seen, ways, strict=True)]
    points = np.array([_triangulate(marker, places) for marker in zip(*shown, strict=True)], float)
    if not np.isfinite(points).all():
        return None, np.inf
    R = Rotation.align_vectors(points[-1] - points[0], model[-1] - model[0])[0].as_matrix()  # the smallest that does
    pose = transform(R, (points - model @ R.T).mean(0))
    return pose, float(np.mean([_miss(pose, *one, way) for one, way in zip(seen, ways, strict=True)]))


def _miss(pose: Array, view: View, T_camera_root: Array, way: int) -> float:
    T = T_camera_root @ pose
    seen = T[:3, :3] @ view.shape.points.T + T[:3, 3:]
    if np.any(seen[2] <= 0):
        return np.inf
    return float(np.mean(np.linalg.norm(seen[:2] / seen[2] - _turned(view.ideal, way).T, axis=0)))
