"""One camera of the studio that looks at boards: its lens, its focus, its exposure."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import cv2
import numpy as np
from numpy.typing import NDArray

from capture_rig.camera import CameraModel

from ..people import Capsules
from ..scene.boards import BACK, BLACK, DIMMED, GLOW, WHITE, BoardPrint, Wand, ball_box, cast_ball
from ..scene.handling import Path
from ..scene.room import look
from .board_caster import Array, cast_board, sample_places
from .camera import LIGHT_WORLD, Sensor, part_boxes
from .capsules import cast

Light = NDArray[np.float32]

SAMPLES = 48
LENS_BLUR_PX = 0.6
"""Standard deviation of a point's picture in a lens that is in focus."""
OUTLINE_POINTS = 16
BOX_MARGIN_PX = 2
NEAR_M = 0.02


@dataclass(frozen=True, eq=False)
class PosedBoard:
    """A board somewhere: ``T_world_board`` (K, 4, 4), one pose for each moment of the exposure (1: it is still)."""

    print: BoardPrint
    T_world_board: Array

    @property
    def middle(self) -> Array:
        """(4, 4) the pose in the middle of the exposure."""
        return self.T_world_board[len(self.T_world_board) // 2]

    @property
    def corners_world(self) -> Array:
        """(n, 3) the inner corners, m, in the middle of the exposure."""
        return self.print.board.corners_board @ self.middle[:3, :3].T + self.middle[:3, 3]


class BoardCamera:
    """Pictures of the room with boards, and perhaps somebody who holds them, through a camera's own lens."""

    def __init__(self, camera: CameraModel) -> None:
        self.camera = camera
        view = look(camera)
        self._rays, self._room, self._ideal = view.rays, view.grey, _ideal_corners(camera)

    def empty_room(self) -> Light:
        """Light (h, w), 0..1, without anybody."""
        return self._room

    def render(
        self,
        boards: Sequence[PosedBoard] = (),
        people: Capsules | None = None,
        blur_px: float = LENS_BLUR_PX,
        samples: int = SAMPLES,
    ) -> Light:
        """Light (h, w), 0..1, of boards, farthest first, and of people, blurred by the lens (standard deviation, px).

        samples : places looked at in a pixel on an edge; few are fast, many are exact.
        """
        light, depth = self._with_people(people)
        for board in sorted(boards, key=self._distance, reverse=True):
            self._draw(board, depth, light, samples)
        return self._focused(light, blur_px)

    def see_wand(self, wand: Wand, T_world_wand: Array, blur_px: float = LENS_BLUR_PX) -> Light:
        """Light (h, w) of a wand of glowing balls in the dimmed room; nobody holds it."""
        stick = wand.stick(T_world_wand)
        light = DIMMED * self._with_people(stick)[0]
        places = sample_places(SAMPLES)
        for ball in wand.balls_world(T_world_wand):
            centre = self.camera.R_camera_world @ ball + self.camera.t_camera_world
            reach_px = 1.5 * self.camera.K[0, 0] * wand.radius_m / max(centre[2], NEAR_M)
            box = ball_box(self.camera.project(ball), reach_px, self.camera.width, self.camera.height)
            cast_ball(self._ideal, centre, wand.radius_m, GLOW, places, box, light)
        return self._focused(light, blur_px)

    def _with_people(self, people: Capsules | None) -> tuple[Light, Light]:
        """Light, and distance along the ray, m, of the room with somebody or something in it."""
        light = self._room.copy()
        depth = np.full(light.shape, np.inf, np.float32)
        if people is not None:
            cast(
                self.camera.centre_world,
                self._rays,
                people.starts,
                people.ends,
                people.radii,
                part_boxes(self.camera, people),
                LIGHT_WORLD,
                people.albedo,
                depth,
                light,
                np.zeros(light.shape, np.uint8),
            )
        return light, depth

    def _focused(self, light: Light, blur_px: float) -> Light:
        if blur_px > 0:
            cv2.GaussianBlur(light, (0, 0), blur_px, dst=light, borderType=cv2.BORDER_REPLICATE)
        return light

    def _draw(self, board: PosedBoard, depth: Light, light: Light, samples: int) -> None:
        box = self._box(board)
        if (box[2:] <= box[:2]).any():
            return
        T_camera_board = self.camera.T_camera_world @ board.T_world_board
        homographies = np.array([_homography(T, board.print) for T in T_camera_board])
        greys = np.array([self._greys(T) for T in board.T_world_board])
        places = sample_places(samples)
        cast_board(self._ideal, homographies, greys, board.print.texture, board.print.clear, places, box, depth, light)

    def _greys(self, T_world_board: Array) -> Array:
        """(2,) light from black and white; from both the same, of the sheet, where its back is seen."""
        towards = self.camera.centre_world - T_world_board[:3, 3]
        in_front = float(T_world_board[:3, 2] @ towards) > 0.0
        normal = T_world_board[:3, 2] if in_front else -T_world_board[:3, 2]
        lamp = 0.50 + 0.20 * normal[2] + 0.45 * max(float(normal @ LIGHT_WORLD), 0.0)  # as bodies are lit
        return lamp * np.array([BLACK, WHITE] if in_front else [BACK, BACK])

    def _box(self, board: PosedBoard) -> NDArray[np.int64]:
        """Pixels x0, y0, x1, y1 (end excluded) that the sheet may cover at any moment of the exposure."""
        size = np.array([self.camera.width, self.camera.height])
        outline = _outline(board.print.sheet_board)
        points = np.concatenate([outline @ T[:3, :3].T + T[:3, 3] for T in board.T_world_board])
        depth = points @ self.camera.R_camera_world[2] + self.camera.t_camera_world[2]
        if depth.max() < NEAR_M:
            return np.zeros(4, np.int64)
        pixels = self.camera.project(points)
        if depth.min() < NEAR_M or np.isnan(pixels).any():  # around the camera, or beyond its lens
            return np.array([0, 0, *size], np.int64)
        low, high = pixels.min(0) - BOX_MARGIN_PX, pixels.max(0) + BOX_MARGIN_PX + 1
        return np.concatenate([np.clip(np.floor(low), 0, size), np.clip(np.ceil(high), 0, size)]).astype(np.int64)

    def _distance(self, board: PosedBoard) -> float:
        middle = board.middle[:3, :3] @ board.print.middle_board + board.middle[:3, 3]
        return float(np.linalg.norm(middle - self.camera.centre_world))


def _ideal_corners(camera: CameraModel) -> Array:
    """(h + 1, w + 1, 2) normalised undistorted coordinates of the pixels' corners; NaN beyond the lens model."""
    y, x = np.mgrid[: camera.height + 1, : camera.width + 1] - 0.5
    rays = camera.rays_world(np.column_stack([x.ravel(), y.ravel()])) @ camera.R_camera_world.T
    return np.ascontiguousarray((rays[:, :2] / rays[:, 2:]).reshape(camera.height + 1, camera.width + 1, 2))


def _homography(T_camera_board: Array, board: BoardPrint) -> Array:
    """(3, 3) from normalised image coordinates [x, y, 1] to texels; scaled so that its last row gives 1 / depth."""
    board_image = np.linalg.inv(T_camera_board[:3, [0, 1, 3]])
    return board.texels_board @ board_image


def _outline(sheet: Array) -> Array:
    """(4 * OUTLINE_POINTS, 3) points around the sheet: a lens bends its edges."""
    ring, share = sheet[[0, 1, 3, 2, 0]], np.linspace(0.0, 1.0, OUTLINE_POINTS, endpoint=False)[:, None]
    return np.concatenate([a + share * (b - a) for a, b in pairwise(ring)])


# --- Takes pictures of what moves: the exposure lasts, the sensor is noisy.

Image = NDArray[np.uint8]

STILL_PX = 0.1
"""Nothing is drawn blurred by motion that moves less than this while the shutter is open."""
MOST_MOMENTS = 9


@dataclass(frozen=True)
class Optics:
    """How pictures are taken. blur_px: of a lens in focus, standard deviation; exposure_s: the shutter's time."""

    sensor: Sensor
    blur_px: float = LENS_BLUR_PX
    exposure_s: float = 0.008


class FilmingCamera:
    """Takes one camera's pictures; ``number`` and the frame's number determine the noise."""

    def __init__(self, camera: CameraModel, number: int, optics: Optics) -> None:
        self.camera, self._number, self._optics = camera, number, optics
        self.eye = BoardCamera(camera)

    def take(self, frame: int, board: BoardPrint, path: Path, t: float, people: Capsules | None = None) -> Image:
        """The picture (h, w) uint8 of a board on its path at time ``t`` (the middle of the exposure), s."""
        held = PosedBoard(board, exposed(self.camera, board, path, t, self._optics.exposure_s))
        return self._expose(self.eye.render([held], people, self._optics.blur_px), frame)

    def take_wand(self, frame: int, wand: Wand, path: Path, t: float) -> Image:
        """The picture of a wand."""
        light = self.eye.see_wand(wand, path(t), self._optics.blur_px)
        return self._expose(light, frame)

    def _expose(self, light: NDArray[np.float32], frame: int) -> Image:
        return self._optics.sensor.expose(light, self._number, frame)


def exposed(camera: CameraModel, board: BoardPrint, path: Path, t: float, exposure_s: float) -> Array:
    """(K, 4, 4) a board's poses while the shutter is open, as many as its motion in the picture asks for."""
    shutter = np.array([-0.5, 0.5]) * exposure_s + t
    opened, closed = (camera.project(board.sheet_board @ T[:3, :3].T + T[:3, 3]) for T in map(path, shutter))
    moved_px = float(np.nan_to_num(np.abs(closed - opened)).max())
    if moved_px < STILL_PX:
        return path(t)[None]
    moments = min(3 + 2 * int(moved_px / 2.0), MOST_MOMENTS)  # an odd number: one of them is the middle
    between = (np.arange(moments) + 0.5) / moments
    return np.array([path(time) for time in shutter[0] + between * exposure_s])
