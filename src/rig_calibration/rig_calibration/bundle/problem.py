"""What the solver is given, checked and put in order."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from capture_rig.camera import CameraModel
from capture_rig.errors import InputError

from ..boards.sighting import Sighting
from .observations import LENS
from .rigid import Array
from .target_shape import TargetShape, shapes_of
from .view_graph import Key


@dataclass(frozen=True, eq=False)
class Problem:
    """Cameras and targets in name order, sightings by (target, moment, camera) with corners by id.

    ``lens_covariance``: (12, 12) of fx fy cx cy k1 k2 p1 p2 k3 k4 k5 k6, of the cameras for which it was given.
    """

    cameras: dict[str, CameraModel]
    shapes: dict[str, TargetShape]
    sightings: tuple[Sighting, ...]
    lens_covariance: dict[str, Array]

    @property
    def keys(self) -> tuple[Key, ...]:
        """All (target, moment), in order."""
        return tuple(sorted({(sighting.target, sighting.moment) for sighting in self.sightings}))


def check_problem(
    cameras: Mapping[str, CameraModel],
    sightings: Sequence[Sighting],
    targets: Mapping[str, npt.ArrayLike],
    turnable: Mapping[str, int],
    intrinsics_covariance: Mapping[str, npt.ArrayLike],
) -> Problem:
    """The problem in an order that does not depend on the order given; InputError for what does not fit together."""
    models = {name: cameras[name] for name in sorted(cameras)}
    if not models:
        raise InputError("there is no camera to place", remedy="Give the intrinsics of at least one camera.")
    shapes = shapes_of(targets, turnable)
    ordered = tuple(_by_id(s) for s in sorted(sightings, key=lambda s: (s.target, s.moment, s.camera)))
    for before, sighting in zip((None, *ordered), ordered, strict=False):
        _check_sighting(sighting, models, shapes)
        if before and _name(before) == _name(sighting):
            raise InputError(f"there are two sightings {_name(sighting)}", remedy="Give each picture once.")
    covariances = {
        name: _lens_covariance(models, name, intrinsics_covariance[name]) for name in sorted(intrinsics_covariance)
    }
    return Problem(models, shapes, ordered, covariances)


def _by_id(sighting: Sighting) -> Sighting:
    order = np.argsort(sighting.ids, kind="stable")
    return replace(
        sighting,
        ids=np.asarray(sighting.ids, np.int64)[order],
        pixels=np.asarray(sighting.pixels, float).reshape(-1, 2)[order],
    )


def _name(sighting: Sighting) -> str:
    target = f" of target '{sighting.target}'" if sighting.target else ""
    return f"by camera '{sighting.camera}' at moment {sighting.moment}{target}"


def _check_sighting(sighting: Sighting, cameras: Mapping[str, CameraModel], shapes: Mapping[str, TargetShape]) -> None:
    where = f"the sighting {_name(sighting)}"
    if sighting.camera not in cameras:
        raise InputError(
            f"there are no intrinsics of camera '{sighting.camera}'",
            where=where,
            remedy=f"Calibrate it first; known cameras: {', '.join(cameras)}.",
        )
    if sighting.target not in shapes:
        raise InputError(
            f"target '{sighting.target}' is not known",
            where=where,
            remedy=f"Known targets: {', '.join(map(repr, shapes))}.",
        )
    camera = cameras[sighting.camera]
    if tuple(sighting.image_size) != (camera.width, camera.height):
        raise InputError(
            f"its image has {sighting.image_size[0]} x {sighting.image_size[1]} pixels, the camera's "
            f"intrinsics are for {camera.width} x {camera.height}",
            where=where,
            remedy="Calibrate the intrinsics at the image size that the camera is used with.",
        )
    count = len(shapes[sighting.target].points)
    if len(sighting.pixels) != len(sighting.ids) or len(set(sighting.ids.tolist())) != len(sighting.ids):
        raise InputError("its corners are not numbered one by one", where=where, remedy="Give each corner one id.")
    if len(sighting.ids) and not 0 <= sighting.ids.min() <= sighting.ids.max() < count:
        raise InputError(
            f"it has corner {sighting.ids.max()}, the target has {count}",
            where=where,
            remedy="Use the target that was calibrated with.",
        )
    if not np.isfinite(sighting.pixels).all() or not sighting.sigma_px > 0:
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
