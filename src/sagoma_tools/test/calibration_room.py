"""Pictures of boards through cameras with lens distortion, for tests of the calibration's commands."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from pathlib import Path

import cv2
import numpy as np

from capture_rig.camera import CameraModel, looking_at
from capture_rig.camera_info_file import save_camera_info
from rig_calibration.boards.board import Board
from virtual_studio.boards import BoardPrint, PosedBoard, print_of
from virtual_studio.rendering.board_camera import BoardCamera
from virtual_studio.rendering.camera import Sensor

SIZE = (640, 480)
SENSOR = Sensor(noise=1.5, flicker=0.0)


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
    return held(board, (0.0, 0.0, 0.0), (0.0, 0.0, turn))


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
def filming(camera: CameraModel) -> BoardCamera:
    return BoardCamera(camera)


@cache
def printed(board: Board) -> BoardPrint:
    return print_of(board)


def picture(camera: CameraModel, board: Board, T_world_board: np.ndarray, seed: int = 0) -> np.ndarray:
    """(H, W) uint8: the board in the studio's room, with a little noise."""
    light = filming(camera).render(PosedBoard(printed(board), T_world_board[None]))
    return SENSOR.expose(light, sum(camera.name.encode()), seed)


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
