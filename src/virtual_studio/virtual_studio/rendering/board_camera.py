"""Renders what one camera sees of calibration boards, wands and who holds them: lens, focus, exposure and noise."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import cv2
import numpy as np
from numpy.typing import NDArray

from capture_rig.camera import CameraModel

from ..people import Capsules
from ..scene.boards import BACK, BLACK, DIMMED, GLOW, WHITE, BoardPrint, PosedBoard, PosePath, Wand
from ..scene.room import view_room
from .board_caster import Array, cast_ball, cast_board, sample_offsets
from .camera import Image, Light, Sensor
from .capsules import draw_capsules, lambert

SAMPLES = 48
LENS_BLUR_PX = 0.6
"""Standard deviation of a point's picture in a lens that is in focus."""
OUTLINE_POINTS = 16
BOX_MARGIN_PX = 2
NEAR_M = 0.02
STILL_PX = 0.1
"""Motion below this, while the shutter is open, is not drawn."""
MOST_INSTANTS = 9


@dataclass(frozen=True)
class Optics:
    """How pictures are taken. blur_px: of a lens in focus, standard deviation; exposure_s: the shutter's time."""

    sensor: Sensor
    blur_px: float = LENS_BLUR_PX
    exposure_s: float = 0.008


class BoardCamera:
    """Renders the room with boards, and with who holds them, through a camera's own lens."""

    def __init__(self, camera: CameraModel) -> None:
        self.camera = camera
        self._view, self._ideal = view_room(camera), ideal_corners(camera)

    def empty_room(self) -> Light:
        """Returns the light of the room with nobody in it."""
        return self._view.grey

    def render(
        self,
        boards: Sequence[PosedBoard] = (),
        people: Capsules | None = None,
        blur_px: float = LENS_BLUR_PX,
        samples: int = SAMPLES,
    ) -> Light:
        """Returns the light of boards, farthest first, and of people, blurred by the lens (standard deviation, px).

        samples : of a pixel on an edge; few are fast, many are exact.
        """
        light, depth = self._with_people(people)
        for board in sorted(boards, key=self._distance, reverse=True):
            self._draw(board, depth, light, sample_offsets(samples))
        return _blurred(light, blur_px)

    def render_wand(self, wand: Wand, T_world_wand: Array, blur_px: float = LENS_BLUR_PX) -> Light:
        """Returns the light of a wand of glowing balls in the dimmed room; nobody holds it."""
        light = DIMMED * self._with_people(wand.stick(T_world_wand))[0]
        offsets = sample_offsets(SAMPLES)
        for ball in wand.balls_world(T_world_wand):
            centre = self.camera.R_camera_world @ ball + self.camera.t_camera_world
            reach_px = 1.5 * self.camera.K[0, 0] * wand.radius_m / max(centre[2], NEAR_M)
            pixel = self.camera.project(ball)
            if np.isfinite(pixel).all():
                box = self._box(pixel - reach_px - 1, pixel + reach_px + 2)
                cast_ball(self._ideal, centre, wand.radius_m, GLOW, offsets, box, light)
        return _blurred(light, blur_px)

    def _with_people(self, people: Capsules | None) -> tuple[Light, Light]:
        """Light and depth along the ray, m, of the room with people, or a stick, in it."""
        light = self._view.grey.copy()
        if people is None:
            return light, np.full(light.shape, np.inf, np.float32)
        return light, draw_capsules(self.camera, self._view.rays, people, light)[0]

    def _draw(self, board: PosedBoard, depth: Light, light: Light, offsets: Array) -> None:
        box = self._box_of(board)
        if (box[2:] <= box[:2]).any():
            return
        printed = board.print
        homographies = np.array([_homography(self.camera.T_camera_world @ T, printed) for T in board.T_world_board])
        greys = np.array([self._greys(T) for T in board.T_world_board])
        cast_board(self._ideal, homographies, greys, printed.texture, printed.edge_distance, offsets, box, depth, light)

    def _greys(self, T_world_board: Array) -> Array:
        """Return (2,) light from black and white; from both the same, of the sheet, where its back is seen."""
        towards = self.camera.centre_world - T_world_board[:3, 3]
        in_front = float(T_world_board[:3, 2] @ towards) > 0.0
        normal = T_world_board[:3, 2] if in_front else -T_world_board[:3, 2]
        return lambert(*normal) * np.array([BLACK, WHITE] if in_front else [BACK, BACK])

    def _box_of(self, board: PosedBoard) -> NDArray[np.int64]:
        """Pixels x0, y0, x1, y1 (end excluded) that the sheet may cover while the shutter is open."""
        outline = _outline(board.print.sheet_board)
        points = np.concatenate([outline @ T[:3, :3].T + T[:3, 3] for T in board.T_world_board])
        depth = points @ self.camera.R_camera_world[2] + self.camera.t_camera_world[2]
        if depth.max() < NEAR_M:
            return np.zeros(4, np.int64)
        pixels = self.camera.project(points)
        if depth.min() < NEAR_M or np.isnan(pixels).any():  # around the camera, or beyond its lens
            return np.array([0, 0, self.camera.width, self.camera.height], np.int64)
        return self._box(pixels.min(0) - BOX_MARGIN_PX, pixels.max(0) + BOX_MARGIN_PX + 1)

    def _box(self, low: Array, high: Array) -> NDArray[np.int64]:
        size = np.array([self.camera.width, self.camera.height])
        return np.concatenate([np.clip(np.floor(low), 0, size), np.clip(np.ceil(high), 0, size)]).astype(np.int64)

    def _distance(self, board: PosedBoard) -> float:
        middle = board.middle[:3, :3] @ board.print.middle_board + board.middle[:3, 3]
        return float(np.linalg.norm(middle - self.camera.centre_world))


