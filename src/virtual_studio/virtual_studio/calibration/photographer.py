"""Takes pictures of what moves: the exposure lasts, the sensor is noisy."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from capture_rig.camera import CameraModel

from ..body import Capsules
from ..sensor import Sensor
from .board_camera import LENS_BLUR_PX, BoardCamera, HeldBoard
from .board_caster import Array
from .paths import Path
from .prints import BoardPrint
from .wand import Wand

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


class Photographer:
    """Takes one camera's pictures; ``number`` and the frame's number determine the noise."""

    def __init__(self, camera: CameraModel, number: int, optics: Optics) -> None:
        self.camera, self._number, self._optics = camera, number, optics
        self.eye = BoardCamera(camera)

    def take(self, frame: int, board: BoardPrint, path: Path, t: float, people: Capsules | None = None) -> Image:
        """The picture (h, w) uint8 of a board on its path at time ``t`` (the middle of the exposure), s."""
        held = HeldBoard(board, exposed(self.camera, board, path, t, self._optics.exposure_s))
        return self._expose(self.eye.see([held], people, self._optics.blur_px), frame)

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
