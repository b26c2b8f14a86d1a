"""Measures how blurred a board is in an image, and how far it moves from one image to the next."""

from __future__ import annotations

import cv2
import numpy as np
import numpy.typing as npt

from .board import TargetDetection
from .corner_grid import steps
from .detector import as_grey
from .specification import MAX_CORNERS
from .x_corner import fit_x_corners

Array = npt.NDArray[np.float64]

CLEAR_OF_MARKERS = 0.12  # of a white field's side: a detection does not say whether its board has markers


def blur_px(image: npt.NDArray[np.uint8], detection: TargetDetection) -> float:
    """Measure the standard deviation of the blur across the board's edges, px: median over the corners, the worse of
    the two directions (motion blurs the edges that it crosses). About 0.3 for a sharp image; NaN when no corner can be
    fitted.

    ``image`` (H, W) or (H, W, 3): the one in which the detection was made.
    """
    along, down = neighbour_steps(detection)
    known = np.all(np.isfinite(np.hstack([along, down])), axis=1)
    places, steps_known = detection.pixels[known], (along[known], down[known])
    corners = fit_x_corners(as_grey(image), places, *steps_known, marker_margin=CLEAR_OF_MARKERS)
    fitted = corners.fit > 0.5
    return float(np.median(corners.blur_px[fitted], axis=0).max()) if fitted.any() else float("nan")


def neighbour_steps(detection: TargetDetection) -> tuple[Array, Array]:
    """Find for each corner of a detection the way to the next in its row and to the next row, (n, 2) each, NaN where no
    neighbour was seen."""
    columns = _columns(detection)
    row, column = np.divmod(detection.ids, columns)
    grid = np.full((row.max() + 1, columns, 2), np.nan)
    grid[row, column] = detection.pixels
    along, down = steps(grid)
    return along[row, column], down[row, column]


def _columns(detection: TargetDetection) -> int:
    """Corners in a row of the board: the number with which the ids, laid out in rows, look like a flat board most.

    A detection does not say of which board it is.
    """
    errors = {}
    for columns in range(2, MAX_CORNERS + 1):
        row, column = np.divmod(detection.ids, columns)
        if np.ptp(row) and np.ptp(column):
            flat = np.column_stack([column, row, column * row, np.ones(len(row))]).astype(float)
            solution = np.linalg.lstsq(flat, detection.pixels, rcond=None)[0]
            errors[columns] = float(np.mean((flat @ solution - detection.pixels) ** 2))
    return min(errors, key=lambda columns: errors[columns], default=MAX_CORNERS)


WINDOW_PX, LEVELS = 15, 3
TRACKED_SHARE = 0.5


def motion_px(image: np.ndarray, neighbour: np.ndarray, pixels: Array) -> float:
    """Measure the median distance that the corners ``pixels`` (n, 2) of ``image`` travel to the ``neighbour``, px.

    By optical flow (Lucas & Kanade 1981, pyramids); infinite when half of the corners cannot be found again.
    """
    images = [frame if frame.ndim == 2 else cv2.cvtColor(frame, cv2.COLOR_BGR2GRAY) for frame in (image, neighbour)]
    if images[0].shape != images[1].shape:
        return float("inf")
    corners = pixels.astype(np.float32).reshape(-1, 1, 2)
    first, second = images
    moved, found, _ = cv2.calcOpticalFlowPyrLK(
        first, second, corners, np.empty(0, np.float32), winSize=(WINDOW_PX, WINDOW_PX), maxLevel=LEVELS
    )
    seen = np.ravel(found) == 1
    if moved is None or seen.mean() < TRACKED_SHARE:
        return float("inf")
    return float(np.median(np.hypot(*(moved - corners).reshape(-1, 2)[seen].T)))
