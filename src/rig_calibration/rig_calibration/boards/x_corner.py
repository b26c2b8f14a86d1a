"""Fits the image of a checkerboard's corner: the crossing of two straight edges, the blur of each, and uncertainties.

The image near a corner is modelled as a plane of light plus the product of two blurred edges (error functions). The
model is symmetric about the corner like the image itself, so neither blur nor thick ink shifts the estimate, and the
window is the parallelogram that the neighbouring corners span, so that a board seen at a grazing angle (fields of 8 x 3
pixels) keeps all its pixels and no foreign ones.
"""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt

from capture_rig.kernel import njit
from capture_rig.lens import Array
from capture_rig.small_matrices import solve_positive

from .lattice import HALF

# --- The compiled part: one Levenberg-Marquardt fit, pixel by pixel.
#
# Parameters: x, y; directions of the edge along the row and of the edge along the column, rad; logarithms of the blur
# (sigma, px) across the edge along the column and across the one along the row; contrast; light and its two slopes.

# Thresholds: measured by python bench/calibration.py --boards (stated sigma against rms).
ROUNDING_VARIANCE = 1 / 12  # of a pixel's own width, px^2, and of rounding to whole grey levels
REACH = 0.7  # of a field, on each side of the corner
MAX_HALF_WINDOW_PX = 12
WINDOWS = 2  # number of times that the window may be re-centred on the estimate
SIZE = 10
X, Y, ALONG_ROW, ALONG_COLUMN, LOG_BLUR_U, LOG_BLUR_V, CONTRAST, LIGHT, LIGHT_X, LIGHT_Y = range(SIZE)
PRIOR_PRECISION = np.array([0, 0, 1 / 0.2**2, 1 / 0.2**2, 1 / 0.7**2, 1 / 0.7**2, 0, 0, 0, 0])
STEP_LIMIT = np.array([2.0, 2.0, 0.3, 0.3, 0.7, 0.7, 1e9, 1e9, 1e9, 1e9])
MAX_ITERATIONS = 12
MIN_LOG_BLUR = 0.5 * math.log(ROUNDING_VARIANCE)
MARKER_BLUR_PX = 1.5
CONVERGED_PX = 2e-3
FLAT = math.sqrt(2 / math.pi)
HALF_ROOT = math.sqrt(0.5)


@njit(cache=True)
def select_pixels(image, x, y, row_step, column_step, margin, pixels):
    """Fill ``pixels`` (m, 5) with dx, dy, grey, u, v of the window's pixels (offsets in pixels and in fields); the
    number of them. ``margin``: rim of white fields that no marker covers, over a field's side; 1 without markers."""
    height, width = image.shape
    area = row_step[0] * column_step[1] - row_step[1] * column_step[0]
    if not (math.isfinite(x) and math.isfinite(y)) or abs(area) < 1e-3:
        return 0
    half_x = min(math.ceil(REACH * (abs(row_step[0]) + abs(column_step[0]))), MAX_HALF_WINDOW_PX)
    half_y = min(math.ceil(REACH * (abs(row_step[1]) + abs(column_step[1]))), MAX_HALF_WINDOW_PX)
    count = 0
    for row in range(max(round(y) - half_y, 0), min(round(y) + half_y, height - 1) + 1):
        for column in range(max(round(x) - half_x, 0), min(round(x) + half_x, width - 1) + 1):
            dx, dy = column - x, row - y
            u = (dx * column_step[1] - dy * column_step[0]) / area
            v = (dy * row_step[0] - dx * row_step[1]) / area
            if abs(u) <= REACH and abs(v) <= REACH and count < len(pixels):
                pixels[count, 0], pixels[count, 1], pixels[count, 2] = dx, dy, image[row, column]
                pixels[count, 3], pixels[count, 4] = u, v
                count += 1
    if margin == 1:
        return count
    area = abs(area)
    across = area / math.hypot(column_step[0], column_step[1])
    return _without_markers(pixels, count, margin, across, area / math.hypot(row_step[0], row_step[1]))


@njit(cache=True)
def _without_markers(pixels, count, margin, across, down):
    """Drop the inside of the two white quadrants, those with the brighter rim, where markers may be, with their blur.
    ``across``, ``down``: of a field, px between its sides."""
    clear = margin - MARKER_BLUR_PX / min(across, down)
    clear = max(clear, 0.4 * margin)
    total, number = np.zeros(2), np.zeros(2)
    for k in range(count):
        u, v = pixels[k, 3], pixels[k, 4]
        if min(abs(u), abs(v)) < margin:
            total[int(u * v > 0)] += pixels[k, 2]
            number[int(u * v > 0)] += 1
    white = int(total[1] * max(number[0], 1) > total[0] * max(number[1], 1))
    kept = 0
    for k in range(count):
        u, v = pixels[k, 3], pixels[k, 4]
        if int(u * v > 0) != white or min(abs(u), abs(v)) < clear:
            pixels[kept] = pixels[k]
            kept += 1
    return kept


