"""Visibility of the capture volume: which cameras see a place, where enough do for a hull, which part of a sensor it
needs.

Outside of it a hull is empty although a body may continue there: the body is unknown there, not absent.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from .camera import CameraModel
from .kernel import kernel, njit
from .rig import Rig, Volume

Array = npt.NDArray[np.float64]
Flags = npt.NDArray[np.bool_]

CELL_M = 0.05  # of the map of places: three voxels, a third of a limb


def min_seeing(cameras: int, requested: int = 0) -> int:
    """Return the number of cameras that must see an occupied voxel, when ``cameras`` delivered a silhouette.

    By the rig (``requested`` = 0): three fifths of the cameras, rounded up, but at least three and at most all:
    3 of 3, 3 of 4, 3 of 5, 4 of 6, 5 of 7, 5 of 8. A requested number is lowered to the number of cameras. Never
    below two: the cone of a single silhouette is no hull, so with one camera nothing is occupied.
    """
    wanted = requested if requested > 0 else max(3, -(-3 * cameras // 5))
    return max(2, min(wanted, cameras))


class UnseenCells(NamedTuple):
    """A map of the cells (x, y, z) bool, CELL_M wide, in which some place is not seen by enough cameras.

    low (3,) m : corner of the first cell, world. Places beside or above the map are unseen too; below it is the floor,
    where no body is. A map without cells stands for an unknown rig: nothing is unseen.
    """

    low: Array
    unseen: Flags

    def at(self, points_world: Array) -> Flags:
        """Return which of the points (n, 3), metres, are in unseen cells."""
        found = np.empty(len(points_world), np.bool_)
        _read_cells(self, np.ascontiguousarray(points_world, np.float64), found)
        return found

    def rows_outside(self, points_world: Array) -> npt.NDArray[np.int64]:
        """Return the numbers of the points (n, 3), metres, that are in no unseen cell."""
        rows: npt.NDArray[np.int64] = _seen_rows(self, np.ascontiguousarray(points_world, np.float64))
        return rows

    def widened(self) -> UnseenCells:
        """Return the map with the neighbours of unseen cells unseen too, for measurements that extend over a cell."""
        if self.unseen.size == 0:
            return self
        wide = np.pad(self.unseen, ((1, 1), (1, 1), (0, 1)), constant_values=True)
        wide = np.pad(wide, ((0, 0), (0, 0), (1, 0)), constant_values=False)  # under the floor is no body
        for axis in range(3):
            first, middle, last = (np.take(wide, range(k, wide.shape[axis] - 2 + k), axis) for k in range(3))
            wide = first | middle | last
        return UnseenCells(self.low, wide)


@kernel
def is_unseen(cells, x, y, z):
    """Return whether a point of the world, metres, lies in an unseen cell of an :class:`UnseenCells`."""
    unseen = cells.unseen
    a, b = (x - cells.low[0]) / CELL_M, (y - cells.low[1]) / CELL_M
    c = (z - cells.low[2]) / CELL_M
    if unseen.shape[0] == 0 or c < 0.0:
        return False
    if a < 0.0 or b < 0.0 or a >= unseen.shape[0] or b >= unseen.shape[1] or c >= unseen.shape[2]:
        return True
    return unseen[int(a), int(b), int(c)]


@kernel
def _read_cells(cells, points, found):
    for n in range(points.shape[0]):
        found[n] = is_unseen(cells, points[n, 0], points[n, 1], points[n, 2])


@njit(cache=True, nogil=True)
def _seen_rows(cells, points):
    """Return the numbers of the points (n, 3) that are in no unseen cell."""
    rows, count = np.empty(points.shape[0], np.int64), 0
    for n in range(points.shape[0]):
        rows[count] = n
        count += not is_unseen(cells, points[n, 0], points[n, 1], points[n, 2])
    return rows[:count]


EVERYWHERE = UnseenCells(np.zeros(3), np.zeros((0, 0, 0), np.bool_))
"""The map of a rig that is not known."""


class RigVisibility:
    """What each camera of a rig sees of space, and where enough of them do. Points (n, 3) world frame, metres."""

    def __init__(self, rig: Rig, requested_seeing: int = 0) -> None:
        """``requested_seeing`` is the hull's setting ``min_seeing``."""
        self.rig, self.names, self.volume = rig, rig.names, rig.volume
        self.needed = min_seeing(len(rig.cameras), requested_seeing)
        self._views = [camera.undistorted_view() for camera in rig.cameras]

    def seen_by(self, points_world: Array) -> Flags:
        """Return which cameras (n, N) see the points: by the carver's rule, the pixel that the place projects to."""
        points_world = np.ascontiguousarray(points_world, np.float64)
        seen = np.empty((len(self._views), len(points_world)), np.bool_)
        for view, seen_by_it in zip(self._views, seen, strict=True):
            _seen_pixels(view.camera.P, view.seen, points_world, seen_by_it)
        return seen.T

    def in_volume(self, points_world: Array) -> Flags:
        """Return which points lie inside the volume's walls and ceiling (its floor counts as below everything)."""
        low, high = self.volume.low, self.volume.high
        x, y, z = points_world.T
        inside: Flags = (x >= low[0]) & (x <= high[0]) & (y >= low[1]) & (y <= high[1]) & (z <= high[2])
        return inside

    def shows(self, points_world: Array) -> Flags:
        """Return which points (n,) a hull would show: inside the volume and seen by enough cameras."""
        enough: Flags = self.in_volume(points_world) & (self.seen_by(points_world).sum(axis=1) >= self.needed)
        return enough

    @cached_property
    def unseen_cells(self) -> UnseenCells:
        """The map of the volume's places that are not shown; computed once, in a tenth of a second a camera or less."""
        low, high = self.volume.low, self.volume.high
        size = np.ceil((high - low) / CELL_M).astype(int)
        axes = [low[k] + CELL_M * np.arange(size[k] + 1) for k in range(3)]
        corners = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
        shown = (self.seen_by(corners).sum(axis=1) >= self.needed).reshape(*(size + 1))
        for axis in range(3):  # a cell is seen when all its corners are
            count = shown.shape[axis]
            shown = np.take(shown, range(count - 1), axis) & np.take(shown, range(1, count), axis)
        return UnseenCells(low, ~shown)

    @cached_property
    def near_unseen(self) -> UnseenCells:
        """The same with their neighbours, for measurements that extend over a cell."""
        return self.unseen_cells.widened()


