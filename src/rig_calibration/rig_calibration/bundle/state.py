"""What the adjustment adjusts, and to what: its unknowns and its observations as arrays."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from capture_rig.camera import CameraModel

from ..boards.board import TargetDetection
from .lens_derivatives import COEFFICIENTS
from .rigid import Array, orthonormal, rotation
from .target_shape import TargetShape
from .view_graph import PoseKey

POSE, LENS = 6, 4 + COEFFICIENTS
Ints = npt.NDArray[np.int64]


@dataclass(frozen=True, eq=False)
class State:
    """The unknowns, in one common frame.

    R_camera (c, 3, 3), centre (c, 3): x_camera = R_camera (x - centre); lens (c, 12): fx fy cx cy k1 k2 p1 p2 k3 k4 k5
    k6; R_pose (m, 3, 3), position (m, 3): x = R_pose scale x_target + position, x_target about the target's centroid;
    scale (k,) of each target.
    """

    R_camera: Array
    centre: Array
    lens: Array
    R_pose: Array
    position: Array
    scale: Array

    def moved(self, shared: Array, poses: Array) -> State:
        """The state after a step: ``shared`` (as laid out by :class:`Layout`), ``poses`` (m, 6) rotation, position.

        Cameras turn about their centre by a rotation vector in their own frame, targets about their centroid by one
        in the common frame.
        """
        cameras = len(self.centre)
        by_camera = shared[: -len(self.scale)].reshape(cameras, -1)
        lens = self.lens + by_camera[:, POSE:] if by_camera.shape[1] > POSE else self.lens
        return State(
            orthonormal(rotation(by_camera[:, :3]) @ self.R_camera),
            self.centre + by_camera[:, 3:POSE],
            lens,
            orthonormal(rotation(poses[:, :3]) @ self.R_pose),
            self.position + poses[:, 3:],
            self.scale + shared[-len(self.scale) :],
        )


@dataclass(frozen=True)
class Layout:
    """Where the shared unknowns lie: for each camera rotation (3), centre (3) and, if asked for, lens (12); then the
    scales of the targets."""

    cameras: int
    targets: int
    with_lens: bool = False

    @property
    def width(self) -> int:
        return POSE + LENS * self.with_lens

    @property
    def size(self) -> int:
        return self.cameras * self.width + self.targets

    def camera(self, index: int) -> slice:
        """Rotation and centre of a camera."""
        return slice(index * self.width, index * self.width + POSE)

    def lens(self, index: int) -> slice:
        return slice(index * self.width + POSE, (index + 1) * self.width)

    def columns(self, camera: Ints, target: Ints) -> Ints:
        """(s, width + 1) the shared unknowns on which each detection depends."""
        return np.column_stack(
            [camera[:, None] * self.width + np.arange(self.width), self.cameras * self.width + target]
        )


@dataclass(frozen=True, eq=False)
class Observations:
    """The corners of all detections, padded to the same number.

    camera, pose, target (s,): rows of the state; points (s, n, 3) on the target; pixels (s, n, 2); weight (s, n):
    1 / standard deviation (1/px), 0 where there is no corner.
    """

    camera: Ints
    pose: Ints
    target: Ints
    points: Array
    pixels: Array
    weight: Array

    def only(self, rows: npt.NDArray) -> Observations:
        """The detections in ``rows``."""
        return Observations(*(getattr(self, name)[rows] for name in self.__dataclass_fields__))

    def weighted(self, factor: Array) -> Observations:
        """The same with weights multiplied by ``factor``, broadcast to (s, n)."""
        return replace(self, weight=self.weight * factor)


def observe(
    detections: Sequence[TargetDetection],
    cameras: Sequence[str],
    keys: Sequence[PoseKey],
    shapes: Mapping[str, TargetShape],
) -> Observations:
    """Detections as observations of the poses ``keys`` by ``cameras``."""
    camera_row = {name: row for row, name in enumerate(cameras)}
    pose_row = {key: row for row, key in enumerate(keys)}
    target_row = {name: row for row, name in enumerate(shapes)}
    count, longest = len(detections), max(map(len, detections), default=0)
    points, pixels, weight = np.zeros((count, longest, 3)), np.zeros((count, longest, 2)), np.zeros((count, longest))
    for row, detection in enumerate(detections):
        n = len(detection)
        points[row, :n] = shapes[detection.target].points[detection.ids]
        pixels[row, :n], weight[row, :n] = detection.pixels, 1 / detection.sigma_px
    return Observations(
        np.array([camera_row[s.camera] for s in detections], np.int64),
        np.array([pose_row[s.target, s.frame_index] for s in detections], np.int64),
        np.array([target_row[s.target] for s in detections], np.int64),
        points,
        pixels,
        weight,
    )


def lens_of(camera: CameraModel) -> Array:
    """(12,) fx fy cx cy and the eight coefficients, those that the model lacks being zero."""
    coefficients = np.zeros(COEFFICIENTS)
    coefficients[: len(camera.D)] = camera.D
    return np.array([camera.K[0, 0], camera.K[1, 1], camera.K[0, 2], camera.K[1, 2], *coefficients])
