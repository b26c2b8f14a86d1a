"""Images of boards through a known camera, as an independent oracle: every pixel is the mean of rays traced to the
board's plane, then optics, then noise. No projection code of the product is used to place the board's fields."""

from __future__ import annotations

from typing import NamedTuple

import cv2
import numpy as np

from capture_rig.camera import CameraModel
from rig_calibration.boards.board import CharucoBoard, opencv_board
from rig_calibration.boards.drawing import outer_fields

TEXELS = 140  # a side of a field of a ChArUco board
GREY_BLACK, GREY_WHITE, GREY_ROOM = 30.0, 210.0, 120.0


def camera(width=640, height=480, focal=600.0, D=(0.0, 0.0, 0.0, 0.0, 0.0)) -> CameraModel:
    K = np.array([[focal, 0, width / 2 - 0.3], [0, focal, height / 2 + 0.4], [0, 0, 1.0]])
    return CameraModel("cam", width, height, K, "plumb_bob", np.array(D, float), np.eye(4))


def looking_at_board(board, distance, tilt_deg, roll_deg=0.0, turn_deg=0.0, offset=(0.0, 0.0)):
    """T_camera_board: board's middle on the axis (moved by ``offset`` metres), tilted about its x axis away from head
    on, turned in its own plane by turn_deg; the camera rolled by roll_deg."""
    middle = board.corners_board.mean(axis=0)
    spin = _rotation([0, 0, np.deg2rad(turn_deg)])
    facing = np.diag([1.0, -1.0, -1.0])  # head on: board x right, y up, z towards the camera
    R = _rotation([0, 0, np.deg2rad(roll_deg)]) @ _rotation([-np.deg2rad(tilt_deg), 0, 0]) @ facing @ spin
    T = np.eye(4)
    T[:3, :3] = R
    T[:3, 3] = [*offset, distance] - R @ middle
    return T


def true_corners(eye: CameraModel, board, T_camera_board):
    points = board.corners_board @ T_camera_board[:3, :3].T + T_camera_board[:3, 3]
    pixels, _ = cv2.projectPoints(points, np.zeros(3), np.zeros(3), eye.K, eye.D)
    return pixels.reshape(-1, 2)


class Optics(NamedTuple):
    """What blurs and disturbs a picture: blur (px), noise (grey levels), motion while the shutter is open (px), and the
    relative change of light across the picture."""

    blur: float = 0.5
    noise: float = 2.0
    shutter_px: tuple[float, float] = (0.0, 0.0)
    shade: float = 0.0


def render(eye: CameraModel, board, T_camera_board, *, seed=0, oversample=6, rim=1.0, **optics):
    """Render a board, (H, W) uint8. ``rim``: white around the fields, in fields; ``optics``: fields of `Optics`."""
    blur, noise, shutter_px, shade = Optics(**optics)
    low, high = _box(eye, board, T_camera_board)
    light = np.full((eye.height, eye.width), GREY_ROOM)
    for top in range(low[1], high[1], 16):
        rows = min(16, high[1] - top)
        corners = np.meshgrid(np.arange(low[0], high[0] + 1) - 0.5, np.arange(top, top + rows + 1) - 0.5)
        ideal = cv2.undistortPoints(np.stack(corners, -1).reshape(-1, 1, 2), eye.K, eye.D)
        rays = _between(_between(ideal.reshape(rows + 1, -1, 2), oversample, 0), oversample, 1)
        grey = _grey_on_board(board, T_camera_board, rays.reshape(-1, 2), rim).reshape(rows, oversample, -1, oversample)
        light[top : top + rows, low[0] : high[0]] = grey.mean(axis=(1, 3))
    if blur > 0:
        light = cv2.GaussianBlur(light, (0, 0), blur)
    light = _smeared(light, shutter_px)
    light *= 1 + shade * (np.arange(eye.width) / eye.width - 0.5)
    light += np.random.default_rng(seed).normal(0, noise, light.shape)
    return np.rint(light).clip(0, 255).astype(np.uint8)


def _smeared(light, shutter_px):
    length = float(np.hypot(*shutter_px))
    if length == 0:
        return light
    count = int(np.ceil(8 * length))
    total = np.zeros_like(light)
    for s in (np.arange(count) + 0.5) / count - 0.5:
        M = np.array([[1, 0, s * shutter_px[0]], [0, 1, s * shutter_px[1]]])
        total += cv2.warpAffine(light, M, light.shape[::-1], flags=cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    return total / count


def _box(eye, board, T):
    columns, rows, width, height = outer_fields(board)
    x, y = np.meshgrid(np.linspace(-2, columns + 1, 40) * width, np.linspace(2, -rows - 1, 40) * height)
    points = np.column_stack([x.ravel(), y.ravel(), np.zeros(x.size)]) @ T[:3, :3].T + T[:3, 3]
    points = points[points[:, 2] > 0.05]
    pixels = cv2.projectPoints(points, np.zeros(3), np.zeros(3), eye.K, eye.D)[0].reshape(-1, 2)
    low = np.floor(np.maximum(pixels.min(0) - 2, 0)).astype(int)
    high = np.ceil(np.minimum(pixels.max(0) + 3, [eye.width, eye.height])).astype(int)
    return low, high


def _between(corners, count, axis):
    """Ideal points in ``count`` rows or columns a pixel, by linear interpolation: lenses bend by 1e-4 px within one."""
    share = (np.arange(count) + 0.5) / count
    first, last = np.split(corners, [1], axis)[1], np.split(corners, [-1], axis)[0]
    fine = np.stack([last + s * (first - last) for s in share], axis + 1)
    return fine.reshape(*fine.shape[:axis], -1, *fine.shape[axis + 2 :])


def _grey_on_board(board, T, ideal, rim):
    rays = np.column_stack([ideal, np.ones(len(ideal))]) @ T[:3, :3]
    origin = -T[:3, :3].T @ T[:3, 3]
    with np.errstate(all="ignore"):
        at = origin[2] / -rays[:, 2]
    columns, rows, width, height = outer_fields(board)
    across = (origin[0] + at * rays[:, 0]) / width + 1
    down = -(origin[1] + at * rays[:, 1]) / height + 1
    grey = np.full(len(rays), GREY_ROOM)
    on_paper = (at > 0) & (across > -rim) & (across < columns + rim) & (down > -rim) & (down < rows + rim)
    grey[on_paper] = GREY_WHITE
    on_fields = on_paper & (across >= 0) & (across < columns) & (down >= 0) & (down < rows)
    grey[on_fields] = _print(board, across[on_fields], down[on_fields])
    return grey


def _print(board, across, down):
    """Grey at places on the fields; ChArUco as OpenCV draws it, checkerboards with a black field up-left."""
    if isinstance(board, CharucoBoard):
        size = (board.columns * TEXELS, board.rows * TEXELS)
        texture = opencv_board(board).generateImage(size, marginSize=0, borderBits=1)
        black = texture[(down * TEXELS).astype(int), (across * TEXELS).astype(int)] < 128
    else:
        black = (np.floor(across) + np.floor(down)) % 2 == 0
    return np.where(black, GREY_BLACK, GREY_WHITE)


def _rotation(vector):
    return cv2.Rodrigues(np.asarray(vector, float))[0]
