"""Draws flat prints and glowing balls: what share of each pixel they cover, and how bright it is there.

Pixels that lie on one field, or beside the print, take one look-up; those on an edge are sampled. ``ideal``
(h + 1, w + 1, 2) are the normalised undistorted image coordinates of the pixels' corners.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from capture_rig.kernel import njit

Array = NDArray[np.float64]

REACH = 0.6
"""Of the pixel's size, from its middle to its sides: half, and some for the map's curvature."""
ROUNDING_TEXELS = 0.5


def sample_offsets(count: int) -> Array:
    """Returns (count, 2) places in a pixel, 0..1, evenly spread; ``count`` is even.

    Half of them follow Roberts' R2 sequence, the others mirror them at the pixel's centre: their mean is exactly the
    centre, so that nothing drawn with them is displaced.
    """
    steps = np.arange(1, count // 2 + 1)[:, None] * np.array([0.7548776662466927, 0.5698402909980532])
    half = (0.5 + steps) % 1.0
    return np.stack([half, 1.0 - half], axis=1).reshape(-1, 2)


@njit(cache=True, nogil=True)
def _texel(h, x, y):
    """Column, row (real numbers) and inverse depth of the print's point on the ray (x, y, 1); NaN behind the camera."""
    w = h[2, 0] * x + h[2, 1] * y + h[2, 2]
    if w <= 0.0:
        return math.nan, math.nan, 0.0
    depth = 1.0 / w
    u = (h[0, 0] * x + h[0, 1] * y + h[0, 2]) * depth
    v = (h[1, 0] * x + h[1, 1] * y + h[1, 2]) * depth
    return u, v, w


@njit(cache=True, nogil=True)
def _reach(h, corners, u, v, w):
    """Greatest distance, texels, of a pixel's outline from its middle (u, v) on the print."""
    reach, depth = ROUNDING_TEXELS, REACH / w
    for k in range(1, 3):  # to the pixel's sides: half a pixel along its columns, and along its rows
        dx, dy = corners[k, 0] - corners[0, 0], corners[k, 1] - corners[0, 1]
        along = h[2, 0] * dx + h[2, 1] * dy
        reach += abs(h[0, 0] * dx + h[0, 1] * dy - u * along) * depth
        reach += abs(h[1, 0] * dx + h[1, 1] * dy - v * along) * depth
    return reach


