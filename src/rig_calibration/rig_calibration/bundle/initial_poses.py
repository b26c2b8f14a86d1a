"""Steps 2 and 3: which cameras are tied together, and first poses of all cameras and targets.

Two cameras are tied when both see the same target in the same frame. Every frame allows several relative poses of the
two: two planar solutions in each camera, times the invisible half turns. The right ones agree from frame to frame, the
wrong ones scatter: the candidate wins that most frames support. Such pairs are chained along the best supported ones (a
maximum spanning tree from the best seen camera). Then the views vote likewise for the pose of each target in each
frame, and for the way round it lies.

The markers of a wand lie on a line and have no pose in a single picture. Pairs of cameras are related by their
essential matrix (Hartley & Zisserman 2004, chapter 9), the wand's length gives the scale, and the wand itself is
triangulated. A view of a wand shows all its markers; of one that looks the same from both ends, in either order.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from itertools import combinations
from typing import NamedTuple

import cv2
import numpy as np
from scipy.sparse.csgraph import connected_components
from scipy.spatial.transform import Rotation

from capture_rig.camera import CameraModel
from capture_rig.errors import InputError
from capture_rig.lens import Array
from capture_rig.rigid import angles_between, inverse, transform
from capture_rig.small_matrices import robust_weight

from ..boards.board import TargetDetection
from .problem import LINE, DetectionPoses, PoseKey, TargetView

# Thresholds: judgement, no measurement.
TOLERANCE = 0.05  # of the rotation by one board, rad, and of the board's distance


def groups_of(cameras: Iterable[str], pairs: Iterable[tuple[str, str]]) -> list[tuple[str, ...]]:
    """Find the groups of cameras that pairs link, largest first, names in order within each."""
    names = sorted(cameras)
    links = np.zeros((len(names), len(names)), bool)
    for a, b in pairs:
        links[names.index(a), names.index(b)] = True
    count, group = connected_components(links, directed=False)
    groups = [tuple(name for name, of in zip(names, group, strict=True) if of == k) for k in range(count)]
    return sorted(groups, key=lambda group: (-len(group), group))


def common_frames(detections: Sequence[TargetDetection]) -> dict[tuple[str, str], int]:
    """Count the poses of targets that each pair of cameras (in name order) shares, without pairs that share none."""
    counts = Counter(pair for seen in cameras_by_pose(detections).values() for pair in combinations(sorted(seen), 2))
    return dict(sorted(counts.items()))


def cameras_by_pose(detections: Iterable[TargetDetection]) -> dict[PoseKey, set[str]]:
    """Find which cameras saw each pose of a target."""
    seen: dict[PoseKey, set[str]] = {}
    for detection in detections:
        seen.setdefault((detection.target, detection.frame_index), set()).add(detection.camera)
    return seen


def require_connected(
    cameras: Iterable[str], detections: Sequence[TargetDetection], lost: Mapping[str, str] | None = None
) -> None:
    """Raise InputError naming cameras that see no target, or the groups of cameras that share no view.

    ``lost`` : by camera, why detections that would have linked it were left out.
    """
    names, reasons = sorted(cameras), lost or {}
    blind = sorted(set(names) - {detection.camera for detection in detections})
    why = "".join(f" Left out for {name}: {reasons[name]}." for name in blind or names if name in reasons)
    if blind:
        raise InputError(
            f"{', '.join(blind)}: no picture that can be used shows a target.{why}",
            remedy="Show the board to it, or leave that camera out.",
        )
    groups = groups_of(names, common_frames(detections))
    if len(groups) > 1:
        listed = " | ".join(", ".join(group) for group in groups)
        raise InputError(
            f"these groups of cameras share no view: {listed}.{why}",
            remedy="Show the board where cameras of both groups see it in the same frame.",
        )


# --- First poses.


class RelativePose(NamedTuple):
    """``T_b_a`` (4, 4) maps coordinates in camera a to camera b; ``support``: number of frames that agree."""

    T_b_a: Array
    support: float


class InitialPoses(NamedTuple):
    """First poses in the frame of camera ``root``; ``ways``: view by view, which way round it lies."""

    root: str
    T_camera_root: dict[str, Array]
    T_root_target: dict[PoseKey, Array]
    ways: tuple[int, ...]


def initial_poses(cameras: Mapping[str, CameraModel], views: Sequence[TargetView]) -> InitialPoses:
    """Find poses good enough to start the adjustment from; InputError when the pairs leave a camera untied."""
    pairs = relative_poses(cameras, views)
    root, T_camera_root = poses_along_spanning_tree(sorted(cameras), pairs)
    T_root_target: dict[PoseKey, Array] = {}
    ways = dict.fromkeys(range(len(views)), 0)
    rows_by_key: dict[PoseKey, list[int]] = {}
    for row, view in enumerate(views):
        rows_by_key.setdefault(view.key, []).append(row)
    for key, rows in rows_by_key.items():
        find = line_pose if views[rows[0]].shape.dimension == LINE else _vote
        pose, found = find([(views[i], T_camera_root[views[i].detection.camera]) for i in rows])
        if pose is not None:
            T_root_target[key] = pose
            ways.update(zip(rows, found, strict=True))
    return InitialPoses(root, T_camera_root, T_root_target, tuple(ways.values()))


def relative_poses(
    cameras: Mapping[str, CameraModel], views: Sequence[TargetView]
) -> dict[tuple[str, str], RelativePose]:
    """Find the relative pose of each pair of cameras (a < b) with common frames, by boards or, where better, by
    wands."""
    by_camera: dict[str, dict[PoseKey, TargetView]] = {name: {} for name in sorted(cameras)}
    for view in views:
        by_camera[view.detection.camera][view.key] = view
    pairs = {}
    for a, b in combinations(by_camera, 2):
        common = [(by_camera[a][key], by_camera[b][key]) for key in sorted(by_camera[a].keys() & by_camera[b])]
        boards = [(u.poses, v.poses) for u, v in common if u.poses is not None and v.poses is not None]
        lines = [(u, v) for u, v in common if u.shape.dimension == LINE]
        found = [_relative_pose(boards)] if boards else []
        found += [pose for pose in [relative_pose_of_line(lines, cameras[a], cameras[b])] if pose]
        if found:
            pairs[a, b] = max(found, key=lambda pose: pose.support)
    return pairs


def poses_along_spanning_tree(
    names: Sequence[str], pairs: Mapping[tuple[str, str], RelativePose]
) -> tuple[str, dict[str, Array]]:
    """Find the best supported camera and the poses of all cameras in its frame, along the maximum spanning tree."""
    support = {name: sum(pose.support for pair, pose in pairs.items() if name in pair) for name in names}
    root = max(names, key=lambda name: support[name])
    T_camera_root = {root: np.eye(4)}
    while len(T_camera_root) < len(names):
        edges = [
            (pose.support, (a, b)) for (a, b), pose in pairs.items() if (a in T_camera_root) != (b in T_camera_root)
        ]
        if not edges:
            lost = ", ".join(name for name in names if name not in T_camera_root)
            raise InputError(
                f"{lost}: too few common views of the wand to tie it to the other cameras",
                remedy="Wave it longer where cameras see it at the same time.",
            )
        _, (a, b) = max(edges, key=lambda edge: edge[0])
        if a in T_camera_root:
            T_camera_root[b] = pairs[a, b].T_b_a @ T_camera_root[a]
        else:
            T_camera_root[a] = inverse(pairs[a, b].T_b_a) @ T_camera_root[b]
    return root, T_camera_root


def _relative_pose(common: Sequence[tuple[DetectionPoses, DetectionPoses]]) -> RelativePose:
    """Find the pose of camera b relative to a from targets in the same frames: pairs (poses in a, poses in b)."""
    observed = []
    for a, b in common:
        own = a.way == 0  # only the turn of one against the other matters
        T_b_a = transform(b.R, b.t) @ inverse(transform(a.R[own], a.t[own]))[:, None]
        weight, distance = a.weight[own, None] * b.weight, np.linalg.norm(b.t, axis=1)
        observed.append(_Allowed(T_b_a.reshape(-1, 4, 4), weight.ravel(), np.tile(distance, own.sum())))
    return RelativePose(*_consensus(observed)[:2])


def _vote(seen: Sequence[tuple[TargetView, Array]]) -> tuple[Array | None, list[int]]:
    """Return the pose of a target in a frame that its views agree on best, and the way round in each view."""
    observed = []
    for view, T_camera_root in seen:
        if (poses := view.poses) is not None:
            weight = poses.weight * (1 - 1e-6 * poses.way)  # of two alike, the numbering as it is
            T_root_target = inverse(T_camera_root) @ transform(poses.R, poses.t)
            observed.append(_Allowed(T_root_target, weight, np.linalg.norm(poses.t, axis=1)))
    if not observed:
        return None, [0] * len(seen)
    T, _, rows = _consensus(observed)
    chosen = iter(rows)
    return T, [0 if view.poses is None else int(view.poses.way[next(chosen)]) for view, _ in seen]


class _Allowed(NamedTuple):
    """The poses (h, 4, 4) that one observation allows, weights (h,) by their fit beside the best, and the target's
    distance (h,), m."""

    T: Array
    weight: Array
    distance: Array


def _consensus(observed: Sequence[_Allowed]) -> tuple[Array, float, list[int]]:
    """Return the pose that most observations agree on, how many that is, and the row of each that agrees best."""
    candidates = np.concatenate([allowed.T for allowed in observed])
    votes, best = np.zeros(len(candidates)), []
    for allowed in observed:
        miss = np.linalg.norm(candidates[:, None, :3, 3] - allowed.T[None, :, :3, 3], axis=2) / allowed.distance
        angle = angles_between(candidates[:, :3, :3], allowed.T[:, :3, :3])
        agreement = robust_weight.py_func(allowed.weight, (angle**2 + miss**2) / TOLERANCE**2)
        votes += agreement.max(axis=1)
        best.append(agreement.argmax(axis=1))
    votes *= 1 + 1e-6 * np.concatenate([allowed.weight for allowed in observed])
    winner = int(np.argmax(np.round(votes, 9)))
    return candidates[winner], float(votes[winner]), [int(rows[winner]) for rows in best]


# --- Wands.

MIN_POINTS = 12  # the essential matrix needs five; with fewer than this, wrong labels go undetected
INLIER_PX, CONFIDENCE = 3.0, 0.9999
Pair = tuple[Array, Array, Array]  # a wand in a frame: its markers' ideal points (k, 2) in a and b, positions (k, 3)


def relative_pose_of_line(
    common: Sequence[tuple[TargetView, TargetView]], a: CameraModel, b: CameraModel
) -> RelativePose | None:
    """Find the pose of camera b relative to a from wands that both saw in the same frames; None when there are too few.

    Where a wand's ends are not distinguished, each frame's numbering in b is tried both ways round.
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