@kernel
def _seen_pixels(P, seen, points, found):
    """found (n,) <- whether the pixel that each point (n, 3) projects to by P (3, 4) is one that a camera has seen."""
    height, width = seen.shape
    for n in range(points.shape[0]):
        x, y, z = points[n, 0], points[n, 1], points[n, 2]
        depth = P[2, 0] * x + P[2, 1] * y + P[2, 2] * z + P[2, 3]
        u = (P[0, 0] * x + P[0, 1] * y + P[0, 2] * z + P[0, 3]) / depth
        v = (P[1, 0] * x + P[1, 1] * y + P[1, 2] * z + P[1, 3]) / depth
        inside = depth > 0.0 and -0.5 <= u < width - 0.5 and -0.5 <= v < height - 0.5
        found[n] = inside and seen[int(v + 0.5), int(u + 0.5)]


# --- The region of a camera's sensor that a volume needs, and the camera of the pictures of a region.
#
# Rows and columns that no point of the volume projects to need not be sent, nor pixels that are finer than the hull.

MOST_PIXEL_M = 0.012  # two pixels to a voxel of the hull, nearly: finer ones add nothing inside of an outline
# Thresholds: STEP_PX from sensors, whose regions begin and end at multiples of 16 pixels at the coarsest.
STEP_PX = 16
MOST_FOLLOWED_SHARE = 0.012  # of its width: largest displacement of a touched camera that a client compensates


