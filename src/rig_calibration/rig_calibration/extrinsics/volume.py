"""The common volume: where enough cameras see a person for a hull (thesis 3.1), and the box around it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy import ndimage

from capture_rig.camera import CameraModel
from capture_rig.rig import DEFAULT_HEIGHT_M, FLOOR_MARGIN_M, Volume, default_volume

Array = npt.NDArray[np.float64]

ENOUGH_CAMERAS = 3
"""Two outlines leave a hull far fatter than the body."""
STEP_M = 0.1
LEVELS_M = np.arange(0.15, DEFAULT_HEIGHT_M, 0.25)
"""Heights at which a place on the floor is asked who sees it."""
BODY_TOP_M = 1.7
"""A person can be tracked at a place where enough cameras see every height up to this."""
REACH = 2.0
"""A camera counts up to so many times its distance from the rig's centre; beyond, its pixels are too coarse."""
LEAST_DISTANCE_M = 0.3
LEAST_SIDE_M, MOST_SIDE_M = 1.0, 8.0
TIP_SHARE = 0.02
"""Of the places, so many may lie outside the box on each side: the tips of a star are not worth their voxels."""


@dataclass(frozen=True, eq=False)
class CommonVolume:
    """What the cameras see in common.

    box : axis-aligned, from just below the floor to 2.4 m above it: the bounding box of the places where a person can
    be tracked, or of what is watched at breast height where there is no such place. usable : was there one?
    volume_m3 : of all that enough cameras see up to 2.4 m. floor_m2 : by number of cameras (1 to all), the floor area
    where at least so many see a standing person. enough : how many cameras are enough. standing (nx, ny) : how many
    cameras see a person who stands at x (nx,), y (ny,).
    """

    box: Volume
    usable: bool
    volume_m3: float
    floor_m2: tuple[float, ...]
    enough: int
    x: Array
    y: Array
    standing: npt.NDArray[np.int64]


def common_volume(cameras: Sequence[CameraModel]) -> CommonVolume:
    """Where at least three cameras see (all, of fewer), on a grid of 0.1 m around the point that their axes meet."""
    enough = min(ENOUGH_CAMERAS, len(cameras))
    x, y = _floor_grid(cameras)
    seeing = _cameras_seeing(cameras, x, y)  # (levels, nx, ny)
    standing = seeing[LEVELS_M <= BODY_TOP_M].min(axis=0)
    place = _largest_piece(standing >= enough)
    usable = bool(place.any())
    if not usable:
        place = _largest_piece(seeing[np.searchsorted(LEVELS_M, 1.0)] >= enough)
    box = _box(x, y, place) if place.any() else default_volume(tuple(cameras))
    cell_m3 = STEP_M**2 * float(LEVELS_M[1] - LEVELS_M[0])
    return CommonVolume(
        box=box,
        usable=usable,
        volume_m3=float((seeing >= enough).sum() * cell_m3),
        floor_m2=tuple(float((standing >= n).sum() * STEP_M**2) for n in range(1, len(cameras) + 1)),
        enough=enough,
        x=x,
        y=y,
        standing=standing,
    )


def centre_of(volume: Volume) -> Array:
    """(3,) the middle of the box, world."""
    return (volume.low + volume.high) / 2


def _floor_grid(cameras: Sequence[CameraModel]) -> tuple[Array, Array]:
    """Coordinates x (nx,) and y (ny,) of the columns that are asked, whole multiples of the step."""
    box = default_volume(tuple(cameras))
    middle = np.round((box.low + box.high)[:2] / 2 / STEP_M) * STEP_M
    offsets = np.arange(-MOST_SIDE_M / 2, MOST_SIDE_M / 2 + STEP_M / 2, STEP_M)
    return middle[0] + offsets, middle[1] + offsets


def _cameras_seeing(cameras: Sequence[CameraModel], x: Array, y: Array) -> npt.NDArray[np.int64]:
    """(levels, nx, ny) how many cameras see each point."""
    points = np.stack(np.meshgrid(LEVELS_M, x, y, indexing="ij"), axis=-1)[..., [1, 2, 0]]
    centre = np.array([x.mean(), y.mean(), 1.0])
    seeing = np.zeros(points.shape[:3], np.int64)
    for camera in cameras:
        seeing += _sees(camera, points, REACH * float(np.linalg.norm(camera.centre_world - centre)))
    return seeing


def _sees(camera: CameraModel, points_world: Array, reach_m: float) -> npt.NDArray[np.bool_]:
    pixels = camera.project(points_world)
    distance = np.linalg.norm(points_world - camera.centre_world, axis=-1)
    with np.errstate(invalid="ignore"):  # NaN: behind the camera, or beyond its lens
        inside = (pixels > -0.5).all(axis=-1) & (pixels < [camera.width - 0.5, camera.height - 0.5]).all(axis=-1)
    return inside & (distance > LEAST_DISTANCE_M) & (distance < reach_m)


def _largest_piece(place: npt.NDArray[np.bool_]) -> npt.NDArray[np.bool_]:
    """The largest connected piece of (nx, ny)."""
    labels, pieces = ndimage.label(place)
    if pieces == 0:
        return place
    return labels == 1 + np.argmax(np.bincount(labels.ravel())[1:])


def _box(x: Array, y: Array, place: npt.NDArray[np.bool_]) -> Volume:
    (left, right), (front, back) = _extent(place.sum(axis=1)), _extent(place.sum(axis=0))
    low = np.array([x[left], y[front]]) - STEP_M / 2
    high = np.array([x[right], y[back]]) + STEP_M / 2
    short = np.maximum(LEAST_SIDE_M - (high - low), 0.0) / 2
    low, high = np.round(low - short, 3), np.round(high + short, 3)
    return Volume(np.array([*low, -FLOOR_MARGIN_M]), np.array([*high, DEFAULT_HEIGHT_M]))


def _extent(counts: npt.NDArray[np.int64]) -> tuple[int, int]:
    """First and last of the cells that hold all of ``counts`` but the tips."""
    below = np.cumsum(counts)
    tip = TIP_SHARE * below[-1]
    return int(np.searchsorted(below, tip, side="right")), int(np.searchsorted(below, below[-1] - tip))
