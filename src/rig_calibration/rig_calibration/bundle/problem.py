"""What the solver is given, checked and put in order: cameras, rigid targets, detections.

A target is a set of points about their centroid. What a picture does not show of it is part of its shape: rotations
that map the points onto themselves (a symmetric target), and, of a board, how far its middle stands out of its plane.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt
from scipy.spatial import cKDTree

from capture_rig.camera import CameraModel
from capture_rig.errors import InputError

from ..boards.board import Board, Checkerboard, TargetDetection
from .rigid import Array, rotation
from .view_graph import PoseKey

LENS = 12  # fx fy cx cy k1 k2 p1 p2 k3 k4 k5 k6


@dataclass(frozen=True, eq=False)
class Problem:
    """Cameras and targets in name order, detections by (target, frame, camera) with corners by id.

    ``lens_covariance``: (12, 12) of fx fy cx cy k1 k2 p1 p2 k3 k4 k5 k6, of the cameras for which it was given.
    """

    cameras: dict[str, CameraModel]
    shapes: dict[str, TargetShape]
    detections: tuple[TargetDetection, ...]
    lens_covariance: dict[str, Array]

    @property
    def keys(self) -> tuple[PoseKey, ...]:
        """All (target, frame), in order."""
        return tuple(sorted({(detection.target, detection.frame_index) for detection in self.detections}))


def check_problem(
    cameras: Mapping[str, CameraModel],
    detections: Sequence[TargetDetection],
    targets: Mapping[str, npt.ArrayLike],
    symmetry_orders: Mapping[str, int],
    intrinsics_covariance: Mapping[str, npt.ArrayLike],
) -> Problem:
    """Check the input and put it in an order that does not depend on the order given; InputError for what does not fit
    together."""
    models = {name: cameras[name] for name in sorted(cameras)}
    if not models:
        raise InputError("there is no camera to place", remedy="Give the intrinsics of at least one camera.")
    shapes = shapes_of(targets, symmetry_orders)
    ordered = tuple(_by_id(s) for s in sorted(detections, key=lambda s: (s.target, s.frame_index, s.camera)))
    for before, detection in zip((None, *ordered), ordered, strict=False):
        _check_detection(detection, models, shapes)
        if before and _name(before) == _name(detection):
            raise InputError(f"there are two detections {_name(detection)}", remedy="Give each picture once.")
    covariances = {
        name: _lens_covariance(models, name, intrinsics_covariance[name]) for name in sorted(intrinsics_covariance)
    }
    return Problem(models, shapes, ordered, covariances)


def _by_id(detection: TargetDetection) -> TargetDetection:
    order = np.argsort(detection.ids, kind="stable")
    return replace(
        detection,
        ids=np.asarray(detection.ids, np.int64)[order],
        pixels=np.asarray(detection.pixels, float).reshape(-1, 2)[order],
    )


def _name(detection: TargetDetection) -> str:
    target = f" of target '{detection.target}'" if detection.target else ""
    return f"by camera '{detection.camera}' in frame {detection.frame_index}{target}"


def _check_detection(
    detection: TargetDetection, cameras: Mapping[str, CameraModel], shapes: Mapping[str, TargetShape]
) -> None:
    where = f"the detection {_name(detection)}"
    if detection.camera not in cameras:
        raise InputError(
            f"there are no intrinsics of camera '{detection.camera}'",
            where=where,
            remedy=f"Calibrate it first; known cameras: {', '.join(cameras)}.",
        )
    if detection.target not in shapes:
        raise InputError(
            f"target '{detection.target}' is not known",
            where=where,
            remedy=f"Known targets: {', '.join(map(repr, shapes))}.",
        )
    camera = cameras[detection.camera]
    if tuple(detection.image_size) != (camera.width, camera.height):
        raise InputError(
            f"its image has {detection.image_size[0]} x {detection.image_size[1]} pixels, the camera's "
            f"intrinsics are for {camera.width} x {camera.height}",
            where=where,
            remedy="Calibrate the intrinsics at the image size that the camera is used with.",
        )
    count = len(shapes[detection.target].points)
    if len(detection.pixels) != len(detection.ids) or len(set(detection.ids.tolist())) != len(detection.ids):
        raise InputError("its corners are not numbered one by one", where=where, remedy="Give each corner one id.")
    if len(detection.ids) and not 0 <= detection.ids.min() <= detection.ids.max() < count:
        raise InputError(
            f"it has corner {detection.ids.max()}, the target has {count}",
            where=where,
            remedy="Use the target that was calibrated with.",
        )
    if not np.isfinite(detection.pixels).all() or not detection.sigma_px > 0:
        raise InputError("its pixels are not finite, or sigma_px is not positive", where=where)


def _lens_covariance(cameras: Mapping[str, CameraModel], name: str, given: npt.ArrayLike) -> Array:
    if name not in cameras:
        raise InputError(f"intrinsics covariance of an unknown camera '{name}'", remedy=f"Known: {', '.join(cameras)}.")
    matrix = np.asarray(given, float)
    matrix = np.diag(matrix**2) if matrix.ndim == 1 else matrix
    size, sizes = len(matrix), (4, 4 + len(cameras[name].D))
    if size not in sizes or matrix.shape != (size, size):
        raise InputError(
            f"intrinsics covariance of camera '{name}' has shape {np.shape(given)}",
            remedy=f"Give {sizes[0]} or {sizes[1]} standard deviations (fx fy cx cy and distortion), "
            "or their covariance matrix.",
        )
    full = np.zeros((LENS, LENS))
    full[:size, :size] = matrix
    return full


# --- Targets.

LINE, PLANE, VOLUME = 1, 2, 3
FLAT = 1e-6  # of the target's size


@dataclass(frozen=True, eq=False)
class Symmetry:
    """A turn that maps the target onto itself: point i comes to lie on point ``permutation[i]``."""

    permutation: npt.NDArray[np.int64]
    R: Array


@dataclass(frozen=True, eq=False)
class TargetShape:
    """Points (n, 3) of a rigid target about their ``centroid`` (3,), metres, target frame.

    ``dimension`` is LINE, PLANE or VOLUME. ``bend`` (n, 2): how far a corner stands out along z where the middle does
    by one metre, for a sheet that is bent along x and along y. ``symmetries`` are the turns that a picture does not
    show, the identity first.
    """

    name: str
    points: Array
    centroid: Array
    bend: Array
    dimension: int
    symmetries: tuple[Symmetry, ...]


def target_shape(name: str, points_target: npt.ArrayLike, symmetry_order: int = 1) -> TargetShape:
    """Describe the shape of a target with points (n, 3) that looks alike after 1/``symmetry_order`` of a turn.

    Raises InputError for fewer than two points, and when the points do not look alike after that turn.
    """
    points = np.asarray(points_target, float).reshape(-1, 3)
    if len(points) < 2 or not np.isfinite(points).all():
        raise InputError(f"target '{name}' has {len(points)} points", remedy="Give at least two points, in metres.")
    centred = points - points.mean(0)
    _, spread, axes = np.linalg.svd(centred, full_matrices=True)
    dimension = max(int(np.sum(spread > FLAT * spread[0])), 1)
    axis = axes[2] if dimension == PLANE else axes[1]  # of a line: any axis across it
    found = [_turn(centred, axis * 2 * np.pi * k / symmetry_order) for k in range(symmetry_order)]
    if any(symmetry is None for symmetry in found):
        raise InputError(
            f"target '{name}' does not look alike after 1/{symmetry_order} of a turn",
            remedy="Give it a symmetry order only when a picture does not show its turns.",
        )
    bend = 1.0 - (centred[:, :2] / np.maximum(np.abs(centred[:, :2]).max(axis=0), 1e-300)) ** 2
    symmetries = tuple(symmetry for symmetry in found if symmetry is not None)
    return TargetShape(name, centred, points.mean(0), bend, dimension, symmetries)


def symmetry_order_of(board: Board) -> int:
    """Tell how many ways round a board may lie without a picture showing it: 1 (its corners are told apart), 2 or 4."""
    if board.half_turn_is_visible or not isinstance(board, Checkerboard):
        return 1
    square = board.columns == board.rows and board.field_m[0] == board.field_m[1]
    return 4 if square and board.columns % 2 == 0 else 2


def shapes_of(targets: Mapping[str, npt.ArrayLike], symmetry_orders: Mapping[str, int]) -> dict[str, TargetShape]:
    """Describe the shapes of all targets, in name order."""
    return {name: target_shape(name, targets[name], symmetry_orders.get(name, 1)) for name in sorted(targets)}


def _turn(centred: Array, vector: Array) -> Symmetry | None:
    R = rotation(vector)
    distance, nearest = cKDTree(centred).query(centred @ R.T)
    alike = distance.max() < 1e-3 * np.abs(centred).max() and len(set(nearest.tolist())) == len(nearest)
    return Symmetry(nearest.astype(np.int64), R) if alike else None
