"""From the outlines of a silhouette to rays in the world."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
from numba import njit

from ..kernel import kernel
from .edges import doubt_around, find_edge
from .grazes import graze, part_near
from .outlines import pick_rim_pixels
from .rim_table import COLUMNS


class Camera(NamedTuple):
    """What a view's calibration gives.

    P (3, 4): map points, metres, to canvas pixels. pixel_to_ray (3, 3): homogeneous pixels to directions away from the
    camera. centre (3,): map frame. clear (H, W) uint8: nonzero where the camera sees all pixels around.
    """

    P: npt.NDArray[np.float64]
    pixel_to_ray: npt.NDArray[np.float64]
    centre: npt.NDArray[np.float64]
    clear: npt.NDArray[np.uint8]


class Hull(NamedTuple):
    """Where rays may touch.

    wide, size : see :func:`hull_server.rims.grazes.widen`. corner (3,) of its box in metres, map frame; voxel_m.
    runs : see :func:`hull_server.rims.grazes.part_near`; several : has the hull more than one part?
    """

    wide: npt.NDArray[np.uint64]
    size: tuple[int, int, int]
    corner: npt.NDArray[np.float64]
    voxel_m: float
    runs: tuple[Any, ...]
    several: bool


class Scratch(NamedTuple):
    """Memory to work in; see :func:`hull_server.rims.outlines.pick_rim_pixels`."""

    marks: npt.NDArray[np.uint8]
    ends: npt.NDArray[np.int32]
    path: npt.NDArray[np.int16]
    along: npt.NDArray[np.float64]
    stamp: int


class Rules(NamedTuple):
    """What :class:`hull_server.settings.RimSettings` says."""

    per_camera: int
    min_outline_px: float
    spacing_px: float
    sigma_px: float
    doubt_px: float


@njit(cache=True, nogil=True)
def trace_rims(mask, levels, camera, hull, weights, rules, scratch):  # type: ignore[no-untyped-def]
    """Rows (n, COLUMNS) of the rim table of one camera's silhouette (h, w) uint8, as carved and as sent."""
    pixels, table, n = np.empty((rules.per_camera, 2), np.int32), np.empty((rules.per_camera, COLUMNS)), 0
    # outlines, as far as the hull reaches in this view, sampled evenly
    box = _image_box(camera.P, hull, mask.shape)
    limits = rules.min_outline_px, rules.spacing_px
    picked = pick_rim_pixels(mask, box, scratch, limits, pixels)
    for u, v in pixels[:picked]:
        # the edge to a fraction of a pixel; none at the border of what the camera sees, where silhouettes are cut
        if camera.clear[v, u] != 0:
            is_edge, edge = find_edge(mask, u, v, weights)
            if is_edge:
                # a ray, which touches the body where it grazes the hull
                scale = _cast(camera, edge, table[n])
                sigma_px = math.hypot(rules.sigma_px, rules.doubt_px * doubt_around(levels, u, v))
                n += _touch(camera, hull, sigma_px / scale, table[n])
    return table[:n]


@kernel
def _image_box(P, hull, shape):  # type: ignore[no-untyped-def]
    """Left, top, right, bottom (exclusive) of the part of an image (h, w) in which the hull can be; left and right are
    multiples of 8."""
    (height, width), (least_u, least_v, most_u, most_v) = shape, (1e9, 1e9, -1e9, -1e9)
    for n in range(8):
        x = hull.corner[0] + (n & 1) * hull.size[0] * hull.voxel_m
        y = hull.corner[1] + (n >> 1 & 1) * hull.size[1] * hull.voxel_m
        z = hull.corner[2] + (n >> 2) * hull.size[2] * hull.voxel_m
        depth = P[2, 0] * x + P[2, 1] * y + P[2, 2] * z + P[2, 3]
        if depth <= 0.0:  # the camera is in the box, or beside it
            return 0, 0, width, height
        u = (P[0, 0] * x + P[0, 1] * y + P[0, 2] * z + P[0, 3]) / depth
        v = (P[1, 0] * x + P[1, 1] * y + P[1, 2] * z + P[1, 3]) / depth
        least_u, least_v, most_u, most_v = min(least_u, u), min(least_v, v), max(most_u, u), max(most_v, v)
    left, right = max(int(least_u), 0) // 8 * 8, min((int(most_u) + 9) // 8 * 8, width)
    return left, max(int(least_v), 0), right, min(int(most_v) + 2, height)


@kernel
def _cast(camera, edge, row):  # type: ignore[no-untyped-def]
    """Write the edge's ray and normal to the row; return the scale of its plane.

    A pixel (u, v, 1) is seen along the inverse of P's left part (thesis eq. 3.1). The line l of the image along the
    edge is seen in the plane P^T l (Hartley and Zisserman, Multiple View Geometry, result 8.2). l, and so the plane, is
    negative inside the silhouette; a pixel of l is depth over scale in metres.
    """
    u, v, across, down = edge
    distance = -(across * u + down * v)
    for k in range(3):
        row[3 + k] = camera.pixel_to_ray[k, 0] * u + camera.pixel_to_ray[k, 1] * v + camera.pixel_to_ray[k, 2]
        row[6 + k] = camera.P[0, k] * across + camera.P[1, k] * down + camera.P[2, k] * distance
    _normalise(row[3:6])
    return _normalise(row[6:9])


@kernel
def _touch(camera, hull, sigma_per_depth, row):  # type: ignore[no-untyped-def]
    """Write to the row where its ray can touch the hull; return whether it can.

    A ray that passes by the hull touches where it is nearest: where it would, were it a voxel further inside.
    """
    x = (camera.centre[0] - hull.corner[0]) / hull.voxel_m
    y = (camera.centre[1] - hull.corner[1]) / hull.voxel_m
    z = (camera.centre[2] - hull.corner[2]) / hull.voxel_m
    begin, end = graze(hull.wide, hull.size, (x, y, z), row[3:6])
    if begin == end:
        begin, end = graze(hull.wide, hull.size, (x - row[6], y - row[7], z - row[8]), row[3:6])
    if begin == end:
        return False
    middle, depth = 0.5 * (begin + end), camera.P[2, 3]
    for k in range(3):
        row[k] = camera.centre[k] + middle * hull.voxel_m * row[3 + k]
        depth += camera.P[2, k] * row[k]
    row[9] = 0.5 * (end - begin) * hull.voxel_m
    row[10] = sigma_per_depth * depth
    row[11] = 0
    if hull.several:
        row[11] = part_near(hull.runs, (x + middle * row[3], y + middle * row[4], z + middle * row[5]))
    return True


@kernel
def _normalise(vector):  # type: ignore[no-untyped-def]
    """Scale a vector (3,) to length 1; return what it was."""
    length = math.sqrt(vector[0] ** 2 + vector[1] ** 2 + vector[2] ** 2)
    for k in range(3):
        vector[k] /= length
    return length
