"""The region of a camera's sensor that a capture volume needs, and the camera of the pictures of a region.

Rows and columns that no point of the volume projects to need not be sent, nor pixels that are finer than the hull.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from .camera import CameraModel
from .lens import Array
from .rig import Volume

MOST_PIXEL_M = 0.012  # two pixels to a voxel of the hull, nearly: finer ones add nothing inside of an outline
# Thresholds: STEP_PX from sensors, whose regions begin and end at multiples of 16 pixels at the coarsest.
STEP_PX = 16
SPARE = 0.012  # of the picture's width around the volume: as far as a client follows a camera that was touched


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
    """Return the smallest region whose pixels' rays meet the volume, with some spare; the whole picture when none do.

    The binning is the largest that leaves pixels no wider than MOST_PIXEL_M in the middle of the volume: the hull loses
    nothing, but outlines are placed within such a pixel, and no longer within a finer one.
    """
    binning = max(int(MOST_PIXEL_M / pixel_width_m(camera, volume)), 1)
    x, y = (np.unique(np.append(np.arange(0, n, STEP_PX // 4), n - 1)) for n in (camera.width, camera.height))
    rays = camera.rays_world(np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2))
    meets = _meets(camera.centre_world, rays, volume).reshape(len(y), len(x))
    (offset_x, width), (offset_y, height) = (
        _side(places[meets.any(axis=axis)], n, SPARE * camera.width, binning)
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
    """Return offset and size, in binned pixels, of what holds the ``needed`` pixels of a side of ``size`` pixels."""
    if not len(needed):
        return 0, size // binning
    low = max(int((needed[0] - spare_px) / binning) // STEP_PX * STEP_PX, 0)
    high = -(-int(np.ceil((needed[-1] + 1 + spare_px) / binning)) // STEP_PX) * STEP_PX
    return low, min(high, size // binning) - low
