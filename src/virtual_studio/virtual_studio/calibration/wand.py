"""A wand of bright balls, in a room with dimmed lamps."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

from ..body import Capsules
from .board_caster import Array

DIMMED = 0.2
"""Of the room's light, while the wand is swung."""
GLOW = 1.2
"""Light of a ball; beyond what the sensor takes."""
STICK_ALBEDO, STICK_RADIUS_M = 0.10, 0.008


@dataclass(frozen=True)
class Wand:
    """Balls on a straight stick: where along it, m from the first one's centre, and how large."""

    marks_m: tuple[float, ...] = (0.0, 0.25, 0.4)
    radius_m: float = 0.02

    def balls_world(self, T_world_wand: Array) -> Array:
        """(n, 3) the balls' centres, m; the wand's frame has its origin in the first ball, x along the stick."""
        return np.multiply.outer(np.array(self.marks_m), T_world_wand[:3, 0]) + T_world_wand[:3, 3]

    def stick(self, T_world_wand: Array) -> Capsules:
        """The stick between the balls."""
        balls = self.balls_world(T_world_wand)
        return Capsules(balls[:1], balls[-1:], np.full((1, 2), STICK_RADIUS_M), np.array([STICK_ALBEDO]))


@njit(cache=True, nogil=True)
def cast_ball(ideal, centre, radius, glow, places, box, light):
    """Draws a glowing ball: ``centre`` (3,) camera frame, m; the other arguments as of ``cast_board``."""
    c2 = centre[0] ** 2 + centre[1] ** 2 + centre[2] ** 2 - radius**2
    for py in range(box[1], box[3]):
        for px in range(box[0], box[2]):
            covered = 0.0
            for i in range(len(places)):
                sx, sy = places[i, 0], places[i, 1]
                a, b, c, d = (1.0 - sy) * (1.0 - sx), (1.0 - sy) * sx, sy * (1.0 - sx), sy * sx
                x = a * ideal[py, px, 0] + b * ideal[py, px + 1, 0] + c * ideal[py + 1, px, 0]
                y = a * ideal[py, px, 1] + b * ideal[py, px + 1, 1] + c * ideal[py + 1, px, 1]
                x, y = x + d * ideal[py + 1, px + 1, 0], y + d * ideal[py + 1, px + 1, 1]
                ahead = x * centre[0] + y * centre[1] + centre[2]
                if ahead > 0.0 and ahead * ahead > c2 * (1.0 + x * x + y * y):
                    covered += 1.0 / len(places)
            light[py, px] = (1.0 - covered) * light[py, px] + covered * glow


def ball_box(pixel: Array, reach_px: float, width: int, height: int) -> NDArray[np.int64]:
    """Pixels x0, y0, x1, y1 (end excluded) around a ball's picture; none where it is not in the picture."""
    if not np.isfinite(pixel).all():
        return np.zeros(4, np.int64)
    size = np.array([width, height])
    low, high = np.floor(pixel - reach_px - 1), np.ceil(pixel + reach_px + 2)
    return np.concatenate([np.clip(low, 0, size), np.clip(high, 0, size)]).astype(np.int64)