class FilmingCamera:
    """Takes one camera's pictures; ``number`` and the frame's number determine the noise."""

    def __init__(self, camera: CameraModel, number: int, optics: Optics) -> None:
        self.camera, self._number, self._optics = camera, number, optics
        self._renderer = BoardCamera(camera)

    def take(self, frame: int, board: BoardPrint, path: PosePath, t: float, people: Capsules | None = None) -> Image:
        """Takes a picture (h, w) of a board on its path at time ``t`` (the middle of the exposure), s."""
        posed = PosedBoard(board, exposure_poses(self.camera, board, path, t, self._optics.exposure_s))
        light = self._renderer.render([posed], people, self._optics.blur_px)
        return self._optics.sensor.expose(light, self._number, frame)

    def take_wand(self, frame: int, wand: Wand, path: PosePath, t: float) -> Image:
        """Takes a picture (h, w) of a wand."""
        light = self._renderer.render_wand(wand, path(t), self._optics.blur_px)
        return self._optics.sensor.expose(light, self._number, frame)


def exposure_poses(camera: CameraModel, board: BoardPrint, path: PosePath, t: float, exposure_s: float) -> Array:
    """Returns a board's poses (K, 4, 4) while the shutter is open, as many as its motion in the picture asks for."""
    shutter = np.array([-0.5, 0.5]) * exposure_s + t
    opened, closed = (camera.project(board.sheet_board @ T[:3, :3].T + T[:3, 3]) for T in map(path, shutter))
    moved_px = float(np.nan_to_num(np.abs(closed - opened)).max())
    if moved_px < STILL_PX:
        return path(t)[None]
    instants = min(3 + 2 * int(moved_px / 2.0), MOST_INSTANTS)  # an odd number: one of them is the middle
    between = (np.arange(instants) + 0.5) / instants
    return np.array([path(time) for time in shutter[0] + between * exposure_s])


def ideal_corners(camera: CameraModel) -> Array:
    """Returns normalised undistorted coordinates (h + 1, w + 1, 2) of pixel corners; NaN beyond the lens model."""
    y, x = np.mgrid[: camera.height + 1, : camera.width + 1] - 0.5
    rays = camera.rays_world(np.column_stack([x.ravel(), y.ravel()])) @ camera.R_camera_world.T
    return np.ascontiguousarray((rays[:, :2] / rays[:, 2:]).reshape(camera.height + 1, camera.width + 1, 2))


def _homography(T_camera_board: Array, board: BoardPrint) -> Array:
    """(3, 3) from normalised image coordinates [x, y, 1] to texels; scaled so that its last row gives 1 / depth."""
    return board.H_texel_board @ np.linalg.inv(T_camera_board[:3, [0, 1, 3]])


def _outline(sheet: Array) -> Array:
    """Return (4 * OUTLINE_POINTS, 3) points around the sheet: a lens bends its edges."""
    ring, fraction = sheet[[0, 1, 3, 2, 0]], np.linspace(0.0, 1.0, OUTLINE_POINTS, endpoint=False)[:, None]
    return np.concatenate([a + fraction * (b - a) for a, b in pairwise(ring)])


def _blurred(light: Light, blur_px: float) -> Light:
    if blur_px > 0:
        cv2.GaussianBlur(light, (0, 0), blur_px, dst=light, borderType=cv2.BORDER_REPLICATE)
    return light
