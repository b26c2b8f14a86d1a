"""The rig in the world: the frame ``map`` (z up, origin on the floor; REP-105), the cameras placed in it, their volume.

The board that lies on the floor gives the frame (thesis 6.1). The common volume is where enough cameras see a person
for a hull (thesis 3.1), and the box around it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy import ndimage

from capture_rig.camera import CameraModel
from capture_rig.lens import Array
from capture_rig.rig import DEFAULT_HEIGHT_M, FLOOR_MARGIN_M, Rig, Volume, default_volume
from capture_rig.rigid import rotation_matrix, transform
from capture_rig.visibility import pixel_width_m

from ..bundle.solve import RigSolution


@dataclass(frozen=True)
class WorldChoice:
    """Where the world lies on the floor board.

    origin : (x, y) in the board frame, metres: x along the rows, y towards the top of the print, from the first corner;
    None: the middle of the board's corners. heading : the angle from the board's rows to world x, rad, counterclockwise
    seen from above. thickness_m : how high the print lies above the floor.
    """

    origin: tuple[float, float] | None = None
    heading: float = 0.0
    thickness_m: float = 0.0


def board_in_world(corners_board: Array, choice: WorldChoice) -> Array:
    """T_world_board (4, 4) of a board that lies on the floor, its print upwards; ``corners_board`` (n, 3)."""
    middle_board = (corners_board.min(axis=0) + corners_board.max(axis=0)) / 2
    origin_board = middle_board if choice.origin is None else np.array([*choice.origin, 0.0])
    R = rotation_matrix(np.array([0.0, 0.0, -choice.heading]))
    return transform(R, [0.0, 0.0, choice.thickness_m] - R @ origin_board)


def world_of_level_camera(T_camera_reference: Array) -> Array:
    """Return T_world_reference (4, 4) when no floor is known: the camera is taken for level, world x is its viewing
    direction, the origin its centre. Directions and distances are right but for its tilt; heights are meaningless."""
    T_world_camera = np.eye(4)
    T_world_camera[:3, :3] = [[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]]
    return T_world_camera @ T_camera_reference


# --- The common volume.


# Thresholds: judgement, no measurement.
ENOUGH_CAMERAS = 3  # two outlines leave a hull far fatter than the body
STEP_M = 0.1
BODY_TOP_M = 1.7  # a person can be tracked at a place where enough cameras see every height up to this
LEVELS_M = np.arange(0.15, BODY_TOP_M, 0.25)  # heights above a place on the floor at which views are counted
REACH = 2.0  # times a camera's distance from the rig's centre up to which it counts; beyond, its pixels are too coarse
MIN_SIDE_M, MAX_SIDE_M = 1.0, 8.0
TIP_SHARE = 0.02
"""Share of the places that may lie outside the box on each side: the tips of a star are not worth their voxels."""


@dataclass(frozen=True, eq=False)
class CommonVolume:
    """The cameras' common volume.

    box : axis-aligned, from just below the floor to 2.4 m above it: the bounding box of the places where a person can
    be tracked, or, without any, of the places seen at breast height. floor_m2 : by number of cameras (1 to all), the
    floor area where at least that many see a standing person. enough : the number of cameras that suffices. standing
    (nx, ny) : number of cameras that see a person who stands at x (nx,), y (ny,).
    """

    box: Volume
    floor_m2: tuple[float, ...]
    enough: int
    x: Array
    y: Array
    standing: npt.NDArray[np.int64]


def common_volume(cameras: Sequence[CameraModel]) -> CommonVolume:
    """Find where at least three cameras see (all, of fewer), on a grid of 0.1 m around the point that their axes
    meet."""
    enough = min(ENOUGH_CAMERAS, len(cameras))
    around = default_volume(tuple(cameras))
    middle = np.round((around.low + around.high)[:2] / 2 / STEP_M) * STEP_M  # whole multiples of the step
    offsets = np.arange(-MAX_SIDE_M / 2, MAX_SIDE_M / 2 + STEP_M / 2, STEP_M)
    x, y = middle[0] + offsets, middle[1] + offsets
    seeing = _cameras_seeing(cameras, x, y)  # (levels, nx, ny)
    standing = seeing.min(axis=0)
    place = _largest_piece(standing >= enough)
    if not place.any():
        place = _largest_piece(seeing[np.searchsorted(LEVELS_M, 1.0)] >= enough)
    box = _box(x, y, place) if place.any() else around
    return CommonVolume(
        box=box,
        floor_m2=tuple(float((standing >= n).sum() * STEP_M**2) for n in range(1, len(cameras) + 1)),
        enough=enough,
        x=x,
        y=y,
        standing=standing,
    )


def _cameras_seeing(cameras: Sequence[CameraModel], x: Array, y: Array) -> npt.NDArray[np.int64]:
    """Return the number of cameras (levels, nx, ny) that see each point."""
    points = np.stack(np.meshgrid(LEVELS_M, x, y, indexing="ij"), axis=-1)[..., [1, 2, 0]]
    centre = np.array([x.mean(), y.mean(), 1.0])
    seeing = np.zeros(points.shape[:3], np.int64)
    for camera in cameras:
        pixels = camera.project(points)  # NaN: behind the camera, or beyond its lens
        inside = ((pixels > -0.5) & (pixels < [camera.width - 0.5, camera.height - 0.5])).all(axis=-1)
        reach_m = REACH * np.linalg.norm(camera.centre_world - centre)
        seeing += inside & (np.linalg.norm(points - camera.centre_world, axis=-1) < reach_m)
    return seeing


def _largest_piece(place: npt.NDArray[np.bool_]) -> npt.NDArray[np.bool_]:
    """Return the largest connected piece of (nx, ny)."""
    labels, pieces = ndimage.label(place)
    if pieces == 0:
        return place
    return labels == 1 + np.argmax(np.bincount(labels.ravel())[1:])


def _box(x: Array, y: Array, place: npt.NDArray[np.bool_]) -> Volume:
    (left, right), (front, back) = _extent(place.sum(axis=1)), _extent(place.sum(axis=0))
    low = np.array([x[left], y[front]]) - STEP_M / 2
    high = np.array([x[right], y[back]]) + STEP_M / 2
    short = np.maximum(MIN_SIDE_M - (high - low), 0.0) / 2
    low, high = np.round(low - short, 3), np.round(high + short, 3)
    return Volume(np.array([*low, -FLOOR_MARGIN_M]), np.array([*high, DEFAULT_HEIGHT_M]))


def _extent(counts: npt.NDArray[np.int64]) -> tuple[int, int]:
    """First and last of the cells that hold all of ``counts`` but the tips."""
    below = np.cumsum(counts)
    tip = TIP_SHARE * below[-1]
    return int(np.searchsorted(below, tip, side="right")), int(np.searchsorted(below, below[-1] - tip))


# --- Its figures.


@dataclass(frozen=True)
class CameraFigures:
    """Figures of one camera.

    detections : number in the solution. rms_px : of their corners' distances. mm_per_px : a pixel's width at the
    volume's centre. distance_m : from there. height_m : of the lens above the floor. sd_centre_mm, sd_rotation_deg :
    standard deviation, in the worst direction.
    """

    detections: int
    rms_px: float
    mm_per_px: float
    distance_m: float
    height_m: float
    sd_centre_mm: float
    sd_rotation_deg: float


def camera_figures(rig: Rig, solution: RigSolution) -> dict[str, CameraFigures]:
    """Compute the figures of all cameras, by name."""
    middle, figures = (rig.volume.low + rig.volume.high) / 2, {}
    for camera in rig.cameras:
        covariance, centre = solution.covariance[camera.name], camera.centre_world
        of_rotation, of_centre = (
            float(np.sqrt(max(np.linalg.eigvalsh(covariance[part, part])[-1], 0.0)))
            for part in (slice(0, 3), slice(3, 6))
        )
        figures[camera.name] = CameraFigures(
            detections=sum(detection.camera == camera.name for detection in solution.detections),
            rms_px=solution.rms_px[camera.name],
            mm_per_px=1e3 * pixel_width_m(camera, rig.volume),
            distance_m=float(np.linalg.norm(centre - middle)),
            height_m=float(centre[2]),
            sd_centre_mm=1e3 * of_centre,
            sd_rotation_deg=float(np.rad2deg(of_rotation)),
        )
    return figures
