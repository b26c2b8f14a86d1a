"""How hands move a board: from one place to the next with a rest at each, or on a smooth curve; never quite still."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from capture_rig.camera import CameraModel
from stick_figure.kinematics import forward
from stick_figure.pose import Pose

from ..motions.limbs import ARM, reaching, with_right
from ..motions.timeline import ease
from ..people import SKIN, SLEEVE, Capsules, VolumetricBody
from ..rendering.board_caster import Array
from .boards import BoardPrint

Path = Callable[[float], Array]
"""Time, s, to a pose (4, 4)."""

TREMOR_M, TREMOR_RAD = 0.0007, 0.003
"""Standard deviations of a hand's tremor."""
TREMOR_HZ = (0.7, 1.9, 3.1)


@dataclass(frozen=True, eq=False)
class Waypoint:
    """A place where a board is held: ``T`` (4, 4), for ``rest_s`` after ``travel_s`` on the way there."""

    T: Array
    travel_s: float
    rest_s: float


def pose(R: Array, position: Array) -> Array:
    """(4, 4) of a rotation (3, 3) and a position (3,), m."""
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = R, position
    return T


def duration_of(stations: Sequence[Waypoint]) -> float:
    """Seconds until the last station's rest is over; the way to the first one is not travelled."""
    return sum(station.travel_s + station.rest_s for station in stations) - stations[0].travel_s


def rests_of(stations: Sequence[Waypoint]) -> Array:
    """(n,) the middle of each station's rest, s."""
    ends = np.cumsum([s.rest_s + s.travel_s for s in stations]) - stations[0].travel_s
    return ends - [s.rest_s / 2 for s in stations]


def along(stations: Sequence[Waypoint]) -> Path:
    """The path through stations, with ease; it stays at the first before and at the last after it."""
    arrivals = np.cumsum([s.rest_s + s.travel_s for s in stations]) - stations[0].travel_s
    arrivals -= [s.rest_s for s in stations]

    def at(t: float) -> Array:
        after = int(np.searchsorted(arrivals, t))
        if after == 0 or after == len(stations):
            return stations[min(after, len(stations) - 1)].T
        before, to = stations[after - 1], stations[after]
        share = ease((t - arrivals[after]) / to.travel_s + 1.0)
        return between(before.T, to.T, share)

    return at


def between(a: Array, b: Array, share: float) -> Array:
    """The pose that lies between two: turned about one axis, moved along a line."""
    turn = Rotation.from_matrix(a[:3, :3].T @ b[:3, :3]).as_rotvec()
    R = a[:3, :3] @ Rotation.from_rotvec(share * turn).as_matrix()
    return pose(R, (1.0 - share) * a[:3, 3] + share * b[:3, 3])


def with_tremor(path: Path, seed: int) -> Path:
    """The same path as a hand goes it."""
    rng = np.random.default_rng(seed)
    frequencies = np.array(TREMOR_HZ)[:, None] * rng.uniform(0.85, 1.15, (len(TREMOR_HZ), 6))
    phases = rng.uniform(0.0, 2.0 * np.pi, frequencies.shape)
    amplitudes = np.repeat([TREMOR_M, TREMOR_RAD], 3) * np.sqrt(2.0 / len(TREMOR_HZ))

    def at(t: float) -> Array:
        shake = amplitudes * np.sin(2.0 * np.pi * frequencies * t + phases).sum(axis=0)
        T = path(t)
        return pose(T[:3, :3] @ Rotation.from_rotvec(shake[3:]).as_matrix(), T[:3, 3] + shake[:3])

    return at


# --- How somebody waves a board in front of one camera, so that its lens can be calibrated.

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
    stations = [Waypoint(_centred(away, board), TRAVEL_S, REST_S)]
    for distance_m, places in (BRIEF if brief else FULL).items():
        for place in places:
            T = _shown(camera, board, size * distance_m, place, rng)
            stations.append(Waypoint(T, TRAVEL_S * rng.uniform(0.8, 1.2), REST_S))
    outside = _shown(camera, board, size * MIDDLE_M, (*OUTSIDE, 0, 15), rng, reach=1.6)
    stations[-1:-1] = [Waypoint(outside, TRAVEL_S, REST_S)]
    stations.append(Waypoint(_centred(away, board), TRAVEL_S, REST_S))
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


# --- How a board lies on the floor, and how somebody carries a board, or a wand, through the room.

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


# --- Who holds a board: two hands at its sides, or the whole built-in person behind it.

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
