"""The solver's input, checked and sorted: cameras, rigid targets, detections.

A target is a set of points about their centroid. Its shape includes its ambiguities: whether half a turn maps the
points onto themselves, and, of a board, the warp of its middle out of its plane.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass

import cv2
import numpy as np
import numpy.typing as npt

from capture_rig.camera import CameraModel
from capture_rig.errors import InputError
from capture_rig.lens import Array
from capture_rig.rigid import rotation_matrix

from ..boards.board import TargetDetection

LENS = 12  # fx fy cx cy k1 k2 p1 p2 k3 k4 k5 k6
PoseKey = tuple[str, int]  # (target, frame): one pose of one target


@dataclass(frozen=True, eq=False)
class Problem:
    """Cameras and targets in name order, detections by (target, frame, camera) with corners by id.

    ``lens_sd``: (12,) of fx fy cx cy k1 k2 p1 p2 k3 k4 k5 k6, of the cameras for which it was given.
    """

    cameras: dict[str, CameraModel]
    shapes: dict[str, TargetShape]
    detections: tuple[TargetDetection, ...]
    lens_sd: dict[str, Array]

    @property
    def keys(self) -> tuple[PoseKey, ...]:
        """All (target, frame), in order."""
        return tuple(sorted({(detection.target, detection.frame_index) for detection in self.detections}))


def check_problem(
    cameras: Mapping[str, CameraModel],
    detections: Sequence[TargetDetection],
    targets: Mapping[str, npt.ArrayLike],
    alike: Collection[str],
    intrinsics_sd: Mapping[str, Sequence[float]],
) -> Problem:
    """Sort the input, independent of its order; InputError for images of another size than
    the camera's lens was calibrated for."""
    models = {name: cameras[name] for name in sorted(cameras)}
    ordered = tuple(sorted(detections, key=lambda s: (s.target, s.frame_index, s.camera)))
    for detection in ordered:
        (width, height), camera = detection.image_size, models[detection.camera]
        if (width, height) != (camera.width, camera.height):
            raise InputError(
                f"its images are {width} x {height} pixels, its intrinsics are for {camera.width} x {camera.height}",
                where=camera.name,
                remedy="Calibrate the lens at the size that the camera delivers, or give footage of that size.",
            )
    sd = {name: np.pad(np.asarray(given, float), (0, LENS - len(given))) for name, given in intrinsics_sd.items()}
    return Problem(models, shapes_of(targets, alike), ordered, sd)


# --- Targets.

LINE, PLANE = 1, 2
THIN = 0.02  # of the target's length: points that spread less across lie, in effect, on a line


@dataclass(frozen=True, eq=False)
class TargetShape:
    """Points (n, 3) of a rigid, flat target about their ``centroid`` (3,), metres, target frame.

    ``dimension`` is LINE or PLANE. ``bend`` (n, 2): offset of each corner along z per metre of the middle's, for a
    sheet that is bent along x and along y. ``ways`` (1 or 2, 3, 3): the identity and, where it maps the points onto
    themselves in reverse order, half a turn: the ways round that a picture does not distinguish.
    """

    name: str
    points: Array
    centroid: Array
    bend: Array
    dimension: int
    ways: Array

    def numbered(self, ids: npt.NDArray[np.int64], way: int) -> npt.NDArray[np.int64]:
        """Return the ids of the same points, the target lying the other ``way`` round."""
        return len(self.points) - 1 - ids if way else ids


def target_shape(name: str, points_target: npt.ArrayLike, looks_alike: bool = False) -> TargetShape:
    """Describe the shape of a target with points (n, 3), which may look alike after half a turn."""
    points = np.asarray(points_target, float)
    centred = points - points.mean(0)
    _, spread, axes = np.linalg.svd(centred, full_matrices=True)
    dimension = PLANE if spread[1] > THIN * spread[0] else LINE
    axis = axes[2] if dimension == PLANE else axes[1]  # of a line: any axis across it
    ways = rotation_matrix(np.pi * np.arange(1 + looks_alike)[:, None] * axis)
    bend = 1.0 - (centred[:, :2] / np.maximum(np.abs(centred[:, :2]).max(axis=0), 1e-300)) ** 2
    return TargetShape(name, centred, points.mean(0), bend, dimension, ways)


def shapes_of(targets: Mapping[str, npt.ArrayLike], alike: Collection[str] = ()) -> dict[str, TargetShape]:
    """Describe the shapes of all targets, in name order."""
    return {name: target_shape(name, targets[name], name in alike) for name in sorted(targets)}


# --- Step 1: where a target may be, by one picture of it alone.
#
# A plane seen by a camera has two poses that fit, mirror images of each other about the line of sight (Collins and
# Bartoli 2014, "Infinitesimal Plane-based Pose Estimation"); a small or distant board leaves both possible. A target
# that looks alike after half a turn doubles them. All are kept until other cameras or frames decide.

