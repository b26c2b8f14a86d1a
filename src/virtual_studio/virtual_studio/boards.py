"""Calibration boards as objects in the room, printed on stiff sheets, and how hands move them.

A board is waved in front of one camera (for its intrinsics), laid on the floor, or carried through the volume (for
extrinsics). Every path has a hand's tremor.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from capture_rig.camera import CameraModel
from capture_rig.rigid import transform
from rig_calibration.boards.board import Board, CharucoBoard
from rig_calibration.boards.drawing import draw_board, print_size_m
from stick_figure.kinematics import forward
from stick_figure.pose import Pose

from .motions.timeline import ARM, ease, reaching, with_right
from .people import SKIN, SLEEVE, Capsules, VolumetricBody

Array = NDArray[np.float64]
PosePath = Callable[[float], Array]
"""Time, s, to a pose (4, 4)."""

BLACK, WHITE, BACK = 0.06, 0.85, 0.35
"""Albedos of ink, of paper, and of the sheet's other side."""
MARGIN = 0.6
"""White around the fields, in fields."""
TEXELS_PER_M = 1000.0
"""One a millimetre: edges of fields that measure whole millimetres lie between texels, which need no blending then."""
FINE_TEXELS_PER_M = 3 * TEXELS_PER_M
"""For markers, whose cells are small."""


@dataclass(frozen=True, eq=False)
class BoardPrint:
    """A board and its print at true scale.

    texture (r, c): 0 black to 255 white; H_texel_board (3, 3) maps [x, y, 1] of the board frame, m, to
    [column, row, 1]; texel (i, j) covers [j, j + 1) x [i, i + 1).
    """

    board: Board
    texture: NDArray[np.uint8]
    H_texel_board: Array

    @cached_property
    def edge_distance(self) -> NDArray[np.uint8]:
        """(r, c) texels to the nearest change of grey or end of the print; at most 255."""
        edge = np.zeros(self.texture.shape, bool)
        for axis in (0, 1):
            differs = np.diff(self.texture, axis=axis) != 0
            edge |= np.insert(differs, 0, True, axis) | np.insert(differs, differs.shape[axis], True, axis)
        away = cv2.distanceTransform(np.where(edge, 0, 255).astype(np.uint8), cv2.DIST_L2, cv2.DIST_MASK_PRECISE)
        return np.clip(np.floor(away - 1.0), 0, 255).astype(np.uint8)

    @cached_property
    def sheet_board(self) -> Array:
        """(4, 3) the sheet's corners, board frame, m: the first row's from left to right, then the last row's."""
        rows, columns = self.texture.shape
        texels = np.array([[0, 0, 1], [columns, 0, 1], [0, rows, 1], [columns, rows, 1]], float)
        places = texels @ np.linalg.inv(self.H_texel_board).T
        return np.column_stack([places[:, :2], np.zeros(4)])

    @cached_property
    def middle_board(self) -> Array:
        """(3,) the middle of the corners, board frame, m."""
        return self.board.corners_board.mean(axis=0)

    def centred(self, T_frame_middle: Array) -> Array:
        """Returns the board's pose T_frame_board (4, 4) that puts its middle into a pose."""
        return T_frame_middle @ transform(np.eye(3), -self.middle_board)


def print_of(board: Board) -> BoardPrint:
    """Prints a board, with a white margin."""
    charuco = isinstance(board, CharucoBoard)
    field = board.square_m if isinstance(board, CharucoBoard) else max(board.field_m)
    drawn = draw_board(board, FINE_TEXELS_PER_M if charuco else TEXELS_PER_M, MARGIN * field)
    centre_to_corner = np.array([[1, 0, 0.5], [0, 1, 0.5], [0, 0, 1.0]])
    return BoardPrint(board, np.ascontiguousarray(drawn.image), centre_to_corner @ drawn.T_pixel_board)