@njit(cache=True)
def quadrant_means(pixels, count, margin):
    """Mean grey of the four quadrants, clockwise from up-left in the board's sense, without the rims of the fields; NaN
    when empty."""
    total, number = np.zeros(4), np.zeros(4)
    rim_u = min(0.2 * np.max(np.abs(pixels[:count, 3])), 0.3 * margin)
    rim_v = min(0.2 * np.max(np.abs(pixels[:count, 4])), 0.3 * margin)
    for k in range(count):
        u, v = pixels[k, 3], pixels[k, 4]
        if abs(u) > rim_u and abs(v) > rim_v:
            quadrant = (0 if u < 0 else 1) if v < 0 else (3 if u < 0 else 2)
            total[quadrant] += pixels[k, 2]
            number[quadrant] += 1
    return total / np.where(number > 0, number, np.nan)


@njit(cache=True, fastmath=True)
def normal_equations(pixels, count, p, normal, gradient):
    """Sum the squares of model minus image; fill J^T J (lower half) and -J^T r."""
    normal[:], gradient[:] = 0.0, 0.0
    ca, sa, cb, sb = math.cos(p[2]), math.sin(p[2]), math.cos(p[3]), math.sin(p[3])
    blur_u, blur_v = math.exp(p[4]), math.exp(p[5])
    row = np.empty(SIZE)
    cost = 0.0
    for k in range(count):
        wx, wy = pixels[k, 0], pixels[k, 1]
        dx, dy = wx - p[0], wy - p[1]
        du, dv = sb * dx - cb * dy, ca * dy - sa * dx
        zu, zv = du / blur_u, dv / blur_v
        eu, ev = math.erf(zu * HALF_ROOT), math.erf(zv * HALF_ROOT)
        gu = p[6] * FLAT * math.exp(-0.5 * zu * zu) / blur_u * ev
        gv = p[6] * FLAT * math.exp(-0.5 * zv * zv) / blur_v * eu
        row[0], row[1] = gv * sa - gu * sb, gu * cb - gv * ca
        row[2], row[3] = -gv * (ca * dx + sa * dy), gu * (cb * dx + sb * dy)
        row[4], row[5] = -gu * du, -gv * dv
        row[6], row[7], row[8], row[9] = eu * ev, 1.0, wx, wy
        residual = p[7] + p[8] * wx + p[9] * wy + p[6] * eu * ev - pixels[k, 2]
        cost += residual * residual
        for i in range(SIZE):
            gradient[i] -= row[i] * residual
            for j in range(i + 1):
                normal[i, j] += row[i] * row[j]
    return cost


@njit(cache=True)
def fit_corner(pixels, count, p):
    """Fit by Levenberg-Marquardt from ``p`` (10,), changed in place: residual variance, grey levels squared, and the
    variance of the corner's coordinates, px^2 (mean of the two)."""
    start = p.copy()
    normal, gradient = np.empty((SIZE, SIZE)), np.empty(SIZE)
    trial_normal, trial_gradient = np.empty((SIZE, SIZE)), np.empty(SIZE)
    work, step = np.empty((SIZE, SIZE)), np.empty(SIZE)
    cost = normal_equations(pixels, count, p, normal, gradient)
    damping = 1e-3
    for _ in range(MAX_ITERATIONS):
        variance = cost / max(count - SIZE, 1) + ROUNDING_VARIANCE
        work[:] = normal
        for i in range(SIZE):
            prior = variance * PRIOR_PRECISION[i]
            work[i, i] = (normal[i, i] + prior) * (1 + damping) + 1e-9
            trial_gradient[i] = gradient[i] - prior * (p[i] - start[i])
        if not solve_positive(work, trial_gradient, work, step):
            break
        trial = p + np.minimum(np.maximum(step, -STEP_LIMIT), STEP_LIMIT)
        trial[LOG_BLUR_U], trial[LOG_BLUR_V] = (
            max(trial[LOG_BLUR_U], MIN_LOG_BLUR),
            max(trial[LOG_BLUR_V], MIN_LOG_BLUR),
        )
        trial_cost = normal_equations(pixels, count, trial, trial_normal, trial_gradient)
        before = cost + variance * np.sum(PRIOR_PRECISION * (p - start) ** 2)
        if trial_cost + variance * np.sum(PRIOR_PRECISION * (trial - start) ** 2) <= before:
            p[:], cost = trial, trial_cost
            normal[:], gradient[:] = trial_normal, trial_gradient
            damping *= 0.2
            if math.hypot(step[0], step[1]) < CONVERGED_PX:
                break
        else:
            damping *= 10
            if damping > 1e4:
                break
    variance = cost / max(count - SIZE, 1) + ROUNDING_VARIANCE
    return variance, _position_variance(normal, variance)


