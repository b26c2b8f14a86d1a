"""Who holds a board: two hands at its sides, or the whole built-in person behind it."""

from __future__ import annotations

import numpy as np

from stick_figure.kinematics import forward
from stick_figure.pose import Pose

from ..body import SKIN, SLEEVE, Capsules, VolumetricBody
from ..motions.limbs import ARM, reaching, with_right
from .board_caster import Array
from .prints import BoardPrint

GRIP_M, THUMB_RADIUS_M = 0.012, 0.009
"""How far a thumb reaches over the sheet's edge, and how thick it is."""
ARM_BEHIND_M = 0.45
"""From the middle of the person to the board."""
ELBOW_TORSO = (0.05, 0.55, 0.05)
ANKLES = [13, 14]
MIRROR_Y = np.array([1.0, -1.0, 1.0])


def hands(board: BoardPrint, T_world_board: Array, over_m: float = GRIP_M) -> Capsules:
    """Two thumbs on a sheet's sides and the forearms behind it; ``over_m``: how far the thumbs reach over the edge."""
    left, right = _grips(board)
    starts, ends = [], []
    for place, out in ((left, -1.0), (right, 1.0)):
        tip = out * (THUMB_RADIUS_M - over_m)
        starts += [place + np.array([0, 0, THUMB_RADIUS_M]), place + np.array([out * 0.02, 0, -0.045])]
        ends += [place + np.array([tip, 0, THUMB_RADIUS_M]), place + np.array([out * 0.05, -0.12, -0.32])]
    R, t = T_world_board[:3, :3], T_world_board[:3, 3]
    radii = np.array([[THUMB_RADIUS_M, THUMB_RADIUS_M], [0.035, 0.045]] * 2)
    return Capsules(np.array(starts) @ R.T + t, np.array(ends) @ R.T + t, radii, np.array([SKIN, SLEEVE] * 2))


def person_with(body: VolumetricBody, board: BoardPrint, T_world_board: Array) -> Capsules:
    """The person who carries a board: behind it, upright, the hands at its sides as far as the arms reach."""
    normal = T_world_board[:3, 2] * [1.0, 1.0, 0.0]
    forwards = normal / max(float(np.linalg.norm(normal)), 1e-9)
    R = np.column_stack([forwards, np.cross([0.0, 0.0, 1.0], forwards), [0.0, 0.0, 1.0]])
    middle = T_world_board[:3, :3] @ board.middle_board + T_world_board[:3, 3]
    position = middle - ARM_BEHIND_M * forwards
    position[2] = _standing_height(body)
    grips = [T_world_board[:3, :3] @ place + T_world_board[:3, 3] for place in _grips(board)]
    left, right = sorted(((place - position) @ R for place in grips), key=lambda place: -place[1])
    angles = with_right(
        reaching(body.body, tuple(left), ELBOW_TORSO), reaching(body.body, tuple(right * MIRROR_Y), ELBOW_TORSO), ARM
    )
    return body.place(Pose.from_angles(position, R, angles))


def _grips(board: BoardPrint) -> tuple[Array, Array]:
    """(3,) the middles of the sheet's left and right side, board frame, m."""
    top_left, top_right, bottom_left, bottom_right = board.sheet_board
    return 0.5 * (top_left + bottom_left), 0.5 * (top_right + bottom_right)


def _standing_height(body: VolumetricBody) -> float:
    """Of the torso's centre above the floor, legs straight."""
    angles = reaching(body.body, (0.3, 0.3, 0.0), ELBOW_TORSO)
    points = forward(body.body, Pose.from_angles(np.zeros(3), np.eye(3), angles))
    return float(body.ankle_height - points[ANKLES, 2].min())