@dataclass(frozen=True, eq=False)
class PosedBoard:
    """A board in the room: ``T_world_board`` (K, 4, 4), one pose for each instant of the exposure (1: it is still)."""

    print: BoardPrint
    T_world_board: Array

    @property
    def corners_world(self) -> Array:
        """(n, 3) the inner corners, m, in the middle of the exposure."""
        middle = self.T_world_board[len(self.T_world_board) // 2]
        return self.print.board.corners_board @ middle[:3, :3].T + middle[:3, 3]


# --- How hands move them, and the hands, or the person, that hold them.


TREMOR_M, TREMOR_RAD = 0.0007, 0.003
"""Standard deviations of a hand's tremor."""
TREMOR_HZ = (0.7, 1.9, 3.1)

FACING = np.diag([1.0, -1.0, -1.0])
"""R_camera_board of a board that faces the camera, upright."""
NEAR, MIDDLE, FAR = 1.25, 1.875, 3.125
"""Distances over the sheet's width."""
TRAVEL_S, REST_S = 0.6, 0.4
EDGE_PX = 8.0
OUTSIDE = (1.1, 0.9, 0, 15)
ROLL = 0.25
AWAY = (0.5, 7.5, 2.5)
"""Where the board is before and after, camera frame, in its widths: below the picture."""
Views = list[tuple[float, ...]]
"""Places in the picture (-1 left or top, 1 right or bottom: there the outer fields reach its edge), and tilts, degrees,
about the picture's horizontal and its vertical axis."""
_CORNERS: Views = [(-1, -1, 20, -20), (1, -1, 20, 20), (1, 1, -20, 20), (-1, 1, -20, -20)]
_EDGES: Views = [(0, -1, 30, 0), (1, 0, 0, 30), (0, 1, -30, 0), (-1, 0, 0, -30)]
_TILTS: Views = [(0, 0, 0, 0), (0, 0, 42, 0), (0, 0, 0, 42), (0, 0, -42, 0), (0, 0, 0, -42)]
_SPREAD: Views = [(x, y, 35 * y, -35 * x) for x in (-0.6, 0.6) for y in (-0.6, 0.6)]
_FAR: Views = [
    (x, y, 32 * ((i % 3) - 1), 32 * ((i + 1) % 3 - 1))
    for i, (x, y) in enumerate([(-1, -1), (0, -1), (1, -1), (1, 0), (0, 0), (-1, 0), (-1, 1), (0, 1), (1, 1)])
]
FULL: dict[float, Views] = {NEAR: _TILTS + _CORNERS, MIDDLE: _CORNERS + _EDGES + _SPREAD, FAR: _FAR}
BRIEF: dict[float, Views] = {NEAR: _TILTS[1:], MIDDLE: _CORNERS + _EDGES, FAR: [*_FAR[::2]]}

FLOOR_PLACE = (0.12, -0.08, 0.3)
"""Where the floor board lies, x and y in m, heading in rad: near the middle of the room, not exactly along it."""
TURNS = 2.5
UPRIGHT = np.array([[0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])
"""R_world_board of a board that stands upright and faces the world's x axis."""

GRIP_M, THUMB_RADIUS_M = 0.012, 0.009
"""How far a thumb reaches over the sheet's edge, and how thick it is."""
ARM_BEHIND_M = 0.45
"""From the middle of the person to the board."""
ELBOW_TORSO = (0.05, 0.55, 0.05)
ANKLES = [13, 14]
MIRROR_Y = np.array([1.0, -1.0, 1.0])


Waypoint = tuple[Array, float]
"""A pose (4, 4) in which a board rests for REST_S, and the time of the way there, s."""


@dataclass(frozen=True, eq=False)
class Wave:
    """A board's path (T_world_board), its duration, s, and the middles of its rests (r,), s."""

    path: PosePath
    duration_s: float
    rests_s: Array


def wave(camera: CameraModel, board: BoardPrint, seed: int, brief: bool = False) -> Wave:
    """Waves a board in front of a camera.

    It comes in from outside, is shown near, tilted to all sides, in the corners and along the edges of the picture and
    farther away, twice partly outside, and leaves again.
    """
    rng = np.random.default_rng(seed)
    size = float(np.linalg.norm(board.sheet_board[1] - board.sheet_board[0]))
    away = board.centred(transform(FACING, size * np.array(AWAY))), TRAVEL_S
    waypoints: list[Waypoint] = [away]
    for distance, views in (BRIEF if brief else FULL).items():
        for view in views:
            T = _in_view(camera, board, size * distance, view, rng)
            waypoints.append((T, TRAVEL_S * rng.uniform(0.8, 1.2)))
    outside = _in_view(camera, board, size * MIDDLE, OUTSIDE, rng, reach=1.6), TRAVEL_S
    waypoints = [*waypoints[:-1], outside, waypoints[-1], away]
    T_world_camera = np.linalg.inv(camera.T_camera_world)
    in_camera = with_tremor(along(waypoints), seed)
    rests_s = _arrivals_s(waypoints) + REST_S / 2
    return Wave(lambda t: T_world_camera @ in_camera(t), float(rests_s[-1] + REST_S / 2), rests_s[1:-1])


def on_floor(board: BoardPrint) -> Array:
    """Lays a board at FLOOR_PLACE: T_world_board (4, 4), print up, its rows along the heading."""
    x, y, heading = FLOOR_PLACE
    return board.centred(transform(Rotation.from_rotvec([0.0, 0.0, heading]).as_matrix(), np.array([x, y, 0.0])))


def carry(board: BoardPrint, seconds: float, seed: int) -> PosePath:
    """Carries a board through the volume.

    It faces outward to all sides, low and high, upright and leaning back, so that neighbouring cameras, and the one
    above, see it together.
    """
    phases = np.random.default_rng(seed).uniform(0.0, 2.0 * np.pi, 4)

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
        return board.centred(transform(R, np.array([out * np.cos(heading), out * np.sin(heading), up])))

    return with_tremor(at, seed)


def hands(board: BoardPrint, T_world_board: Array) -> Capsules:
    """Places two thumbs on a sheet's sides, GRIP_M over its edge, and the forearms behind it."""
    starts, ends = [], []
    for place, out in zip(_grips(board), (-1.0, 1.0), strict=True):
        tip = out * (THUMB_RADIUS_M - GRIP_M)
        starts += [place + np.array([0, 0, THUMB_RADIUS_M]), place + np.array([out * 0.02, 0, -0.045])]
        ends += [place + np.array([tip, 0, THUMB_RADIUS_M]), place + np.array([out * 0.05, -0.12, -0.32])]
    R, t = T_world_board[:3, :3], T_world_board[:3, 3]
    radii = np.array([[THUMB_RADIUS_M, THUMB_RADIUS_M], [0.035, 0.045]] * 2)
    return Capsules(np.array(starts) @ R.T + t, np.array(ends) @ R.T + t, radii, np.array([SKIN, SLEEVE] * 2))


def person_with(body: VolumetricBody, board: BoardPrint, T_world_board: Array) -> Capsules:
    """Places a person behind a board, upright, the hands at its sides as far as the arms reach."""
    normal = T_world_board[:3, 2] * [1.0, 1.0, 0.0]
    ahead = normal / max(float(np.linalg.norm(normal)), 1e-9)
    R = np.column_stack([ahead, np.cross([0.0, 0.0, 1.0], ahead), [0.0, 0.0, 1.0]])
    middle = T_world_board[:3, :3] @ board.middle_board + T_world_board[:3, 3]
    position = middle - ARM_BEHIND_M * ahead
    standing = Pose.from_angles(np.zeros(3), np.eye(3), reaching(body.body, (0.3, 0.3, 0.0), ELBOW_TORSO))
    position[2] = body.ankle_height - forward(body.body, standing)[ANKLES, 2].min()
    grips = [T_world_board[:3, :3] @ place + T_world_board[:3, 3] for place in _grips(board)]
    left, right = sorted(((place - position) @ R for place in grips), key=lambda place: -place[1])
    left_arm = reaching(body.body, tuple(left), ELBOW_TORSO)
    right_arm = reaching(body.body, tuple(right * MIRROR_Y), ELBOW_TORSO)
    return body.place(Pose.from_angles(position, R, with_right(left_arm, right_arm, ARM)))


def _arrivals_s(waypoints: Sequence[Waypoint]) -> Array:
    return np.cumsum([REST_S + travel_s for _, travel_s in waypoints]) - waypoints[0][1] - REST_S


def along(waypoints: Sequence[Waypoint]) -> PosePath:
    """Makes a smooth path through waypoints; it stays at the first before and at the last after it."""
    arrivals_s = _arrivals_s(waypoints)

    def at(t: float) -> Array:
        after = min(max(int(np.searchsorted(arrivals_s, t)), 1), len(waypoints) - 1)
        (a, _), (b, travel_s) = waypoints[after - 1 : after + 1]
        fraction = ease((t - arrivals_s[after]) / travel_s + 1.0)
        turn = Rotation.from_matrix(a[:3, :3].T @ b[:3, :3]).as_rotvec()
        R = a[:3, :3] @ Rotation.from_rotvec(fraction * turn).as_matrix()
        return transform(R, (1.0 - fraction) * a[:3, 3] + fraction * b[:3, 3])

    return at


def with_tremor(path: PosePath, seed: int) -> PosePath:
    """Adds a hand's tremor to a path."""
    rng = np.random.default_rng(seed)
    frequencies = np.array(TREMOR_HZ)[:, None] * rng.uniform(0.85, 1.15, (len(TREMOR_HZ), 6))
    phases = rng.uniform(0.0, 2.0 * np.pi, frequencies.shape)
    amplitudes = np.repeat([TREMOR_M, TREMOR_RAD], 3) * np.sqrt(2.0 / len(TREMOR_HZ))

    def at(t: float) -> Array:
        shake = amplitudes * np.sin(2.0 * np.pi * frequencies * t + phases).sum(axis=0)
        T = path(t)
        return transform(T[:3, :3] @ Rotation.from_rotvec(shake[3:]).as_matrix(), T[:3, 3] + shake[:3])

    return at


def _in_view(
    camera: CameraModel,
    board: BoardPrint,
    distance_m: float,
    view: tuple[float, ...],
    rng: np.random.Generator,
    reach: float = 1.0,
) -> Array:
    """T_camera_board of a board at a place in the picture; ``reach`` beyond 1 lets it leave the picture."""
    x, y, *tilt_deg = view
    tilt = np.deg2rad(np.array(tilt_deg) + rng.uniform(-6, 6, 2))
    R = Rotation.from_rotvec([tilt[0], tilt[1], 0.0]).as_matrix()
    R = R @ Rotation.from_rotvec([0, 0, rng.uniform(-ROLL, ROLL)]).as_matrix() @ FACING
    size = np.ptp(board.sheet_board[:, :2], axis=0)
    share_of_fields = np.append(np.array(print_size_m(board.board)) / size, 1.0)  # the rest of the sheet is margin
    fields = (board.sheet_board - board.middle_board) * share_of_fields @ R.T
    focal, half = camera.K.diagonal()[:2], np.array([camera.width, camera.height]) / 2
    room = np.maximum(half - EDGE_PX - (focal * np.abs(fields[:, :2]) / (distance_m + fields[:, 2:])).max(axis=0), 0.0)
    target = half - 0.5 + np.array([x, y]) * room * reach
    ray = camera.R_camera_world @ _outermost_ray(camera, target)
    return board.centred(transform(R, distance_m / ray[2] * ray))


INWARD_STEPS = 101  # from a pixel of a folded corner to the middle: four pixels each at most


def _outermost_ray(camera: CameraModel, pixel: Array) -> Array:
    """Return the direction (3,), world frame, of a pixel; where the lens model has none, of the next pixel with one
    towards the principal point."""
    centre = camera.K[:2, 2]
    rays = camera.rays_world(centre + np.linspace(1.0, 0.0, INWARD_STEPS)[:, None] * (pixel - centre))
    return np.asarray(rays[np.isfinite(rays).all(axis=1)][0])


def _grips(board: BoardPrint) -> tuple[Array, Array]:
    """Return (3,) the middles of the sheet's left and right side, board frame, m."""
    top_left, top_right, bottom_left, bottom_right = board.sheet_board
    return 0.5 * (top_left + bottom_left), 0.5 * (top_right + bottom_right)
