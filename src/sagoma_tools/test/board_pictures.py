"""Pictures of a board through a pinhole: the printed board warped by its homography, then noise. Cheap, and no code of
the calibration is in it."""

from __future__ import annotations

from functools import lru_cache

import cv2
import numpy as np

from rig_calibration.boards.board import Board, Checkerboard
from rig_calibration.boards.drawing import BoardPicture, draw_board

BOARD = Checkerboard(9, 6, (0.025, 0.025))
BOARD_TEXT = "checkerboard 9x6 25mm"
FOCAL_PX, CENTRE_PX, SIZE = 470.0, (322.0, 236.5), (640, 480)
FINE = 2
# place of the board's middle in the picture (of its width and height), lean about its x and y, distance m
STATIONS = [
    (0.5, 0.5, 35, 0, 0.32),
    (0.5, 0.5, -35, 0, 0.32),
    (0.5, 0.5, 0, 35, 0.32),
    (0.5, 0.5, 0, -35, 0.32),
    (0.25, 0.27, 25, 25, 0.42),
    (0.75, 0.27, 25, -25, 0.42),
    (0.25, 0.73, -25, 25, 0.42),
    (0.75, 0.73, -25, -25, 0.42),
    (0.5, 0.5, 0, 0, 0.3),
    (0.2, 0.5, 20, 30, 0.5),
    (0.8, 0.5, -20, -30, 0.5),
    (0.5, 0.25, 40, 10, 0.55),
    (0.5, 0.75, -40, -10, 0.55),
    (0.35, 0.4, 30, -30, 0.6),
]


@lru_cache(maxsize=2)
def printed(board: Board) -> tuple[BoardPicture, np.ndarray]:
    """A board's drawing, sharp and as print blurs it."""
    drawn = draw_board(board, 3000.0)
    return drawn, cv2.GaussianBlur(drawn.image, (0, 0), 3.0)


def picture(station: tuple[float, ...], *, board: Board = BOARD, noise: float = 2.0, seed: int = 0) -> np.ndarray:
    """(480, 640) uint8."""
    K = np.array([[FOCAL_PX, 0, CENTRE_PX[0]], [0, FOCAL_PX, CENTRE_PX[1]], [0, 0, 1]])
    across, down, lean_x, lean_y, distance = station
    R = cv2.Rodrigues(np.deg2rad([lean_x, lean_y, 0.0]))[0] @ np.diag([1.0, -1.0, -1.0])
    middle = np.linalg.inv(K) @ [across * SIZE[0], down * SIZE[1], 1.0] * distance
    t = middle - R @ board.corners_board.mean(axis=0)
    drawn, blurred = printed(board)
    H = K @ np.column_stack([R[:, 0], R[:, 1], t]) @ np.linalg.inv(drawn.T_pixel_board)
    finer = np.array([[FINE, 0, (FINE - 1) / 2], [0, FINE, (FINE - 1) / 2], [0, 0, 1.0]])
    large = cv2.warpPerspective(
        blurred,
        finer @ H,
        (SIZE[0] * FINE, SIZE[1] * FINE),
        flags=cv2.INTER_LINEAR,
        borderMode=cv2.BORDER_CONSTANT,
        borderValue=110.0,
    )
    light = 20 + 0.8 * cv2.resize(large, SIZE, interpolation=cv2.INTER_AREA).astype(float)
    light += np.random.default_rng(seed).normal(0, noise, light.shape)
    return np.rint(light).clip(0, 255).astype(np.uint8)


def pictures(board: Board = BOARD) -> list[np.ndarray]:
    """One of every station."""
    return [picture(station, board=board, seed=seed) for seed, station in enumerate(STATIONS)]
