"""Rays along a mesh's outline, as a camera far away sees it: where they touch the mesh, and which way is outside.

The mesh is drawn orthographically with its depth; points of the silhouette's border are moved to the level of half
coverage of the smoothed silhouette, so that they are finer than a pixel.
"""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from capture_rig.kernel import njit

Array = NDArray[np.float64]
Triangles = NDArray[np.int32]

PIXEL_M, MARGIN_M = 0.004, 0.05
SMOOTHING_PX, NEAR_HALF, LEAST_SLOPE = 2.0, 0.25, 0.05  # border pixels that thin parts or corners blur are left out
LOWEST, HIGHEST = -0.05, 0.5  # rad that the cameras of `ring_of_rays` look down


def ring_of_rays(
    vertices: Array, triangles: Triangles, views: int, rays: int, random: np.random.Generator
) -> tuple[Array, Array, Array]:
    """Points, directions and outward normals (n, 3) of ``rays`` rays from each of ``views`` directions around."""
    found = []
    for k in range(views):
        azimuth = 2.0 * np.pi * (k + random.random()) / views
        found.append(outline_rays(vertices, triangles, azimuth, random.uniform(LOWEST, HIGHEST), random, rays))
    points, directions, normals = (np.concatenate(part) for part in zip(*found, strict=True))
    return points, directions, normals


def outline_rays(
    vertices: Array, triangles: Triangles, azimuth: float, down: float, random: np.random.Generator, count: int
) -> tuple[Array, Array, Array]:
    """Where ``count`` rays touch the mesh (n, 3) m, their direction and the outward normal across it."""
    ahead = np.array([np.cos(azimuth) * np.cos(down), np.sin(azimuth) * np.cos(down), -np.sin(down)])
    right = np.cross(ahead, [0.0, 0.0, 1.0])
    right /= np.linalg.norm(right)
    up = np.cross(right, ahead)
    x, y, depth = vertices @ right, vertices @ up, vertices @ ahead
    x0, y0 = x.min() - MARGIN_M, y.min() - MARGIN_M
    width, height = int((x.max() - x0 + MARGIN_M) / PIXEL_M), int((y.max() - y0 + MARGIN_M) / PIXEL_M)
    nearest = np.full((height, width), np.inf)
    _draw(np.stack([(x - x0) / PIXEL_M, (y - y0) / PIXEL_M], axis=1), depth, triangles, nearest)
    rows, columns, normals_px, outward_px = _border(np.isfinite(nearest).astype(np.float32))
    chosen = random.permutation(len(rows))[:count]
    rows, columns, normals_px = rows[chosen], columns[chosen], normals_px[chosen]
    places = np.stack([columns, rows], axis=1) + outward_px[chosen, None] * normals_px
    points = (x0 + PIXEL_M * places[:, :1]) * right + (y0 + PIXEL_M * places[:, 1:]) * up
    points += nearest[rows, columns][:, None] * ahead
    normals = normals_px[:, :1] * right + normals_px[:, 1:] * up
    return points, np.tile(ahead, (len(points), 1)), normals


def _border(mask: NDArray[np.float32]) -> tuple[NDArray[np.int64], NDArray[np.int64], Array, Array]:
    """Rows, columns, outward normals (n, 2) and distance (n,) px outward to the level of half coverage."""
    smooth = cv2.GaussianBlur(mask, (0, 0), SMOOTHING_PX)
    across, along = (cv2.Sobel(smooth, cv2.CV_32F, dx, 1 - dx, ksize=3) / 8 for dx in (1, 0))
    inner = mask - cv2.erode(mask, np.ones((3, 3), np.uint8))
    rows, columns = np.nonzero((inner > 0) & (np.abs(smooth - 0.5) < NEAR_HALF))
    slope = np.hypot(across, along)[rows, columns]
    rows, columns, slope = rows[slope > LEAST_SLOPE], columns[slope > LEAST_SLOPE], slope[slope > LEAST_SLOPE]
    normals = -np.stack([across[rows, columns], along[rows, columns]], axis=1) / slope[:, None]
    return rows, columns, normals, (smooth[rows, columns] - 0.5) / slope


@njit(cache=True)
def _draw(places, depth, triangles, nearest):
    """The least depth of every pixel (height, width), from vertices' places (V, 2) px."""
    height, width = nearest.shape
    for t in range(triangles.shape[0]):
        a, b, c = triangles[t, 0], triangles[t, 1], triangles[t, 2]
        x0, y0, x1, y1 = places[a, 0], places[a, 1], places[b, 0], places[b, 1]
        x2, y2 = places[c, 0], places[c, 1]
        area = (x1 - x0) * (y2 - y0) - (x2 - x0) * (y1 - y0)
        if area == 0.0:
            continue
        first, last = max(0, int(np.ceil(min(x0, x1, x2)))), min(width - 1, int(np.floor(max(x0, x1, x2))))
        top, bottom = max(0, int(np.ceil(min(y0, y1, y2)))), min(height - 1, int(np.floor(max(y0, y1, y2))))
        for y in range(top, bottom + 1):
            for x in range(first, last + 1):
                u = ((x1 - x) * (y2 - y) - (x2 - x) * (y1 - y)) / area
                v = ((x2 - x) * (y0 - y) - (x0 - x) * (y2 - y)) / area
                w = 1.0 - u - v
                if u >= -1e-9 and v >= -1e-9 and w >= -1e-9:
                    nearest[y, x] = min(nearest[y, x], u * depth[a] + v * depth[b] + w * depth[c])


def hull_of_spheres(start: Array, end: Array, start_radius: float, end_radius: float) -> Array:
    """Vertices (V, 3) of a tapered capsule; its triangles are SPHERE_TRIANGLES."""
    way = end - start
    length = float(np.linalg.norm(way))
    axis = way / length if length > 1e-9 else np.array([0.0, 0.0, 1.0])
    across = np.cross(axis, [1.0, 0.0, 0.0]) if abs(axis[0]) < 0.9 else np.cross(axis, [0.0, 1.0, 0.0])
    across /= np.linalg.norm(across)
    turned = SPHERE @ np.stack([across, np.cross(axis, across), axis], axis=1).T
    front = SPHERE[:, 2] > (start_radius - end_radius) / max(length, 1e-9)
    return np.where(front[:, None], end + end_radius * turned, start + start_radius * turned)


def _sphere(rings: int) -> tuple[Array, Triangles]:
    around, places, triangles = 2 * rings, [], []
    for polar in np.linspace(0.0, np.pi, rings):
        for turn in np.linspace(0.0, 2.0 * np.pi, around, endpoint=False):
            places.append([np.sin(polar) * np.cos(turn), np.sin(polar) * np.sin(turn), np.cos(polar)])
    for i in range(rings - 1):
        for j in range(around):
            a, b = i * around + j, i * around + (j + 1) % around
            triangles += [(a, b, a + around), (b, b + around, a + around)]
    return np.array(places), np.array(triangles, np.int32)


SPHERE, SPHERE_TRIANGLES = _sphere(10)