@njit(cache=True, nogil=True)
def cast_board(ideal, homographies, greys, texture, edge_distance, offsets, box, depth, light):
    """Draws a print into the light (h, w) of one camera, in place.

    homographies (K, 3, 3): from ideal image coordinates to texels, one for each instant of the exposure, of which the
    last row gives the inverse depth, 1/m; greys (K, 2): light from the print's black and white; texture (r, c) uint8,
    0 and 255 for those; edge_distance (r, c) uint8: see `BoardPrint`; offsets (n, 2): where in a pixel to sample;
    box (4,): columns and rows to visit, x0, y0, x1, y1 (end excluded). depth (h, w): distance along the ray, m, of
    what is drawn already, and hides the print where it is nearer.
    """
    corners, middle = np.empty((4, 2)), homographies[len(homographies) // 2]
    for py in range(box[1], box[3]):
        for px in range(box[0], box[2]):
            _pixel_corners(ideal, px, py, corners)
            x = 0.25 * (corners[0, 0] + corners[1, 0] + corners[2, 0] + corners[3, 0])
            y = 0.25 * (corners[0, 1] + corners[1, 1] + corners[2, 1] + corners[3, 1])
            if math.isnan(x) or depth[py, px] * _texel(middle, x, y)[2] < math.sqrt(1.0 + x * x + y * y):
                continue
            sure, covered, grey = _plain_pixel(homographies, greys, texture, edge_distance, corners, x, y)
            if not sure:
                covered, grey = _sampled_pixel(homographies, greys, texture, offsets, corners)
            if covered > 0.0:
                light[py, px] = (1.0 - covered) * light[py, px] + grey


@njit(cache=True, nogil=True)
def _plain_pixel(homographies, greys, texture, edge_distance, corners, x, y):
    """Whether the pixel has one grey, or lies beside the print, throughout the exposure; its share of print, light."""
    middle = len(homographies) // 2
    u, v, w = _texel(homographies[middle], x, y)
    if math.isnan(u):
        return False, 0.0, 0.0
    reach, moved = _reach(homographies[middle], corners, u, v, w), 0.0
    if middle > 0:
        for m in (0, len(homographies) - 1):
            other_u, other_v, _ = _texel(homographies[m], x, y)
            if math.isnan(other_u):
                return False, 0.0, 0.0
            moved = max(moved, abs(other_u - u) + abs(other_v - v))
    reach += moved
    rows, columns = edge_distance.shape
    beside = max(max(-u, u - columns), max(-v, v - rows))
    if beside > reach:
        return True, 0.0, 0.0
    if beside < 0.0 and edge_distance[int(v), int(u)] > reach:
        return True, 1.0, _grey(greys[middle], texture[int(v), int(u)])
    return False, 0.0, 0.0


@njit(cache=True, nogil=True)
def _sampled_pixel(homographies, greys, texture, offsets, corners):
    """Share of print in a pixel, and its light: the samples, two by two, at the exposure's instants in turn."""
    covered, grey, instants, samples = 0.0, 0.0, len(homographies), len(offsets)
    rows, columns = texture.shape
    for i in range(samples):
        m = (i // 2) % instants
        x, y = _inside_pixel(corners, offsets[i, 0], offsets[i, 1])
        u, v, _ = _texel(homographies[m], x, y)
        if 0.0 <= u < columns and 0.0 <= v < rows:
            covered += 1.0 / samples
            grey += _grey(greys[m], texture[int(v), int(u)]) / samples
    return covered, grey


@njit(cache=True, nogil=True)
def _grey(black_white, level):
    return black_white[0] + level / 255.0 * (black_white[1] - black_white[0])


@njit(cache=True, nogil=True)
def cast_ball(ideal, centre, radius, glow, offsets, box, light):
    """Draws a glowing ball: ``centre`` (3,) camera frame, m; the other arguments as of ``cast_board``."""
    corners = np.empty((4, 2))
    c2 = centre[0] ** 2 + centre[1] ** 2 + centre[2] ** 2 - radius**2
    for py in range(box[1], box[3]):
        for px in range(box[0], box[2]):
            _pixel_corners(ideal, px, py, corners)
            covered = 0.0
            for i in range(len(offsets)):
                x, y = _inside_pixel(corners, offsets[i, 0], offsets[i, 1])
                ahead = x * centre[0] + y * centre[1] + centre[2]
                if ahead > 0.0 and ahead * ahead > c2 * (1.0 + x * x + y * y):
                    covered += 1.0 / len(offsets)
            light[py, px] = (1.0 - covered) * light[py, px] + covered * glow


@njit(cache=True, nogil=True)
def _pixel_corners(ideal, px, py, corners):
    """corners (4, 2) <- ideal image coordinates of a pixel's corners, row by row."""
    for k in range(4):
        corners[k, 0] = ideal[py + k // 2, px + k % 2, 0]
        corners[k, 1] = ideal[py + k // 2, px + k % 2, 1]


@njit(cache=True, nogil=True)
def _inside_pixel(corners, sx, sy):
    """Ideal image coordinates at a place (0..1, 0..1) in the pixel."""
    a, b, c, d = (1.0 - sy) * (1.0 - sx), (1.0 - sy) * sx, sy * (1.0 - sx), sy * sx
    x = a * corners[0, 0] + b * corners[1, 0] + c * corners[2, 0] + d * corners[3, 0]
    y = a * corners[0, 1] + b * corners[1, 1] + c * corners[2, 1] + d * corners[3, 1]
    return x, y