def line_pose(seen: Sequence[tuple[TargetView, Array]]) -> tuple[Array | None, list[int]]:
    """Find the pose of a wand in one frame by triangulation, and the way round that each view shows it.

    ``seen``: its views, each with the pose T_camera_root of its camera. None when fewer than two views determine it.
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


def _fit_line(seen: Sequence[tuple[TargetView, Array]], ways: Sequence[int]) -> tuple[Array | None, float]:
    """Return the wand's pose, and the markers' misfit as a share of the distance."""
    model, places = seen[0][0].shape.points, [T for _, T in seen]
    shown = [_turned(view.ideal, way) for (view, _), way in zip(seen, ways, strict=True)]
    points = np.array([_triangulate(marker, places) for marker in zip(*shown, strict=True)], float)
    if not np.isfinite(points).all():
        return None, np.inf
    R = Rotation.align_vectors(points[-1] - points[0], model[-1] - model[0])[0].as_matrix()  # the smallest that does
    pose = transform(R, (points - model @ R.T).mean(0))
    return pose, float(np.mean([_miss(pose, *one, way) for one, way in zip(seen, ways, strict=True)]))


def _miss(pose: Array, view: TargetView, T_camera_root: Array, way: int) -> float:
    T = T_camera_root @ pose
    seen = T[:3, :3] @ view.shape.points.T + T[:3, 3:]
    if np.any(seen[2] <= 0):
        return np.inf
    return float(np.mean(np.linalg.norm(seen[:2] / seen[2] - _turned(view.ideal, way).T, axis=0)))
