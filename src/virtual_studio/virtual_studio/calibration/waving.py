"""How somebody waves a board in front of one camera, so that its lens can be calibrated."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from capture_rig.camera import CameraModel

from .board_caster import Array
from .paths import Path, Station, along, duration_of, pose, rests_of, with_tremor
from .prints import BoardPrint

FACING = np.diag([1.0, -1.0, -1.0])
"""R_camera_board of a board that faces the camera, upright."""
NEAR_M, MIDDLE_M, FAR_M = 0.5, 0.75, 1.25
"""Distances of a board of 0.4 m; other boards are held where they look as large."""
BOARD_M = 0.4
TRAVEL_S, REST_S = 0.6, 0.4
EDGE_PX = 8.0
OUTSIDE = (1.1, 0.9)
Spots = list[tuple[float, ...]]
"""Places in the picture (-1 left or top, 1 right or bottom: there the outer fields reach its edge), and tilts, degrees,
about the picture's horizontal and its vertical axis."""
ROLL = 0.25
AWAY = (0.2, 3.0, 1.0)
"""Where the board is before and after, camera frame, m: below the picture."""

_CORNERS: Spots = [(-1, -1, 20, -20), (1, -1, 20, 20), (1, 1, -20, 20), (-1, 1, -20, -20)]
_EDGES: Spots = [(0, -1, 30, 0), (1, 0, 0, 30), (0, 1, -30, 0), (-1, 0, 0, -30)]
_TILTS: Spots = [(0, 0, 0, 0), (0, 0, 42, 0), (0, 0, 0, 42), (0, 0, -42, 0), (0, 0, 0, -42)]
_SPREAD: Spots = [(x, y, 35 * y, -35 * x) for x in (-0.6, 0.6) for y in (-0.6, 0.6)]
_FAR: Spots = [
    (x, y, 32 * ((i % 3) - 1), 32 * ((i + 1) % 3 - 1))
    for i, (x, y) in enumerate([(-1, -1), (0, -1), (1, -1), (1, 0), (0, 0), (-1, 0), (-1, 1), (0, 1), (1, 1)])
]
FULL: dict[float, Spots] = {NEAR_M: _TILTS + _CORNERS, MIDDLE_M: _CORNERS + _EDGES + _SPREAD, FAR_M: _FAR}
BRIEF: dict[float, Spots] = {NEAR_M: _TILTS[1:], MIDDLE_M: _CORNERS + _EDGES, FAR_M: [*_FAR[::2]]}


@dataclass(frozen=True, eq=False)
class Wave:
    """A board's path (T_world_board), how long it takes, s, and the middles of its rests (r,), s."""

    path: Path
    duration_s: float
    rests_s: Array


def wave(camera: CameraModel, board: BoardPrint, seed: int, brief: bool = False) -> Wave:
    """A board in front of a camera.

    It comes in from outside, is shown near, tilted to all sides, in the corners and along the edges of the picture and
    farther away, twice partly outside, and leaves again.
    """
    rng = np.random.default_rng(seed)
    size = float(np.linalg.norm(board.sheet_board[1] - board.sheet_board[0]) / BOARD_M)
    away = pose(FACING, size * np.array(AWAY))
    stations = [Station(_centred(away, board), TRAVEL_S, REST_S)]
    for distance_m, places in (BRIEF if brief else FULL).items():
        for place in places:
            T = _shown(camera, board, size * distance_m, place, rng)
            stations.append(Station(T, TRAVEL_S * rng.uniform(0.8, 1.2), REST_S))
    outside = _shown(camera, board, size * MIDDLE_M, (*OUTSIDE, 0, 15), rng, reach=1.6)
    stations[-1:-1] = [Station(outside, TRAVEL_S, REST_S)]
    stations.append(Station(_centred(away, board), TRAVEL_S, REST_S))
    T_world_camera = np.linalg.inv(camera.T_camera_world)
    in_camera = with_tremor(along(stations), seed)
    shown = slice(1, len(stations) - 1)
    return Wave(lambda t: T_world_camera @ in_camera(t), duration_of(stations), rests_of(stations)[shown])


def _shown(
    camera: CameraModel,
    board: BoardPrint,
    distance_m: float,
    place: tuple[float, ...],
    rng: np.random.Generator,
    reach: float = 1.0,
) -> Array:
    """T_camera_board of a board shown at a place in the picture; ``reach`` beyond 1 lets it leave the picture."""
    x, y, *tilt_deg = place
    tilt = np.deg2rad(np.array(tilt_deg) + rng.uniform(-6, 6, 2))
    R = Rotation.from_rotvec([tilt[0], tilt[1], 0.0]).as_matrix()
    R = R @ Rotation.from_rotvec([0, 0, rng.uniform(-ROLL, ROLL)]).as_matrix() @ FACING
    fields = (_fields_board(board) - board.middle_board) @ R.T
    focal, half = camera.K.diagonal()[:2], np.array([camera.width, camera.height]) / 2
    room = np.maximum(half - EDGE_PX - (focal * np.abs(fields[:, :2]) / (distance_m + fields[:, 2:])).max(axis=0), 0.0)
    target = half - 0.5 + np.array([x, y]) * room * reach
    ray = camera.R_camera_world @ camera.rays_world(target[None])[0]
    return _centred(pose(R, distance_m / ray[2] * ray), board)


def _fields_board(board: BoardPrint) -> Array:
    """(4, 3) the corners of all fields together, board frame, m."""
    return board.middle_board + (board.sheet_board - board.middle_board) * board.share_of_fields


def _centred(T_camera_middle: Array, board: BoardPrint) -> Array:
    """The board's pose from that of its middle."""
    return T_camera_middle @ pose(np.eye(3), -board.middle_board)
