"""Small rigs for the tests of the solver: cameras in a ring, boards carried about, corners projected by OpenCV."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping

import cv2
import numpy as np

from capture_rig.camera import CameraModel, looking_at
from rig_calibration.boards.board import Checkerboard, TargetDetection
from rig_calibration.bundle.solve import RigSolution

BOARD = Checkerboard(6, 5, (0.08, 0.08))
FLOOR_BOARD = Checkerboard(7, 4, (0.2, 0.2))
TARGETS = {"moving": BOARD.corners_board, "floor": FLOOR_BOARD.corners_board}
T_WORLD_FLOOR = np.array([[1, 0, 0, -0.6], [0, 1, 0, 0.3], [0, 0, 1, 0], [0, 0, 0, 1.0]])
SIZE = (640, 480)
ON_FLOOR = ("floor", 0)
"""The reference: the board on the floor."""


def camera_at(name: str, centre: Iterable[float], looking_at_world: Iterable[float] = (0, 0, 0.9)) -> CameraModel:
    """A 640 x 480 camera with a barrel lens, world z up."""
    T = looking_at(np.asarray(list(centre), float), np.asarray(list(looking_at_world), float))
    K = np.array([[600.0, 0, 321.0], [0, 600.6, 237.0], [0, 0, 1]])
    return CameraModel(name, *SIZE, K, "plumb_bob", np.array([-0.2, 0.05, 1e-3, -5e-4, 0.0]), T)


def ring(count: int, radius_m: float = 3.0, height_m: float = 2.3) -> dict[str, CameraModel]:
    angles = 2 * np.pi * np.arange(count) / count
    return {
        f"cam{i + 1:02d}": camera_at(f"cam{i + 1:02d}", (radius_m * np.cos(a), radius_m * np.sin(a), height_m))
        for i, a in enumerate(angles)
    }


def rotation(vector: Iterable[float]) -> np.ndarray:
    return cv2.Rodrigues(np.asarray(list(vector), float))[0]


def carried(rng: np.random.Generator, frames: int) -> dict[int, np.ndarray]:
    """T_world_target (4, 4) of a board held up, by moment."""
    poses = {}
    for frame_index in range(frames):
        azimuth = rng.uniform(0, 2 * np.pi)
        normal = np.array([np.cos(azimuth), np.sin(azimuth), rng.uniform(0, 1.2)])
        normal /= np.linalg.norm(normal)
        x = np.cross([0, 0, 1.0], normal)
        x /= np.linalg.norm(x)
        T = np.eye(4)
        T[:3, :3] = np.column_stack([x, np.cross(normal, x), normal]) @ rotation([0, 0, 0.3 * rng.normal()])
        T[:3, 3] = rng.uniform(-1, 1), rng.uniform(-1, 1), rng.uniform(0.4, 1.7)
        poses[frame_index] = T
    return poses


def project(camera: CameraModel, T_world_target: np.ndarray, points: np.ndarray) -> np.ndarray:
    """(n, 2) pixels by OpenCV; NaN behind the camera, and where the lens model has folded."""
    T = camera.T_camera_world @ T_world_target
    known = np.isfinite(camera.project(points @ T_world_target[:3, :3].T + T_world_target[:3, 3]))
    x = points @ T[:3, :3].T + T[:3, 3]
    pixels, _ = cv2.projectPoints(x.reshape(-1, 1, 3), np.zeros(3), np.zeros(3), camera.K, camera.D)
    return np.where(known & (x[:, 2:] > 0.1), pixels.reshape(-1, 2), np.nan)


def detections_of(
    cameras: Mapping[str, CameraModel],
    poses: Mapping[int, np.ndarray],
    target: str,
    rng: np.random.Generator,
    noise_px: float = 0.2,
    max_tilt_deg: float = 70.0,
    points: np.ndarray | None = None,
) -> list[TargetDetection]:
    """What cameras see of a board of TARGETS (or of ``points``), complete and not too slanting."""
    points = TARGETS[target] if points is None else points
    found = []
    for frame_index, T in poses.items():
        for name, camera in cameras.items():
            ray = camera.centre_world - T[:3, :3] @ points.mean(0) - T[:3, 3]
            slant = ray @ T[:3, 2] / np.linalg.norm(ray)
            pixels, size = project(camera, T, points), (camera.width, camera.height)
            if slant > np.cos(np.radians(max_tilt_deg)) and np.all((pixels > 2) & (pixels < np.array(size) - 3)):
                noisy = pixels + noise_px * rng.normal(size=pixels.shape)
                found.append(
                    TargetDetection(name, frame_index, np.arange(len(points)), noisy, size, target, max(noise_px, 0.01))
                )
    return found


def carried_and_floor(
    cameras: Mapping[str, CameraModel], rng: np.random.Generator, frames: int = 20, noise_px: float = 0.2
) -> list[TargetDetection]:
    """A board carried through the room, and one on the floor that all cameras see."""
    return [
        *detections_of(cameras, carried(rng, frames), "moving", rng, noise_px),
        *detections_of(cameras, {0: T_WORLD_FLOOR}, "floor", rng, noise_px, max_tilt_deg=85),
    ]


def carried_late(
    cameras: Mapping[str, CameraModel],
    poses: Mapping[int, np.ndarray],
    shift_m: Callable[[int], np.ndarray],
    rng: np.random.Generator,
) -> list[TargetDetection]:
    """A carried board before cameras that are not synchronous: each sees it shifted once more than the one before, by
    ``shift_m(moment)`` (3,)."""
    found = []
    for late, (name, camera) in enumerate(cameras.items()):
        moved = {moment: T.copy() for moment, T in poses.items()}
        for moment, T in moved.items():
            T[:3, 3] += late * shift_m(moment)
        found += detections_of({name: camera}, moved, "moving", rng)
    return found


def waved(rng: np.random.Generator, frames: int) -> dict[int, np.ndarray]:
    """T_world_target (4, 4) of a wand that is waved about, by moment."""
    poses = {}
    for frame_index in range(frames):
        T = np.eye(4)
        T[:3, :3], T[:3, 3] = rotation(2 * rng.normal(size=3)), rng.uniform([-1, -1, 0.3], [1, 1, 1.9])
        poses[frame_index] = T
    return poses


def truth(cameras: Mapping[str, CameraModel], reference: str = "floor") -> dict[str, np.ndarray]:
    """T_camera_reference."""
    T = T_WORLD_FLOOR if reference == "floor" else np.linalg.inv(cameras[reference].T_camera_world)
    return {name: camera.T_camera_world @ T for name, camera in cameras.items()}


def seen_from(solution: RigSolution, camera: str) -> dict[str, np.ndarray]:
    """T_camera_reference with one camera as the reference."""
    T = np.linalg.inv(solution.cameras[camera].T_camera_world)
    return {name: found.T_camera_world @ T for name, found in solution.cameras.items()}


def errors(
    solution: RigSolution, T_camera_reference: Mapping[str, np.ndarray], camera: str = ""
) -> dict[str, np.ndarray]:
    """(6,) by camera: rotation vector (rad, camera frame), centre (m, reference frame), found minus true; the reference
    is that of the solution, or a ``camera``."""
    found = {}
    placed = {name: found.T_camera_world for name, found in solution.cameras.items()}
    for name, T in (seen_from(solution, camera) if camera else placed).items():
        true = T_camera_reference[name]
        centre = -T[:3, :3].T @ T[:3, 3] + true[:3, :3].T @ true[:3, 3]
        found[name] = np.concatenate([cv2.Rodrigues(T[:3, :3] @ true[:3, :3].T)[0].ravel(), centre])
    return found


def worst(found: Mapping[str, np.ndarray]) -> tuple[float, float]:
    """The largest error of a centre (mm) and of a rotation (deg)."""
    return (
        max(float(np.linalg.norm(e[3:])) * 1000 for e in found.values()),
        max(float(np.degrees(np.linalg.norm(e[:3]))) for e in found.values()),
    )
