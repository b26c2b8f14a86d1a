"""Step 1: where a target may be, by one picture of it alone.

A plane seen by a camera has two poses that fit, mirror images of each other about the line of sight (Collins & Bartoli
2014, "Infinitesimal Plane-based Pose Estimation"); a small or distant board leaves both possible. A target that looks
alike after a turn multiplies them. All are kept until other cameras or frames tell.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import cv2
import numpy as np
import numpy.typing as npt

from capture_rig.camera import CameraModel
from capture_rig.lens import Array
from capture_rig.rigid import rotation_matrix

from ..boards.board import TargetDetection
from .problem import FLAT, LINE, PoseKey, TargetShape

MIN_CORNERS = 4
SAME_POSE = np.deg2rad(0.5)  # two solutions closer than this are one
THIN = 0.02  # corners whose spread across is less than this share of their length lie, in effect, on a line


@dataclass(frozen=True, eq=False)
class DetectionPoses:
    """Poses of a (centred) target in the camera's frame that fit one detection, by falling fit.

    R (h, 3, 3), t (h, 3): x_camera = R x + t; rms_px (h,): distance of the corners, undistorted; symmetry (h,): which
    of the target's hidden turns, 0 being the corners as they were numbered.
    """

    R: Array
    t: Array
    rms_px: Array
    symmetry: npt.NDArray[np.int64]

    @property
    def weight(self) -> Array:
        """(h,) how well each fits beside the best one, 1 to 0."""
        return (self.rms_px.min() / self.rms_px) ** 2


def detection_poses(detection: TargetDetection, camera: CameraModel, shape: TargetShape) -> DetectionPoses | None:
    """Find all poses that one detection allows; None when its corners are too few, or lie on a line, or fit no pose."""
    return poses_of(detection.ids, camera.ideal_points(detection.pixels), camera, shape)


def all_undistorted(detections: Sequence[TargetDetection], cameras: Mapping[str, CameraModel]) -> list[Array]:
    """Undistort the corners of many detections; all of a camera go through its lens at once."""
    found: list[Array] = [np.empty((0, 2))] * len(detections)
    for name, camera in cameras.items():
        rows = [row for row, detection in enumerate(detections) if detection.camera == name]
        corners = camera.ideal_points(np.concatenate([np.empty((0, 2)), *(detections[row].pixels for row in rows)]))
        ends = np.cumsum([len(detections[row]) for row in rows], dtype=np.int64)
        for row, ideal in zip(rows, np.split(corners, ends[:-1]), strict=bool(rows)):
            found[row] = ideal
    return found


def poses_of(
    ids: npt.NDArray[np.int64], ideal: Array, camera: CameraModel, shape: TargetShape
) -> DetectionPoses | None:
    """Find the same from corners without distortion (n, 2)."""
    reached = np.isfinite(ideal).all(axis=1)
    points, ideal = shape.points[ids[reached]], ideal[reached]
    if shape.dimension == LINE or len(points) < MIN_CORNERS:
        return None
    longest, across, out = np.linalg.svd(points - points.mean(0), compute_uv=False)
    if across < THIN * longest:
        return None
    focal_px = float(np.sqrt(camera.K[0, 0] * camera.K[1, 1]))
    found = _planar(points, ideal) if out < FLAT * longest else _spatial(points, ideal)
    refined = [_refine(points, ideal, R, t) for R, t in found]
    scored = [(_rms(points, ideal, R, t) * focal_px, R, t) for R, t in refined if np.all(points @ R[2] + t[2] > 0)]
    distinct = _distinct(sorted(scored, key=lambda one: one[0]))
    if not distinct:
        return None
    rms, R, t = (np.array(column) for column in zip(*distinct, strict=True))
    rotated = [R @ symmetry.R.T for symmetry in shape.symmetries]
    copies = len(rotated)
    return DetectionPoses(
        np.concatenate(rotated),
        np.tile(t, (copies, 1)),
        np.tile(np.maximum(rms, 1e-9), copies),
        np.repeat(np.arange(copies), len(rms)),
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


def _spatial(points: Array, ideal: Array) -> list[tuple[Array, Array]]:
    found, rotations, translations, _ = cv2.solvePnPGeneric(points, ideal, np.eye(3), None, flags=cv2.SOLVEPNP_SQPNP)
    solutions = zip(rotations, translations, strict=True) if found else ()
    return [(rotation_matrix(np.ravel(vector)), np.ravel(translation)) for vector, translation in solutions]


def _refine(points: Array, ideal: Array, R: Array, t: Array) -> tuple[Array, Array]:
    vector, translation = cv2.solvePnPRefineLM(points, ideal, np.eye(3), None, cv2.Rodrigues(R)[0], t.reshape(3, 1))
    return rotation_matrix(np.ravel(vector)), np.ravel(translation)


def _rms(points: Array, ideal: Array, R: Array, t: Array) -> float:
    seen = points @ R.T + t
    return float(np.sqrt(np.mean(np.sum((seen[:, :2] / seen[:, 2:] - ideal) ** 2, axis=1))))


def _distinct(scored: list[tuple[float, Array, Array]]) -> list[tuple[float, Array, Array]]:
    kept: list[tuple[float, Array, Array]] = []
    for one in scored:
        if all(np.trace(one[1].T @ other[1]) < 1 + 2 * np.cos(SAME_POSE) for other in kept):
            kept.append(one)
    return kept


@dataclass(frozen=True, eq=False)
class View:
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
) -> list[View]:
    """Make the views of all detections, in their order."""
    views = []
    for detection, ideal in zip(detections, all_undistorted(detections, cameras), strict=True):
        shape = shapes[detection.target]
        views.append(View(detection, shape, ideal, poses_of(detection.ids, ideal, cameras[detection.camera], shape)))
    return views
