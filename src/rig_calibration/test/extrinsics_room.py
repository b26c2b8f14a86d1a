"""A room for tests: cameras on a circle, a board on the floor, a board carried about."""

import numpy as np
from bundle_studio import camera_at, rotation

from capture_rig.camera import CameraModel
from capture_rig.rigid import rotation_vector, transform
from rig_calibration.boards.board import Board, Checkerboard, TargetDetection

FLOOR_BOARD = Checkerboard(7, 4, (0.12, 0.12))
CARRIED_BOARD = Checkerboard(9, 6, (0.08, 0.08))
NOISE_PX = 0.2


def circle(count: int, radius_m: float = 3.0) -> dict[str, CameraModel]:
    """Cameras around the origin, 1.4 to 2.2 m high, none facing another."""
    cameras = {}
    for index in range(count):
        azimuth = 2 * np.pi * (index + 0.15 * (index % 2)) / count + 0.3
        place = np.array([radius_m * np.cos(azimuth), radius_m * np.sin(azimuth), 1.4 + 0.8 * (index % 3) / 2])
        cameras[f"cam{index + 1:02d}"] = camera_at(f"cam{index + 1:02d}", place, np.array([0.0, 0.0, 0.8]))
    return cameras


def on_floor(board: Board, x: float = 0.0, y: float = 0.0, turn: float = 0.0) -> np.ndarray:
    """T_world_board of a board that lies on the floor, its middle at (x, y), its rows turned from world x."""
    R = rotation([0.0, 0.0, turn])
    return transform(R, [x, y, 0.0] - R @ board.corners_board.mean(axis=0))


def carried_poses(count: int, seed: int = 3) -> list[np.ndarray]:
    """T_world_board all over the volume, leaning every way, 0.5 to 1.7 m high."""
    rng = np.random.default_rng(seed)
    poses = []
    for _ in range(count):
        facing, lean = rng.uniform(0, 2 * np.pi), rng.normal(0.0, 0.35, 3)
        R = rotation(lean) @ rotation([0.0, 0.0, facing]) @ rotation([np.pi / 2, 0.0, 0.0])
        poses.append(transform(R, np.array([*rng.uniform(-0.9, 0.9, 2), rng.uniform(0.5, 1.7)])))
    return poses


def see(
    camera: CameraModel,
    board: Board,
    T_world_board: np.ndarray,
    target: str,
    frame_index: int,
    noise_px: float = NOISE_PX,
) -> TargetDetection | None:
    """What the camera sees of the board; None where its back or a part beyond the image is seen."""
    T, size = camera.T_camera_world @ T_world_board, (camera.width, camera.height)
    pixels = camera.project(board.corners_board @ T_world_board[:3, :3].T + T_world_board[:3, 3])
    if T[:3, 2] @ T[:3, 3] >= 0 or not ((pixels > 3) & (pixels < np.array(size) - 4)).all():  # NaN, too
        return None
    seed = [frame_index, sum(camera.name.encode()), sum(target.encode())]
    pixels = pixels + noise_px * np.random.default_rng(seed).standard_normal(pixels.shape)
    return TargetDetection(camera.name, frame_index, np.arange(len(pixels)), pixels, size, target, noise_px)


def see_all(
    cameras: dict[str, CameraModel], board: Board, poses: list[np.ndarray], target: str, noise_px: float = NOISE_PX
) -> list[TargetDetection]:
    """What all cameras see of a board in successive frames."""
    seen = [see(c, board, T, target, m, noise_px) for m, T in enumerate(poses) for c in cameras.values()]
    return [detection for detection in seen if detection is not None]


def pose_errors(found: CameraModel, truth: CameraModel) -> tuple[float, float]:
    """Distance of the centres, mm, and angle between the orientations, degrees."""
    turn = rotation_vector(found.R_camera_world @ truth.R_camera_world.T)
    return 1e3 * float(np.linalg.norm(found.centre_world - truth.centre_world)), float(np.rad2deg(np.linalg.norm(turn)))
