"""Step 3 for wands: markers on a line have no pose in a single picture, so pairs of cameras are related by their
essential matrix (Hartley & Zisserman 2004, chapter 9), and the wand's length gives the scale.
"""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np

from capture_rig.camera import CameraModel

from .relative_poses import RelativePose
from .rigid import Array, transform
from .view import View

MIN_POINTS = 12  # the essential matrix needs five; with fewer than this, wrong labels cannot be told
INLIER_PX, CONFIDENCE = 3.0, 0.9999
LABELLING_ROUNDS = 5
MOMENT_SUPPORT = 0.5  # what a moment of a wand is worth beside a moment of a board

Pair = tuple[Array, Array, Array]  # the same markers of a moment: ideal points (n, 2) in a and b, positions (n, 3)


def relative_pose_of_line(common: Sequence[tuple[View, View]], a: CameraModel, b: CameraModel) -> RelativePose | None:
    """The pose of camera b relative to a from wands that both saw at the same moments; None when there are too few.

    Where a wand's ends cannot be told apart, each moment's numbering in b is tried both ways round.
    """
    choices = [[pair for pair in _ways_round(u, v) if len(pair[0])] for u, v in common]
    choices = [pairs for pairs in choices if pairs]
    if sum(len(pairs[0][0]) for pairs in choices) < MIN_POINTS:
        return None
    tolerance = INLIER_PX / float(np.sqrt(a.K[0, 0] * b.K[0, 0]))
    labels, E, chosen = [0] * len(choices), np.empty((0, 3)), [pairs[0] for pairs in choices]
    for _ in range(LABELLING_ROUNDS):
        chosen = [pairs[label] for pairs, label in zip(choices, labels, strict=True)]
        E = _essential(chosen, tolerance)
        if len(E) == 0:
            return None
        before, labels = labels, [int(np.argmin([_epipolar_distance(E, p).max() for p in pairs])) for pairs in choices]
        if labels == before:
            break
    fitting = [pair for pair in chosen if _epipolar_distance(E, pair).max() < tolerance]
    return _with_scale(E, fitting, len(fitting) * MOMENT_SUPPORT) if fitting else None


def line_pose(seen: Sequence[tuple[View, Array]]) -> tuple[Array | None, list[int]]:
    """The pose of a wand at one moment by triangulation, and the way round that each view needs.

    ``seen``: its views, each with the pose T_camera_root of its camera. None when fewer than two views tell it.
    """
    best: tuple[float, Array | None, list[int]] = (np.inf, None, [0] * len(seen))
    if len(seen) < 2:
        return None, best[2]
    for second in range(len(seen[0][0].shape.turns)):  # the first view stays as it is, the second decides
        turns = [0, second]
        pose, _ = _fit_line(seen[:2], turns)
        if pose is None:
            continue
        for view, T in seen[2:]:  # the others follow
            turns.append(int(np.argmin([_miss(pose, view, T, way) for way in range(len(view.shape.turns))])))
        pose, miss = _fit_line(seen, turns)
        if pose is not None and miss < best[0]:
            best = miss, pose, turns
    return best[1], best[2]


def _ways_round(u: View, v: View) -> list[Pair]:
    pairs = []
    for turn in u.shape.turns:
        ids, rows_u, rows_v = np.intersect1d(u.sighting.ids, turn.permutation[v.sighting.ids], return_indices=True)
        good = np.isfinite(u.ideal[rows_u]).all(axis=1) & np.isfinite(v.ideal[rows_v]).all(axis=1)
        pairs.append((u.ideal[rows_u][good], v.ideal[rows_v][good], u.shape.points[ids][good]))
    return pairs


def _essential(chosen: Sequence[Pair], tolerance: float) -> Array:
    """(3, 3), or (0, 3) when there is none."""
    points_a, points_b = (np.concatenate([pair[side] for pair in chosen]) for side in (0, 1))
    E, _ = cv2.findEssentialMat(points_a, points_b, np.eye(3), cv2.RANSAC, CONFIDENCE, tolerance)
    return np.empty((0, 3)) if E is None or E.shape[0] < 3 else np.asarray(E[:3], float)