@njit(cache=True)
def _position_variance(normal, variance):
    total, step, unit = 0.0, np.empty(SIZE), np.zeros(SIZE)
    for axis in range(2):
        work = normal.copy()
        for i in range(SIZE):
            work[i, i] += variance * PRIOR_PRECISION[i] + 1e-9
        unit[:] = 0.0
        unit[axis] = 1.0
        if not solve_positive(work, unit, work, step):
            return np.inf
        total += 0.5 * step[axis] * variance
    return total


@njit(cache=True)
def fit_corners(image, start, row_steps, column_steps, margin, result, means):
    """Fit every corner; ``result`` (n, 13): parameters with x, y in the image, residual variance, variance of the
    position, variance of the window's grey levels (0 where the window holds too few pixels); ``means`` (n, 4)."""
    pixels = np.empty(((2 * MAX_HALF_WINDOW_PX + 1) ** 2, 5))
    for n in range(len(start)):
        p = result[n, :SIZE]
        p[ALONG_ROW] = math.atan2(row_steps[n, 1], row_steps[n, 0])
        p[ALONG_COLUMN] = math.atan2(column_steps[n, 1], column_steps[n, 0])
        x, y = start[n, 0], start[n, 1]
        result[n, 10:] = 0.0
        for again in range(WINDOWS):
            count = select_pixels(image, x, y, row_steps[n], column_steps[n], margin, pixels)
            if count < 2 * SIZE:
                result[n, 12] = 0.0
                break
            means[n] = quadrant_means(pixels, count, margin)
            if again == 0 and not _may_be_corner(means[n]):
                break
            p[X], p[Y] = 0.0, 0.0
            if again == 0:
                _start_light(pixels, count, means[n], p)
            result[n, 10], result[n, 11] = fit_corner(pixels, count, p)
            result[n, 12] = np.var(pixels[:count, 2])
            moved = math.hypot(p[X], p[Y])
            x, y = x + p[X], y + p[Y]
            if moved < 0.3:
                break
        p[X], p[Y] = x, y


@njit(cache=True)
def _may_be_corner(means):
    """Opposite quadrants are more alike than neighbouring ones, roughly: the place is not yet exact."""
    a, b, c, d = means
    return not abs(a + c - b - d) < 0.8 * max(abs(a - c), abs(b - d))


@njit(cache=True)
def _start_light(pixels, count, means, p):
    p[LOG_BLUR_U], p[LOG_BLUR_V] = math.log(0.8), math.log(0.8)
    p[LIGHT] = np.mean(pixels[:count, 2])
    p[LIGHT_X], p[LIGHT_Y] = 0.0, 0.0
    contrast = 0.25 * (means[0] + means[2] - means[1] - means[3])
    p[CONTRAST] = contrast if math.isfinite(contrast) else 0.0


def fit_x_corners(
    image: npt.NDArray[np.uint8], pixels: Array, row_step: Array, column_step: Array, *, marker_margin: float = 1.0
) -> tuple[Array, npt.NDArray[np.bool_]]:
    """Refine corners near ``pixels`` (n, 2) in a grey image (H, W); whether (n,) the model explains each.

    ``row_step``, ``column_step`` (n, 2): from the corner to the next in its row, and to the next row, pixels; the two
    must form a right-handed pair (x right, y down). ``marker_margin``: width of the rim of a white field that no marker
    covers, over the field's side (ChArUco).

    Returns (n, 6): place (2), pixel centres at whole numbers; half the grey step, negative where the field towards the
    start of row and column (up-left) is black; standard deviation of a coordinate, px, from the fit's own residual;
    sigma of the blur, px, across the edge that the row crosses, and across the one along the row, the width of a pixel
    taken off. Explained are corners inside the image whose model takes up most of the window's variance, and whose
    opposite quadrants are more alike than neighbouring ones (unlike the corner of a single black field).
    """
    start, along, down = (np.ascontiguousarray(each, float).reshape(-1, 2) for each in (pixels, row_step, column_step))
    result, means = np.zeros((len(start), SIZE + 3)), np.zeros((len(start), 4))
    fit_corners(np.ascontiguousarray(image), start, along, down, float(marker_margin), result, means)
    unexplained, position_variance, total = result[:, SIZE], result[:, SIZE + 1], result[:, SIZE + 2]
    blur = np.sqrt(np.maximum(np.exp(2 * result[:, [LOG_BLUR_U, LOG_BLUR_V]]) - ROUNDING_VARIANCE, 0.0))
    first, second = means[:, [0, 2]], means[:, [1, 3]]
    step = np.abs(first.mean(1) - second.mean(1))  # of the quadrants' means; NaN where one is empty
    gap = np.maximum(first.min(1) - second.max(1), second.min(1) - first.max(1))
    explained = (total > 0) & (unexplained < (1 - HALF) * total) & (gap > HALF * np.maximum(step, 1e-9))
    return np.column_stack([result[:, :2], result[:, CONTRAST], np.sqrt(position_variance), blur]), explained