MIN_CORNERS = 4


@dataclass(frozen=True, eq=False)
class DetectionPoses:
    """Poses of a (centred) target in the camera's frame that fit one detection, by falling fit.

    R (h, 3, 3), t (h, 3): x_camera = R x + t; rms_px (h,): distance of the corners, undistorted; way (h,): which
    of the ways round, 0 being the corners as they were numbered.
    """

    R: Array
    t: Array
    rms_px: Array
    way: npt.NDArray[np.int64]

    @property
    def weight(self) -> Array:
        """(h,) likelihood of each over that of the best one, 1 to 0."""
        return (self.rms_px.min() / self.rms_px) ** 2


def poses_of(
    ids: npt.NDArray[np.int64], ideal: Array, camera: CameraModel, shape: TargetShape
) -> DetectionPoses | None:
    """Find all poses that corners without distortion (n, 2) allow; None when they are too few, or lie on a line, or fit
    no pose."""
    reached = np.isfinite(ideal).all(axis=1)
    points, ideal = shape.points[ids[reached]], ideal[reached]
    if shape.dimension == LINE or len(points) < MIN_CORNERS:
        return None
    longest, across = np.linalg.svd(points - points.mean(0), compute_uv=False)[:2]
    if across < THIN * longest:
        return None
    focal_px = float(np.sqrt(camera.K[0, 0] * camera.K[1, 1]))
    refined = [_refine(points, ideal, R, t) for R, t in _planar(points, ideal)]
    scored = [(_rms(points, ideal, R, t) * focal_px, R, t) for R, t in refined if np.all(points @ R[2] + t[2] > 0)]
    if not scored:
        return None
    scored.sort(key=lambda one: one[0])
    rms, R, t = (np.array(column) for column in zip(*scored, strict=True))
    ways, each = shape.ways, len(rms)
    return DetectionPoses(
        (R @ ways[:, None].swapaxes(-1, -2)).reshape(-1, 3, 3),
        np.tile(t, (len(ways), 1)),
        np.tile(np.maximum(rms, 1e-9), len(ways)),
        np.repeat(np.arange(len(ways)), each),
    )


def _planar(points: Array, ideal: Array) -> list[tuple[Array, Array]]:
    """Both solutions of IPPE, in the plane's own axes."""
    centre = points.mean(0)
    axes = np.linalg.svd(points - centre)[2]
    axes[2] *= np.linalg.det(axes)
    flat = (points - centre) @ axes.T
    flat[:, 2] = 0.0
    _, rotations, translations, _ = cv2.solvePnPGeneric(flat, ideal, np.eye(3), None, flags=cv2.SOLVEPNP_IPPE)
    found: list[tuple[Array, Array]] = []
    for vector, translation in zip(rotations, translations, strict=True):
        R = rotation_matrix(np.ravel(vector)) @ axes
        found.append((R, np.ravel(translation) - R @ centre))
    return [(R, t) for R, t in found if np.isfinite(R).all() and np.isfinite(t).all()]


def _refine(points: Array, ideal: Array, R: Array, t: Array) -> tuple[Array, Array]:
    vector, translation = cv2.solvePnPRefineLM(points, ideal, np.eye(3), None, cv2.Rodrigues(R)[0], t.reshape(3, 1))
    return rotation_matrix(np.ravel(vector)), np.ravel(translation)


def _rms(points: Array, ideal: Array, R: Array, t: Array) -> float:
    seen = points @ R.T + t
    return float(np.sqrt(np.mean(np.sum((seen[:, :2] / seen[:, 2:] - ideal) ** 2, axis=1))))


@dataclass(frozen=True, eq=False)
class TargetView:
    """A detection, its corners without distortion (n, 2), and the poses of the target that it alone allows (None: it
    allows no conclusion by itself)."""

    detection: TargetDetection
    shape: TargetShape
    ideal: Array
    poses: DetectionPoses | None

    @property
    def key(self) -> PoseKey:
        return self.detection.target, self.detection.frame_index

    @property
    def links(self) -> bool:
        """Whether it ties its camera to others: a wand does so together with other frames, a board by its pose."""
        return self.poses is not None or self.shape.dimension == LINE


def views_of(
    detections: Sequence[TargetDetection], cameras: Mapping[str, CameraModel], shapes: Mapping[str, TargetShape]
) -> list[TargetView]:
    """Make the views of all detections, in their order."""
    views = []
    for detection in detections:
        shape, camera = shapes[detection.target], cameras[detection.camera]
        ideal = camera.ideal_points(detection.pixels)
        views.append(TargetView(detection, shape, ideal, poses_of(detection.ids, ideal, camera, shape)))
    return views
