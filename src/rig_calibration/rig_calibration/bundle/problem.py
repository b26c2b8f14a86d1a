"""What the solver is given, checked and put in order."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from capture_rig.camera import CameraModel
from capture_rig.errors import InputError

from ..boards.board import TargetDetection
from .rigid import Array
from .state import LENS
from .target_shape import TargetShape, shapes_of
from .view_graph import PoseKey


@dataclass(frozen=True, eq=False)
class Problem:
    """Cameras and targets in name order, detections by (target, moment, camera) with corners by id.

    ``lens_covariance``: (12, 12) of fx fy cx cy k1 k2 p1 p2 k3 k4 k5 k6, of the cameras for which it was given.
    """

    cameras: dict[str, CameraModel]
    shapes: dict[str, TargetShape]
    detections: tuple[TargetDetection, ...]
    lens_covariance: dict[str, Array]

    @property
    def keys(self) -> tuple[PoseKey, ...]:
        """All (target, moment), in order."""
        return tuple(sorted({(detection.target, detection.frame_index) for detection in self.detections}))


def check_problem(
    cameras: Mapping[str, CameraModel],
    detections: Sequence[TargetDetection],
    targets: Mapping[str, npt.ArrayLike],
    symmetry_orders: Mapping[str, int],
    intrinsics_covariance: Mapping[str, npt.ArrayLike],
) -> Problem:
    """The problem in an order that does not depend on the order given; InputError for what does not fit together."""
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
    return f"by camera '{detection.camera}' at moment {detection.frame_index}{target}"


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