@dataclass(frozen=True)
class Region:
    """A part of the sensor, as the client's settings ``aravis`` name it: ``binning`` pixels of the sensor are one in
    each direction, and the other numbers count those, from the upper left corner."""

    binning: int
    offset_x: int
    offset_y: int
    width: int
    height: int


def pixel_width_m(camera: CameraModel, volume: Volume) -> float:
    """Return the width of a pixel's ray in the middle of the volume, metres."""
    apart_m = np.linalg.norm(camera.centre_world - (np.asarray(volume.low) + np.asarray(volume.high)) / 2)
    return float(apart_m / camera.K[0, 0])


def of_region(camera: CameraModel, region: Region) -> CameraModel:
    """Return the camera whose pictures are a region of the given one's."""
    K = camera.K.copy()
    K[:2] /= region.binning
    K[:2, 2] += (1 / region.binning - 1) / 2  # pixels are counted from the middle of the first one
    K[:2, 2] -= [region.offset_x, region.offset_y]
    return replace(camera, width=region.width, height=region.height, K=K)


def of_shape(camera: CameraModel, shape: tuple[int, ...]) -> CameraModel:
    """Return the camera whose pictures have a shape (H, W[, 3]): the given one, or it at half of its size."""
    half = Region(2, 0, 0, -(-camera.width // 2), -(-camera.height // 2))
    return of_region(camera, half) if shape[:2] == (half.height, half.width) else camera


def may_be_halved(camera: CameraModel | None, volume: Volume | None) -> bool:
    """Return whether pictures at half of the size are as fine as the hull needs them; not where that is unknown."""
    return camera is not None and volume is not None and 2 * pixel_width_m(camera, volume) <= MOST_PIXEL_M


def needed_region(camera: CameraModel, volume: Volume) -> Region:
    """Return the smallest region whose pixels' rays meet the volume, with a margin; the whole picture when none do.

    The binning is the largest that leaves pixels no wider than MOST_PIXEL_M in the middle of the volume: the hull loses
    nothing, but outlines are located to within such a pixel only.
    """
    binning = max(int(MOST_PIXEL_M / pixel_width_m(camera, volume)), 1)
    x, y = (np.unique(np.append(np.arange(0, n, STEP_PX // 4), n - 1)) for n in (camera.width, camera.height))
    rays = camera.rays_world(np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2))
    meets = _meets(camera.centre_world, rays, volume).reshape(len(y), len(x))
    (offset_x, width), (offset_y, height) = (
        _side(places[meets.any(axis=axis)], n, MOST_FOLLOWED_SHARE * camera.width, binning)
        for places, n, axis in ((x, camera.width, 0), (y, camera.height, 1))
    )
    return Region(binning, offset_x, offset_y, width, height)


def _meets(centre_world: Array, rays_world: Array, volume: Volume) -> Array:
    """Return whether rays (n, 3) from a centre meet the box (Kay and Kajiya 1986); those that are NaN do not."""
    with np.errstate(divide="ignore", invalid="ignore"):
        to_low, to_high = ((side - centre_world) / rays_world for side in (volume.low, volume.high))
    enters, leaves = np.minimum(to_low, to_high).max(axis=1), np.maximum(to_low, to_high).min(axis=1)
    return np.asarray((leaves >= 0) & (enters <= leaves))


def _side(needed: Array, size: int, spare_px: float, binning: int) -> tuple[int, int]:
    """Return offset and size, in binned pixels, of the range that holds the ``needed`` of a side's ``size`` pixels."""
    if not len(needed):
        return 0, size // binning
    low = max(int((needed[0] - spare_px) / binning) // STEP_PX * STEP_PX, 0)
    high = -(-int(np.ceil((needed[-1] + 1 + spare_px) / binning)) // STEP_PX) * STEP_PX
    return low, min(high, size // binning) - low
