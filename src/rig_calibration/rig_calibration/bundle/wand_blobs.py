"""Bright markers in an image: light-emitting diodes, retro-reflective balls."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
import numpy.typing as npt

from capture_rig.errors import InputError

from .rigid import Array

LEAST_CONTRAST = 30.0  # grey levels of a marker's peak above what surrounds it
PEAK_SHARE = 0.4  # of the brightest marker: what is brighter than that belongs to a marker
MIN_AREA_PX, MAX_AREA_SHARE = 2, 0.01  # of the image
LONGEST = 4.0  # length over width: a longer streak is a reflection or moved while exposed
RIM_PX = 2  # around the thresholded blob, whose soft edge counts too
CENTROID_SIGMA_PX = 0.1


@dataclass(frozen=True, eq=False)
class Blobs:
    """Bright spots: centroid (n, 2), pixel centres at whole numbers; area_px (n,); brightness (n,) summed grey levels;
    brightest first."""

    centroid: Array
    area_px: Array
    brightness: Array

    def __len__(self) -> int:
        return len(self.centroid)


def find_blobs(image: np.ndarray, background: np.ndarray | None = None) -> Blobs:
    """Compact spots in an image (H, W[, 3]) uint8 that are brighter than their surroundings, to a tenth of a pixel.

    ``background``: the same view without the wand; without it, what is larger than a marker is taken for background.
    Centroids are weighted by brightness. Raises InputError when ``background`` is of another size.
    """
    bright = _above(_grey(image), None if background is None else _grey(background))
    peak = float(bright.max(initial=0.0))
    if peak < LEAST_CONTRAST:
        return Blobs(np.empty((0, 2)), np.empty(0), np.empty(0))
    mask = (bright > max(PEAK_SHARE * peak, LEAST_CONTRAST / 2)).astype(np.uint8)
    count, _, boxes, _ = cv2.connectedComponentsWithStats(mask)
    found = [_measure(bright, boxes[i]) for i in range(1, count) if _compact(boxes[i], mask.size)]
    found.sort(key=lambda blob: -blob[3])
    columns = np.array(found, float).reshape(-1, 4)
    return Blobs(columns[:, :2], columns[:, 2], columns[:, 3])


def _grey(image: np.ndarray) -> npt.NDArray[np.uint8]:
    grey = image if image.ndim == 2 else image.max(axis=2)  # markers may be of any colour
    if grey.dtype != np.uint8:
        raise InputError(f"an image of {grey.dtype} was given", remedy="Give 8-bit images.")
    return np.ascontiguousarray(grey)


def _above(grey: npt.NDArray[np.uint8], background: npt.NDArray[np.uint8] | None) -> npt.NDArray[np.float32]:
    """How much brighter than the surroundings, grey levels, noise of the surroundings taken off."""
    behind = background
    if behind is None:
        side = 2 * (max(grey.shape) // 50) + 1
        round_ = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (side, side))
        behind = cv2.morphologyEx(grey, cv2.MORPH_OPEN, round_).astype(np.uint8)
    elif behind.shape != grey.shape:
        raise InputError(
            f"the background has {behind.shape[1]} x {behind.shape[0]} pixels, the image "
            f"{grey.shape[1]} x {grey.shape[0]}",
            remedy="Take both with the same camera settings.",
        )
    difference = cv2.subtract(grey, behind).astype(np.float32)
    return np.maximum(difference - 2 * np.median(difference), 0)


def _compact(box: np.ndarray, image_px: int) -> bool:
    _, _, width, height, area = box
    return bool(
        MIN_AREA_PX <= area <= MAX_AREA_SHARE * image_px
        and max(width, height) <= LONGEST * min(width, height)
        and area > 0.3 * width * height
    )


def _measure(bright: npt.NDArray[np.float32], box: np.ndarray) -> tuple[float, float, float, float]:
    x, y, width, height, area = (int(v) for v in box)
    left, top = max(x - RIM_PX, 0), max(y - RIM_PX, 0)
    patch = bright[top : y + height + RIM_PX, left : x + width + RIM_PX].astype(float)
    total = patch.sum()
    rows, columns = np.mgrid[: patch.shape[0], : patch.shape[1]]
    return left + (patch * columns).sum() / total, top + (patch * rows).sum() / total, area, total