def _epipolar_distance(E: Array, pair: Pair) -> Array:
    """(n,) Sampson distances, in units of the focal length."""
    a, b = (np.column_stack([pair[side], np.ones(len(pair[side]))]) for side in (0, 1))
    line_b, line_a = a @ E.T, b @ E
    slope = np.sqrt((line_b[:, :2] ** 2).sum(1) + (line_a[:, :2] ** 2).sum(1))
    return np.abs((b * line_b).sum(1)) / np.maximum(slope, 1e-12)


def _with_scale(E: Array, fitting: Sequence[Pair], support: float) -> RelativePose:
    points_a, points_b = (np.concatenate([pair[side] for pair in fitting]) for side in (0, 1))
    _, R, direction, _ = cv2.recoverPose(E, points_a, points_b, np.eye(3))
    T = transform(np.asarray(R, float), np.asarray(direction, float).reshape(3))
    ratios = []
    for ideal_a, ideal_b, points in fitting:
        ends = [int(np.argmin(points @ points[-1])), int(np.argmax(points @ points[-1]))]
        seen = [_triangulate([ideal_a[end], ideal_b[end]], [np.eye(4), T]) for end in ends]
        ratios.append(np.linalg.norm(points[ends[1]] - points[ends[0]]) / np.linalg.norm(seen[1] - seen[0]))
    T[:3, 3] *= np.median(ratios)
    return RelativePose(T, support)


def _triangulate(ideal: Sequence[Array], T_camera_root: Sequence[Array]) -> Array:
    """The point (3,) in the root frame, by the linear method (Hartley & Zisserman 2004, 12.2)."""
    rows = [point[axis] * T[2] - T[axis] for point, T in zip(ideal, T_camera_root, strict=True) for axis in (0, 1)]
    solution = np.linalg.svd(np.array(rows))[2][-1]
    return solution[:3] / solution[3]


def _fit_line(seen: Sequence[tuple[View, Array]], turns: Sequence[int]) -> tuple[Array | None, float]:
    """The wand's pose from all markers that two views show, and how far (share of the distance) they are from it."""
    shape = seen[0][0].shape
    ids = [shape.turns[turn].permutation[view.sighting.ids] for (view, _), turn in zip(seen, turns, strict=True)]
    found, where = [], []
    for marker in range(len(shape.points)):
        shown = [
            (view.ideal[np.flatnonzero(rows == marker)[0]], T)
            for (view, T), rows in zip(seen, ids, strict=True)
            if marker in rows
        ]
        if len(shown) >= 2 and all(np.isfinite(ideal).all() for ideal, _ in shown):
            found.append(_triangulate([ideal for ideal, _ in shown], [T for _, T in shown]))
            where.append(marker)
    if len(found) < 2 or not np.isfinite(found).all():
        return None, np.inf
    points, model = np.array(found, float), shape.points[where]
    along, direction = model[-1] - model[0], points[-1] - points[0]
    R = _swing(along / np.linalg.norm(along), direction / np.linalg.norm(direction))
    pose = transform(R, (points - model @ R.T).mean(0))
    return pose, float(np.mean([_miss(pose, view, T, turn) for (view, T), turn in zip(seen, turns, strict=True)]))


def _miss(pose: Array, view: View, T_camera_root: Array, turn: int) -> float:
    ids = view.shape.turns[turn].permutation[view.sighting.ids]
    T = T_camera_root @ pose
    seen = T[:3, :3] @ view.shape.points[ids].T + T[:3, 3:]
    if np.any(seen[2] <= 0) or not np.isfinite(view.ideal).all():
        return np.inf
    return float(np.mean(np.linalg.norm(seen[:2] / seen[2] - view.ideal.T, axis=0)))


def _swing(a: Array, b: Array) -> Array:
    """The smallest rotation that takes unit vector a to b."""
    axis, cosine = np.cross(a, b), float(a @ b)
    if cosine < -1 + 1e-12:
        across = np.linalg.svd(a[None])[2][1]
        return 2 * np.outer(across, across) - np.eye(3)
    K = np.array([[0, -axis[2], axis[1]], [axis[2], 0, -axis[0]], [-axis[1], axis[0], 0]])
    return np.eye(3) + K + K @ K / (1 + cosine)
