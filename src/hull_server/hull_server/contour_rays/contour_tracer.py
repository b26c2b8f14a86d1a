"""Traces rays along the silhouettes' contours that are tangent to the body (occluding contour rays).

Every point of a silhouette's contour is the view of a ray that touches the body's surface somewhere without entering
it. The steps of :func:`trace_contour_rays`: outlines, sub-pixel edges (:mod:`.outlines`), rays with their normals, and
the interval of each ray along the hull (:mod:`.ray_hull`), which is where it can touch (docs/explanation/hull.md).
"""

from __future__ import annotations

import math
from typing import NamedTuple

import cv2
import numpy as np
import numpy.typing as npt

from capture_rig.kernel import kernel, njit
from mocap_packets.hull import NO_CONTOUR_RAYS, ContourRays

from ..grid import VoxelGrid
from ..settings import ContourRaySettings
from ..slicing.voxel_runs import HullRuns
from ..views import Masks, RigViews
from .outlines import RADIUS_PX, find_edge, pick_contour_pixels, shadow_share, weights
from .ray_hull import Hull, part_near, ray_hull_interval

# Thresholds: chosen by the rays' spread about the true surface of rendered people, and their coverage of it; python
# bench/people.py scores the poses fitted to them.
LEAST_RAYS = 10  # of an outline: shorter ones, of holes or specks, get none
SIGMA_PX = 0.5  # standard deviation of a contour across itself
SHADOW_SIGMA_PX = 4.0  # added to it, in squares, where all pixels around may be shadow; less where fewer are

Mask = npt.NDArray[np.uint8]

COLUMNS = 12  # of the table as the kernels fill it: point, direction, normal, half_length, sigma, part


class ContourTracer:
    """Traces the contour rays of frame sets. One thread at a time: it keeps scratch memory."""

    def __init__(self, views: RigViews, grid: VoxelGrid, settings: ContourRaySettings) -> None:
        self._views, self._grid = views, grid
        self._weights = weights()
        self._cameras = [_camera(P, seen) for P, seen in zip(views.P, views.seen, strict=True)]
        self._limits = settings.per_camera, settings.spacing_px
        self._scratch = Scratch.of(*views.seen.shape[1:])

    def trace(self, masks: Masks, runs: HullRuns, levels: Masks | None = None) -> ContourRays:
        """Trace canvas masks (h, w) uint8, foreground above 127; keep the rays that touch their hull.

        levels : the same silhouettes as sent, of the levels of ``capture_rig.mask_levels``; contours near pixels that
        may be shadow, or are uncertain, get a larger sigma. At most ``per_camera`` rays a camera, evenly along the
        outlines, deterministic. As body they carry the number of their part.
        """
        present = self._views.present(masks)
        if not len(runs.starts) or not self._limits[0]:
            return NO_CONTOUR_RAYS
        hull = Hull.of(runs, self._grid)
        tables = []
        for index in present:
            name = self._views.names[index]
            tables.append(self._trace(index, masks[name], (levels or masks)[name], hull))
        camera = np.repeat(present.astype(np.int32), [len(table) for table in tables])
        table = np.concatenate(tables)
        part = table[:, 11].astype(np.int32)
        return ContourRays(table[:, 0:3], table[:, 3:6], table[:, 6:9], table[:, 9], table[:, 10], camera, part)

    def _trace(self, index: int, mask: Mask, levels: Mask, hull: Hull) -> npt.NDArray[np.float64]:
        mask, levels = np.ascontiguousarray(mask), np.ascontiguousarray(levels)
        return trace_contour_rays(mask, levels, self._cameras[index], hull, self._weights, self._limits, self._scratch)


class ViewGeometry(NamedTuple):
    """The calibration of one view.

    P (3, 4): map points, metres, to canvas pixels. pixel_to_ray (3, 3): homogeneous pixels to directions away from the
    camera. centre (3,): map frame. clear (H, W) uint8: nonzero where the camera sees all pixels around.
    """

    P: npt.NDArray[np.float64]
    pixel_to_ray: npt.NDArray[np.float64]
    centre: npt.NDArray[np.float64]
    clear: npt.NDArray[np.uint8]


