"""The studio's room with a board on the floor and one carried about, for the tests of the extrinsics."""

import bundle_studio as studio
import numpy as np

from capture_rig.camera import CameraModel
from capture_rig.rigid import rotation_vector, transform
from rig_calibration.boards.board import Board, Checkerboard, TargetDetection

FLOOR_BOARD = Checkerboard(7, 4, (0.12, 0.12))
CARRIED_BOARD = Checkerboard(9, 6, (0.08, 0.08))
NOISE_PX = 0.2


def on_floor(board: Board, x: float = 0.0, y: float = 0.0, turn: float = 0.0) -> np.ndarray:
    """T_world_board of a board that lies on the floor, its middle at (x, y), its rows turned from world x."""
    R = studio.rotation([0.0, 0.0, turn])
    return transform(R, [x, y, 0.0] - R @ board.corners_board.mean(axis=0))


def carried_poses(count: int, seed: int = 3) -> list[np.ndarray]:
    return list(studio.carried(np.random.default_rng(seed), count).values())


def see_all(
    cameras: dict[str, CameraModel],
    board: Board,
    poses: list[np.ndarray],
    target: str,
    noise_px: float = NOISE_PX,
    seed: int = 0,
) -> list[TargetDetection]:
    """What all cameras see of a board in successive frames, at up to 85 degrees from its normal."""
    rng, points = np.random.default_rng(seed), board.corners_board
    return studio.detections_of(cameras, dict(enumerate(poses)), target, rng, noise_px, 85.0, points)


def pose_errors(found: CameraModel, truth: CameraModel) -> tuple[float, float]:
    """Distance of the centres, mm, and angle between the orientations, degrees."""
    turn = rotation_vector(found.R_camera_world @ truth.R_camera_world.T)
    return 1e3 * float(np.linalg.norm(found.centre_world - truth.centre_world)), float(np.rad2deg(np.linalg.norm(turn)))
