"""How a board lies on the floor, and how somebody carries a board, or a wand, through the room."""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from .board_caster import Array
from .paths import Path, pose, with_tremor
from .prints import BoardPrint

FLOOR_MIDDLE_WORLD = (0.12, -0.08, 0.0)
FLOOR_HEADING_RAD = 0.3
"""Where the floor board lies: near the middle of the room, as somebody would put it down, not exactly along it."""
TURNS = 2.5
UPRIGHT = np.array([[0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])
"""R_world_board of a board that stands upright and faces the world's x axis."""


def on_floor(
    board: BoardPrint, xy: tuple[float, float] = FLOOR_MIDDLE_WORLD[:2], heading_rad: float = FLOOR_HEADING_RAD
) -> Array:
    """T_world_board (4, 4) of a board on the floor, print up, its middle at ``xy`` m, its rows along the heading."""
    R = Rotation.from_rotvec([0.0, 0.0, heading_rad]).as_matrix()
    return pose(R, np.array([*xy, 0.0])) @ pose(np.eye(3), -board.middle_board)


def carry(board: BoardPrint, seconds: float, seed: int) -> Path:
    """The path of a board that is carried through the volume: it faces outward to all sides, low and high, upright
    and leaning back, so that neighbouring cameras, and the one above, see it together."""
    rng = np.random.default_rng(seed)
    phases = rng.uniform(0.0, 2.0 * np.pi, 4)

    def at(t: float) -> Array:
        u = t / seconds
        heading = 2.0 * np.pi * TURNS * u + phases[0]
        lean = np.deg2rad(30.0 + 28.0 * np.sin(2.0 * np.pi * 7.0 * u + phases[1]))
        roll = np.deg2rad(18.0) * np.sin(2.0 * np.pi * 5.0 * u + phases[2])
        yaw = np.deg2rad(25.0) * np.sin(2.0 * np.pi * 9.0 * u)
        R = Rotation.from_euler("ZYZ", [heading + yaw, -lean, 0.0]).as_matrix() @ UPRIGHT
        R = R @ Rotation.from_rotvec([0.0, 0.0, roll]).as_matrix()
        out = 0.45 + 0.35 * np.sin(2.0 * np.pi * 4.0 * u + phases[3])
        up = 1.15 + 0.35 * np.sin(2.0 * np.pi * 6.0 * u)
        return pose(R, np.array([out * np.cos(heading), out * np.sin(heading), up]))

    middle = pose(np.eye(3), -board.middle_board)
    return with_tremor(lambda t: at(t) @ middle, seed)


def swing(seconds: float, seed: int) -> Path:
    """The path of a wand, its x axis along it, that is swung through the volume, in all directions."""
    rng = np.random.default_rng(seed)
    phases = rng.uniform(0.0, 2.0 * np.pi, 6)

    def at(t: float) -> Array:
        u = 2.0 * np.pi * t / seconds
        place = np.array([0.0, 0.0, 1.1]) + [0.8, 0.8, 0.7] * np.sin(np.array([3, 4, 5]) * u + phases[:3])
        R = Rotation.from_euler("ZYX", [6 * u + phases[3], 1.1 * np.sin(7 * u + phases[4]), phases[5]]).as_matrix()
        return pose(R, place)

    return with_tremor(at, seed)