class Scratch(NamedTuple):
    """Scratch memory; see :func:`.outlines.pick_contour_pixels`."""

    marks: npt.NDArray[np.uint8]
    filled: npt.NDArray[np.uint8]
    ends: npt.NDArray[np.int32]
    path: npt.NDArray[np.int16]
    along: npt.NDArray[np.float64]

    @classmethod
    def of(cls, height: int, width: int) -> Scratch:
        cracks = 4 * (height * width // 2 + 1)  # a chessboard has most
        path, along, ends = np.empty((cracks, 2), np.int16), np.empty(cracks), np.empty(cracks // 4, np.int32)
        filled = np.zeros((height + 2, width + 16), np.uint8)
        return cls(np.empty((height, width), np.uint8), filled, ends, path, along)


def _camera(P: npt.NDArray[np.float64], seen: npt.NDArray[np.uint8]) -> ViewGeometry:
    pixel_to_ray = np.linalg.inv(P[:, :3]).astype(np.float64)
    window = np.ones((2 * RADIUS_PX + 1, 2 * RADIUS_PX + 1), np.uint8)
    clear = cv2.erode(seen, window, borderType=cv2.BORDER_CONSTANT, borderValue=[0.0])
    return ViewGeometry(P, pixel_to_ray, -pixel_to_ray @ P[:, 3], np.asarray(clear, np.uint8))


@njit(cache=True, nogil=True)
def trace_contour_rays(mask, levels, camera, hull, weights, limits, scratch):  # type: ignore[no-untyped-def]
    """Trace the rays of one camera: rows (n, COLUMNS) of the table.

    mask, levels (h, w) uint8 : its silhouette as carved, and as sent. limits : most rays, and their least distance.
    """
    per_camera, spacing_px = limits
    pixels, table, n = np.empty((per_camera, 2), np.int32), np.empty((per_camera, COLUMNS)), 0
    # outlines, as far as the hull reaches in this view, sampled evenly
    box = _image_box(camera.P, hull, mask.shape)
    picked = pick_contour_pixels(mask, box, scratch, (LEAST_RAYS * spacing_px, spacing_px), pixels)
    for u, v in pixels[:picked]:
        # the edge to a fraction of a pixel; none where silhouettes are cut at the border of the view
        if camera.clear[v, u] != 0:
            is_edge, edge = find_edge(mask, u, v, weights)
            if is_edge:
                # a ray, which touches the body within its interval along the hull
                scale = _cast(camera, edge, table[n])
                sigma_px = math.hypot(SIGMA_PX, SHADOW_SIGMA_PX * shadow_share(levels, u, v))
                n += _touch(camera, hull, sigma_px / scale, table[n])
    return table[:n]


@kernel
def _image_box(P, hull, shape):  # type: ignore[no-untyped-def]
    """Bound the hull in an image (h, w): left, top, right, bottom (exclusive); left and right are multiples of 8."""
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

    A pixel (u, v, 1) back-projects along the inverse of P's left part (thesis eq. 3.1), and an image line l to the
    plane P^T l (Hartley and Zisserman, Multiple View Geometry, result 8.2). l, and so the plane, is negative inside the
    silhouette; a pixel of l is depth over scale in metres.
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
    """Write the interval in which the row's ray can touch the hull; return whether it can.

    A ray that misses the hull is tried again a voxel further inside.
    """
    x = (camera.centre[0] - hull.corner[0]) / hull.voxel_m
    y = (camera.centre[1] - hull.corner[1]) / hull.voxel_m
    z = (camera.centre[2] - hull.corner[2]) / hull.voxel_m
    begin, end = ray_hull_interval(hull, (x, y, z), row[3:6])
    if begin == end:
        begin, end = ray_hull_interval(hull, (x - row[6], y - row[7], z - row[8]), row[3:6])
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
    """Scale a vector (3,) to length 1; return its length before."""
    length = math.sqrt(vector[0] ** 2 + vector[1] ** 2 + vector[2] ** 2)
    for k in range(3):
        vector[k] /= length
    return length
