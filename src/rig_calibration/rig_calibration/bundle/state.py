"""The unknowns of the adjustment, the corners that it is adjusted to, and where the one puts the other.

Shared by many corners are the poses of the cameras, their lenses, and the targets' sizes and warp; each target has a
pose of its own at each frame. A lens by itself is a rig of one camera whose pose is held fixed.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from capture_rig.camera import CameraModel
from capture_rig.lens import COEFFICIENTS, Array, derivatives, distort
from capture_rig.rigid import nearest_rotation, rotation_matrix

from ..boards.board import TargetDetection
from .problem import LENS, PoseKey, TargetShape

POSE, WARP = 6, 2
OF_CAMERA, OF_TARGET = POSE + LENS, 1 + WARP  # shared unknowns of each
Ints = npt.NDArray[np.int64]
Bools = npt.NDArray[np.bool_]


@dataclass(frozen=True, eq=False)
class BundleState:
    """The unknowns, in one common frame.

    R_camera (c, 3, 3), centre (c, 3): x_camera = R_camera (x - centre); lens (c, 12): fx fy cx cy k1 k2 p1 p2 k3 k4 k5
    k6, or k1 k2 k3 k4 of those that are ``fisheye`` (c,); R_pose (m, 3, 3), position (m, 3): x = R_pose scale x_target
    + position, x_target about the target's centroid; scale (k,) of each target; board_warp (k, 2): offset of its middle
    along its z, m, by bending along x and along y.
    """

    R_camera: Array
    centre: Array
    lens: Array
    R_pose: Array
    position: Array
    scale: Array
    board_warp: Array
    fisheye: Bools

    @property
    def layout(self) -> Layout:
        return Layout(len(self.centre), len(self.scale))

    def moved(self, shared: Array, poses: Array) -> BundleState:
        """The state after a step: ``shared`` (as laid out by :class:`Layout`), ``poses`` (m, 6) rotation, position.

        Cameras turn about their centre by a rotation vector in their own frame, targets about their centroid by one
        in the common frame.
        """
        layout, cameras = self.layout, len(self.centre)
        by_camera = shared[: cameras * OF_CAMERA].reshape(cameras, OF_CAMERA)
        return BundleState(
            nearest_rotation(rotation_matrix(by_camera[:, :3]) @ self.R_camera),
            self.centre + by_camera[:, 3:POSE],
            self.lens + by_camera[:, POSE:],
            nearest_rotation(rotation_matrix(poses[:, :3]) @ self.R_pose),
            self.position + poses[:, 3:],
            self.scale + shared[layout.scales],
            self.board_warp + shared[layout.warps],
            self.fisheye,
        )


@dataclass(frozen=True)
class Layout:
    """Where the shared unknowns lie: for each camera rotation (3), centre (3) and lens (12); then for each target its
    scale and its warp (2)."""

    cameras: int
    targets: int

    @property
    def size(self) -> int:
        return self.cameras * OF_CAMERA + self.targets * OF_TARGET

    def camera(self, index: int) -> slice:
        """Rotation and centre of a camera."""
        return slice(index * OF_CAMERA, index * OF_CAMERA + POSE)

    def lens(self, index: int) -> slice:
        return slice(index * OF_CAMERA + POSE, (index + 1) * OF_CAMERA)

    @property
    def scales(self) -> Ints:
        """(k,) places of the targets' scales."""
        return self.cameras * OF_CAMERA + OF_TARGET * np.arange(self.targets)

    @property
    def warps(self) -> Ints:
        """(k, 2) places of the targets' warps."""
        return self.scales[:, None] + np.arange(1, OF_TARGET)

    def columns(self, camera: Ints, target: Ints) -> Ints:
        """Return (s, OF_CAMERA + OF_TARGET) the shared unknowns on which each detection depends."""
        of_target = self.scales[target][:, None] + np.arange(OF_TARGET)
        return np.column_stack([camera[:, None] * OF_CAMERA + np.arange(OF_CAMERA), of_target])


@dataclass(frozen=True, eq=False)
class Observations:
    """The corners of all detections, padded to the same number.

    camera, pose, target (s,): rows of the state; points (s, n, 3) on the target; bend (s, n, 2): offset of each corner
    per metre of the middle's; pixels (s, n, 2); weight (s, n): 1 / standard deviation (1/px), 0 where there is no
    corner.
    """

    camera: Ints
    pose: Ints
    target: Ints
    points: Array
    bend: Array
    pixels: Array
    weight: Array

    def only(self, rows: npt.NDArray) -> Observations:
        """Return the detections in ``rows``."""
        return Observations(*(getattr(self, name)[rows] for name in self.__dataclass_fields__))

    def weighted(self, factor: Array) -> Observations:
        """Return the same with weights multiplied by ``factor``, broadcast to (s, n)."""
        return replace(self, weight=self.weight * factor)


def observe(
    detections: Sequence[TargetDetection],
    cameras: Sequence[str],
    keys: Sequence[PoseKey],
    shapes: Mapping[str, TargetShape],
) -> Observations:
    """Arrange detections as observations of the poses ``keys`` by ``cameras``."""
    targets, count, longest = list(shapes), len(detections), max(map(len, detections), default=0)
    pose_row = {key: row for row, key in enumerate(keys)}
    points, weight = np.zeros((count, longest, 3)), np.zeros((count, longest))
    bend, pixels = np.zeros((2, count, longest, 2))
    for row, detection in enumerate(detections):
        n, shape = len(detection), shapes[detection.target]
        points[row, :n], bend[row, :n] = shape.points[detection.ids], shape.bend[detection.ids]
        pixels[row, :n], weight[row, :n] = detection.pixels, 1 / detection.sigma_px
    camera = np.array([cameras.index(s.camera) for s in detections], np.int64)
    pose = np.array([pose_row[s.target, s.frame_index] for s in detections], np.int64)
    target = np.array([targets.index(s.target) for s in detections], np.int64)
    return Observations(camera, pose, target, points, bend, pixels, weight)


