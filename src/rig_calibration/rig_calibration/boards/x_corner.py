"""Fits the image of a checkerboard's corner: where two straight edges cross, how blurred each is, how sure all that is.

The image near a corner is modelled as a plane of light plus the product of two blurred edges (error functions). The
model is symmetric about the corner like the image itself, so neither blur nor thick ink shifts the estimate, and the
window is the parallelogram that the neighbouring corners span, so that a board seen at a grazing angle (fields of 8 x 3
pixels) keeps all its pixels and no foreign ones.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from .x_corner_kernel import LOG_BLUR_U, LOG_BLUR_V, SIZE, fit_corners

Array = npt.NDArray[np.float64]

REACH = 0.7  # of a field, on each side of the corner
MAX_HALF_WINDOW_PX = 12
PIXEL_VARIANCE = 1 / 12  # of a pixel's own width, px^2


@dataclass(frozen=True, eq=False)
class XCorners:
    """n fitted corners, in the order given.

    pixels (n, 2) : pixel centres at whole numbers. sd_px (n,) : standard deviation of a coordinate, from the fit's own
    residual. contrast (n,) : half the grey step, negative where the field towards the start of row and column (up-left)
    is black. blur_px (n, 2) : sigma of the blur across the edge that the row crosses, and across the one along the row;
    the width of a pixel taken off. fit (n,) : share of the window's variance that the model explains, 0..1; 0 for
    corners outside the image. likeness (n,) : 1 where opposite quadrants are equally bright, 0 or less where they
    differ as much as neighbouring ones (the corner of a single black field).
    """

    pixels: Array
    sd_px: Array
    contrast: Array
    blur_px: Array
    fit: Array
    likeness: Array


def fit_x_corners(
    image: npt.NDArray[np.uint8],
    pixels: Array,
    row_step: Array,
    column_step: Array,
    *,
    marker_margin: float = 1.0,
    rounds: int = 2,
    max_half_window_px: int = MAX_HALF_WINDOW_PX,
) -> XCorners:
    """Refine corners near ``pixels`` (n, 2) in a grey image (H, W).

    ``row_step``, ``column_step`` (n, 2): from the corner to the next in its row, and to the next row, pixels; the two
    must form a right-handed pair (x right, y down). ``marker_margin``: width of the rim of a white field that no marker
    covers, over the field's side (ChArUco). ``rounds``: how often the window may be laid anew around the estimate.
    """
    start, along, down = (np.ascontiguousarray(each, float).reshape(-1, 2) for each in (pixels, row_step, column_step))
    result, means = np.zeros((len(start), SIZE + 3)), np.zeros((len(start), 4))
    grey = np.ascontiguousarray(image)
    fit_corners(grey, start, along, down, REACH, float(marker_margin), int(max_half_window_px), rounds, result, means)
    unexplained, position_variance, total = result[:, SIZE], result[:, SIZE + 1], result[:, SIZE + 2]
    blur = np.exp(2 * result[:, [LOG_BLUR_U, LOG_BLUR_V]]) - PIXEL_VARIANCE
    return XCorners(
        pixels=result[:, :2].copy(),
        sd_px=np.sqrt(position_variance),
        contrast=result[:, 6].copy(),
        blur_px=np.sqrt(np.maximum(blur, 0.0)),
        fit=np.where(total > 0, 1 - unexplained / np.maximum(total, 1e-9), 0.0).clip(0, 1),
        likeness=_likeness(means),
    )


def _likeness(means: Array) -> Array:
    """The smallest step between neighbouring quadrants' means, over the mean step."""
    first, second = means[:, [0, 2]], means[:, [1, 3]]
    step = np.abs(first.mean(1) - second.mean(1))
    gap = np.maximum(first.min(1) - second.max(1), second.min(1) - first.max(1))
    return np.nan_to_num(gap / np.maximum(step, 1e-9), nan=-1.0)
