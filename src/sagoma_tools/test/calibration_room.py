"""Pictures of boards through cameras with lens distortion, for tests of the calibration's commands: every pixel looks
through the lens at the board's plane."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from pathlib import Path

import cv2
import numpy as np
from scipy.ndimage import map_coordinates

from capture_rig.camera import CameraModel, looking_at
from capture_rig.camera_info_file import save_camera_info
from rig_calibration.boards.board import Board
from rig_calibration.boards.drawing import draw_board

SIZE = (640, 480)
TEXELS_PER_M = 1000.0
FINER = 2
COARSE_PX = 16
FLOOR_GREY, NOISE_GREY = 95.0, 1.5


def camera_at(name: str, place: tuple[float, float, float], look_at: tuple[float, float, float]) -> CameraModel:
    """A level camera at a place, looking at another."""
    T = looking_at(np.array(place), np.array(look_at))
    K = np.array([[520.0, 0.0, 318.0], [0.0, 521.0, 241.0], [0.0, 0.0, 1.0]])
    return CameraModel(name, *SIZE, K, "plumb_bob", np.array([-0.15, 0.05, 3e-4, -2e-4, 0.0]), T)


@cache
def three_cameras() -> dict[str, CameraModel]:
    """Around the origin, 1.6 to 2.2 m high, 2.5 m away."""
    places = {"cam01": (2.4, 0.4, 1.6), "cam02": (-1.0, 2.3, 2.2), "cam03": (-1.3, -2.1, 1.9)}
    return {name: camera_at(name, place, (0.0, 0.0, 0.3)) for name, place in places.items()}


def on_floor(board: Board, turn: float = 0.0) -> np.ndarray:
    """T_world_board of a board whose middle lies at the origin."""
    T = np.eye(4)
    T[:3, :3] = cv2.Rodrigues(np.array([0.0, 0.0, turn]))[0]
    T[:3, 3] = -T[:3, :3] @ board.corners_board.mean(axis=0)
    return T


def held(board: Board, place: tuple[float, float, float], lean: tuple[float, float, float]) -> np.ndarray:
    """T_world_board of a board whose middle is at a place, lying flat but for a rotation vector."""
    T = np.eye(4)
    T[:3, :3] = cv2.Rodrigues(np.array(lean))[0]
    T[:3, 3] = place - T[:3, :3] @ board.corners_board.mean(axis=0)
    return T


def at_the_origin(name: str) -> CameraModel:
    """The same camera in the world's own axes: z forward, y down."""
    return replace(camera_at(name, (1.0, 0.0, 1.0), (0.0, 0.0, 1.0)), T_camera_world=np.eye(4))


def before(
    camera: CameraModel, board: Board, across: float, down: float, lean_x: float, lean_y: float, distance: float
) -> np.ndarray:
    """T_camera_board: its middle so far across and down the picture (shares), leaning (degrees), so far away (m)."""
    T = np.eye(4)
    T[:3, :3] = cv2.Rodrigues(np.deg2rad([lean_x, lean_y, 0.0]))[0] @ np.diag([1.0, -1.0, -1.0])
    middle = distance * np.linalg.solve(camera.K, [across * camera.width, down * camera.height, 1.0])
    T[:3, 3] = middle - T[:3, :3] @ board.corners_board.mean(axis=0)
    return T


@cache
def ideal_places(camera: CameraModel) -> np.ndarray:
    """(h, w, 2) where the parts of pixels look, without distortion: a smooth surface through some of them."""
    ticks = [np.arange(-COARSE_PX, size + 2 * COARSE_PX, COARSE_PX) for size in SIZE]
    grid = np.stack(np.meshgrid(*ticks), axis=-1).reshape(-1, 2).astype(float)
    rays = camera.rays_world(grid) @ camera.R_camera_world.T
    coarse = (rays[:, :2] / rays[:, 2:]).reshape(len(ticks[1]), len(ticks[0]), 2)
    u, v = (((np.arange(size * FINER) + 0.5) / FINER - 0.5) / COARSE_PX + 1.0 for size in SIZE)
    places = np.meshgrid(v, u, indexing="ij")
    return np.stack([map_coordinates(coarse[..., axis], places, order=3) for axis in (0, 1)], axis=-1)


@cache
def texture_of(board: Board) -> tuple[np.ndarray, np.ndarray]:
    """The print as grey levels (r, c), and (3, 3) from the board's x, y, 1 to its column, row, 1."""
    texture, T_texel_board = draw_board(board, TEXELS_PER_M)
    return 25.0 + 0.75 * cv2.GaussianBlur(texture, (0, 0), 1.0).astype(np.float32), np.asarray(T_texel_board)


def picture(camera: CameraModel, board: Board, T_world_board: np.ndarray, seed: int = 0) -> np.ndarray:
    """(H, W) uint8: the board before an even ground, with a little noise."""
    texture, T_texel_board = texture_of(board)
    T = camera.T_camera_world @ T_world_board
    T_texel_ideal = T_texel_board @ np.linalg.inv(T[:3, [0, 1, 3]])
    texels = cv2.perspectiveTransform(ideal_places(camera), T_texel_ideal).astype(np.float32)
    light = cv2.remap(texture, texels, None, cv2.INTER_LINEAR, borderValue=FLOOR_GREY)
    light = light.reshape(SIZE[1], FINER, SIZE[0], FINER).mean(axis=(1, 3))
    noise = NOISE_GREY * np.random.default_rng([seed, *camera.name.encode()]).standard_normal(light.shape)
    return np.clip(np.rint(light + noise), 0, 255).astype(np.uint8)


def corner_pixels(camera: CameraModel, board: Board, T_world_board: np.ndarray) -> np.ndarray:
    """(n, 2) where the board's corners are seen."""
    return camera.project(board.corners_board @ T_world_board[:3, :3].T + T_world_board[:3, 3])


def outer_pixels(camera: CameraModel, board: Board, T_world_board: np.ndarray, columns: int) -> np.ndarray:
    """(4, 2) the outermost ones in reading order: the first row's two ends, the last row's last and first."""
    corners = corner_pixels(camera, board, T_world_board)
    return corners[[0, columns - 1, len(corners) - 1, len(corners) - columns]]


def write_pictures(folder: Path, pictures: dict[str, list[np.ndarray]]) -> Path:
    """NAME.png for a camera with one picture, NAME/000.png ... for one with several."""
    folder.mkdir(parents=True, exist_ok=True)
    for name, images in pictures.items():
        if len(images) == 1:
            cv2.imwrite(str(folder / f"{name}.png"), images[0])
            continue
        (folder / name).mkdir()
        for index, image in enumerate(images):
            cv2.imwrite(str(folder / name / f"{index:03d}.png"), image)
    return folder


def write_intrinsics(folder: Path, cameras: dict[str, CameraModel]) -> Path:
    """NAME.yaml a camera."""
    folder.mkdir(parents=True, exist_ok=True)
    for name, camera in cameras.items():
        save_camera_info(folder / f"{name}.yaml", camera)
    return folder