def lens_of(camera: CameraModel) -> Array:
    """Return (12,) fx fy cx cy and the eight coefficients, those that the model lacks being zero."""
    return np.pad([camera.K[0, 0], camera.K[1, 1], camera.K[0, 2], camera.K[1, 2], *camera.D], (0, 8 - len(camera.D)))


def camera_with(camera: CameraModel, lens: Array, T_camera_world: Array) -> CameraModel:
    """Make the camera with another lens (12,) and pose."""
    K = np.array([[lens[0], 0, lens[2]], [0, lens[1], lens[3]], [0, 0, 1]])
    return replace(camera, K=K, D=lens[4 : 4 + len(camera.D)], T_camera_world=T_camera_world)


# --- Where the state puts the corners, lens distortion included, and how that changes with the state.


@dataclass(frozen=True, eq=False)
class LinearisedRows:
    """residual (s, 2n) seen minus predicted, over its standard deviation; derivatives of the prediction, likewise:
    by_shared (s, 2n, OF_CAMERA + OF_TARGET), as :meth:`Layout.columns` has them, and by_pose (s, 2n, 6)."""

    residual: Array
    by_shared: Array
    by_pose: Array


def residuals_px(state: BundleState, seen: Observations) -> Array:
    """Compute (s, n, 2) seen minus predicted pixels; infinite for a corner behind its camera."""
    x = _in_camera(state, seen, _arm(state, seen))
    lens = state.lens[seen.camera][:, None]
    with np.errstate(all="ignore"):
        (distorted,) = _by_model(lambda *of: [distort(*of)], x[..., :2] / x[..., 2:], state, seen)
        predicted = distorted * lens[..., :2] + lens[..., 2:4]
    return np.where(x[..., 2:] > 0, seen.pixels - predicted, np.inf)


def linearise(state: BundleState, seen: Observations) -> LinearisedRows:
    """Compute the residuals and their analytic derivatives, at a state in which all corners lie in front of their
    cameras.

    x_camera = R_camera (x - centre),  x = arm + position,  arm = scale R_pose (x_target + bend warp e_z); with q a row
    of d(pixel)/d(x):  by the camera's rotation x_camera x (row by x_camera), by its centre -q, by the target's rotation
    arm x q, by its position q, by its scale q.arm / scale, by its warp q.(scale R_pose e_z) bend.
    """
    arm = _arm(state, seen)
    x = _in_camera(state, seen, arm)
    lens, scale = state.lens[seen.camera][:, None], state.scale[seen.target][:, None, None]
    ideal = x[..., :2] / x[..., 2:]
    distorted, by_ideal, by_coefficients = _by_model(derivatives, ideal, state, seen)
    residual = np.where(x[..., 2:] > 0, seen.pixels - distorted * lens[..., :2] - lens[..., 2:4], np.inf)
    by_ideal = by_ideal * lens[..., :2, None]
    by_x = np.concatenate([by_ideal, -(by_ideal @ ideal[..., None])], axis=-1) / x[..., 2, None, None]  # x_camera
    q = by_x @ state.R_camera[seen.camera][:, None]
    focal, normal = distorted[..., None] * np.eye(2), scale * state.R_pose[seen.pose][:, None, :, 2]
    of_camera = [np.cross(x[:, :, None], by_x), -q]
    of_lens = [focal, np.broadcast_to(np.eye(2), focal.shape), by_coefficients * lens[..., :2, None]]
    of_target = [(q @ arm[..., None]) / scale[..., None], (q @ normal[..., None]) * seen.bend[:, :, None]]
    weight = seen.weight[..., None]
    rows = lambda a: (a * weight[..., None]).reshape(len(a), 2 * a.shape[1], -1)  # noqa: E731
    by_pose = np.concatenate([np.cross(arm[:, :, None], q), q], axis=-1)
    return LinearisedRows(
        (residual * weight).reshape(len(x), -1),
        rows(np.concatenate(of_camera + of_lens + of_target, axis=-1)),
        rows(by_pose),
    )


def _by_model(
    of_lens: Callable[..., Sequence[Array]], ideal: Array, state: BundleState, seen: Observations
) -> list[Array]:
    """Apply a function of ideal points (s, n, 2) and coefficients to each detection by its lens model."""
    fisheye, D = state.fisheye[seen.camera], state.lens[seen.camera][:, None, 4:]
    if not fisheye.any():
        return list(of_lens(ideal, D))
    with np.errstate(all="ignore"):  # each model also has the other's coefficients
        results = zip(of_lens(ideal, D), of_lens(ideal, D[..., : COEFFICIENTS["equidistant"]]), strict=True)
    return [np.where(fisheye.reshape(-1, *[1] * (of.ndim - 1)), its, of) for of, its in results]


def _arm(state: BundleState, seen: Observations) -> Array:
    """Return (s, n, 3) from the target's centroid to its corners, common frame."""
    points = seen.points.copy()
    points[..., 2] += (seen.bend @ state.board_warp[seen.target][:, :, None])[..., 0]
    scaled = state.R_pose[seen.pose] * state.scale[seen.target][:, None, None]
    return points @ np.swapaxes(scaled, 1, 2)


def _in_camera(state: BundleState, seen: Observations, arm: Array) -> Array:
    x = arm + (state.position[seen.pose] - state.centre[seen.camera])[:, None]
    return x @ np.swapaxes(state.R_camera[seen.camera], 1, 2)
