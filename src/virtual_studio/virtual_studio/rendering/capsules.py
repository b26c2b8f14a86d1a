"""Rays against tapered capsules: exact silhouette, depth, normal and part of every pixel."""

from __future__ import annotations

import math

import cv2
import numpy as np
from numba import njit
from numpy.typing import NDArray

from ..people import Capsules


@njit(cache=True)
def _positive_min(best, t):
    return t if 0.0 < t < best else best


@njit(cache=True, nogil=True)
def hit_capsule(ox, oy, oz, dx, dy, dz, ax, ay, az, bx, by, bz, ra, rb):
    """Distance along the unit ray o + t d to the hull of spheres (a, ra) and (b, rb); inf where it misses.

    Scalars, so that what does not depend on the ray is computed once per part and not per pixel.
    The side is the cone tangent to both spheres (a quadratic in t); the ends are the spheres themselves.
    """
    bax, bay, baz = bx - ax, by - ay, bz - az
    oax, oay, oaz = ox - ax, oy - ay, oz - az
    taper = ra - rb
    axis2 = bax * bax + bay * bay + baz * baz
    axis_o = bax * oax + bay * oay + baz * oaz
    axis_d = bax * dx + bay * dy + baz * dz
    d_o = dx * oax + dy * oay + dz * oaz
    o2 = oax * oax + oay * oay + oaz * oaz
    best = math.inf
    slant2 = axis2 - taper * taper
    if slant2 > 0.0:
        k2 = slant2 - axis_d * axis_d
        k1 = slant2 * d_o - axis_o * axis_d + axis_d * taper * ra
        k0 = slant2 * o2 - axis_o * axis_o + 2.0 * axis_o * taper * ra - axis2 * ra * ra
        discriminant = k1 * k1 - k0 * k2
        if discriminant >= 0.0 and k2 != 0.0:
            root = math.sqrt(discriminant)
            for t in ((-k1 - root) / k2, (-k1 + root) / k2):
                along = axis_o - ra * taper + t * axis_d
                if 0.0 < along < slant2:
                    best = _positive_min(best, t)
    sphere = d_o * d_o - o2 + ra * ra
    if sphere >= 0.0:
        best = _positive_min(best, -d_o - math.sqrt(sphere))
    d_ob = d_o - axis_d
    ob2 = o2 - 2.0 * axis_o + axis2
    sphere = d_ob * d_ob - ob2 + rb * rb
    if sphere >= 0.0:
        best = _positive_min(best, -d_ob - math.sqrt(sphere))
    return best


@njit(cache=True, nogil=True)
def _normal(point, a, b, ra, rb, out):
    """Outward unit normal of the capsule's surface at a point on it: from the centre of the sphere that touches it."""
    axis2 = along = 0.0
    for i in range(3):
        axis2 += (b[i] - a[i]) ** 2
        along += (point[i] - a[i]) * (b[i] - a[i])
    taper = ra - rb
    slant2 = max(axis2 - taper * taper, 1e-12)
    across2 = 0.0
    u = along / axis2
    for i in range(3):
        across2 += (point[i] - a[i] - u * (b[i] - a[i])) ** 2
    # the touching sphere's centre lies up the axis by the cone's slope
    u = min(max(u + math.sqrt(across2 / slant2) * taper / math.sqrt(axis2), 0.0), 1.0)
    total = 0.0
    for i in range(3):
        out[i] = point[i] - a[i] - u * (b[i] - a[i])
        total += out[i] * out[i]
    scale = 1.0 / math.sqrt(max(total, 1e-18))
    for i in range(3):
        out[i] *= scale


@njit(cache=True, nogil=True)
def cast(origin, rays, starts, ends, radii, boxes, light, albedo, depth, shade, mask):
    """Renders capsules into the arrays of one camera; only the pixels of each part's box are visited.

    origin (3,); rays (h, w, 3) unit, world frame; boxes (P, 4) x0, y0, x1, y1 (end excluded), pixels;
    light (3,) unit, towards the lamp. depth (h, w) <- distance along the ray, metres; shade (h, w) <- reflected
    light 0..1 (Lambert and a sky); mask (h, w) <- 255 on the body. Only hit pixels are written; depth must be inf.
    """
    nearest = np.full(depth.shape, -1, np.int16)
    ox, oy, oz = origin[0], origin[1], origin[2]
    for p in range(len(starts)):
        ax, ay, az, ra = starts[p, 0], starts[p, 1], starts[p, 2], radii[p, 0]
        bx, by, bz, rb = ends[p, 0], ends[p, 1], ends[p, 2], radii[p, 1]
        for y in range(boxes[p, 1], boxes[p, 3]):
            for x in range(boxes[p, 0], boxes[p, 2]):
                dx, dy, dz = rays[y, x, 0], rays[y, x, 1], rays[y, x, 2]
                t = hit_capsule(ox, oy, oz, dx, dy, dz, ax, ay, az, bx, by, bz, ra, rb)
                if t < depth[y, x]:
                    depth[y, x] = t
                    nearest[y, x] = p
    _shade(origin, rays, starts, ends, radii, boxes, light, albedo, depth, nearest, shade, mask)


@njit(cache=True, nogil=True)
def _shade(origin, rays, starts, ends, radii, boxes, light, albedo, depth, nearest, shade, mask):
    point, normal = np.empty(3), np.empty(3)
    for y in range(boxes[:, 1].min(), boxes[:, 3].max()):
        for x in range(boxes[:, 0].min(), boxes[:, 2].max()):
            p = nearest[y, x]
            if p < 0:
                continue
            for i in range(3):
                point[i] = origin[i] + depth[y, x] * rays[y, x, i]
            _normal(point, starts[p], ends[p], radii[p, 0], radii[p, 1], normal)
            lamp = normal[0] * light[0] + normal[1] * light[1] + normal[2] * light[2]
            shade[y, x] = albedo[p] * (0.50 + 0.20 * normal[2] + 0.45 * max(lamp, 0.0))
            mask[y, x] = 255


@njit(cache=True, nogil=True)
def cast_silhouette(origin, rays, starts, ends, radii, boxes, mask):
    """Sets mask (h, w) to 255 where a ray meets any capsule; arguments as for `cast`, whose mask it equals."""
    ox, oy, oz = origin[0], origin[1], origin[2]
    for p in range(len(starts)):
        ax, ay, az, ra = starts[p, 0], starts[p, 1], starts[p, 2], radii[p, 0]
        bx, by, bz, rb = ends[p, 0], ends[p, 1], ends[p, 2], radii[p, 1]
        for y in range(boxes[p, 1], boxes[p, 3]):
            for x in range(boxes[p, 0], boxes[p, 2]):
                if mask[y, x] == 0:
                    dx, dy, dz = rays[y, x, 0], rays[y, x, 1], rays[y, x, 2]
                    if hit_capsule(ox, oy, oz, dx, dy, dz, ax, ay, az, bx, by, bz, ra, rb) < math.inf:
                        mask[y, x] = 255


# --- The soft shadow that the body throws on the floor, under two lamps of some size.

HALF_WIDTH_M, CELL_M = 4.2, 0.025
CELLS = int(2 * HALF_WIDTH_M / CELL_M)
LAMPS_WORLD = np.array([[1.3, 1.0, 3.4], [-1.4, -0.7, 3.4]])
LAMP_POINTS = np.array([[-0.22, -0.22, 0.0], [-0.22, 0.22, 0.0], [0.22, -0.22, 0.0], [0.22, 0.22, 0.0]])
"""Offsets, metres, of the points that stand for one lamp's area."""
DARKNESS = 0.55
"""Share of the floor's light that comes from the lamps; the rest is the room's own glow."""
BLUR_CELLS = 1.6


def floor_shadow(capsules: Capsules) -> NDArray[np.float32]:
    """Share of the light that reaches each floor cell (CELLS, CELLS), 1 in the open; rows y, columns x."""
    blocked = np.zeros((CELLS, CELLS), np.float32)
    lamps = (LAMPS_WORLD[:, None] + LAMP_POINTS).reshape(-1, 3)
    for lamp in lamps:
        _block(lamp, capsules.starts, capsules.ends, capsules.radii, blocked, np.zeros((CELLS, CELLS), np.bool_))
    soft = np.asarray(cv2.GaussianBlur(blocked, (0, 0), BLUR_CELLS), np.float32)
    return np.float32(1.0) - np.float32(DARKNESS / len(lamps)) * soft


def shadow_lookup(floor_xy: NDArray[np.float32]) -> NDArray[np.float32]:
    """Map (h, w, 2) from a camera's floor points to cells of `floor_shadow`, for cv2.remap; outside where no floor."""
    cells = (floor_xy + np.float32(HALF_WIDTH_M)) / np.float32(CELL_M) - np.float32(0.5)
    return np.nan_to_num(cells, nan=-100.0)


@njit(cache=True, nogil=True)
def _block(lamp, starts, ends, radii, blocked, done):
    """Adds 1 to every cell that does not see the lamp: rays from the cells near each part's shadow to the lamp."""
    for p in range(len(starts)):
        x0, y0, x1, y1 = _shadow_box(lamp, starts[p], ends[p], radii[p])
        ax, ay, az, ra = starts[p, 0], starts[p, 1], starts[p, 2], radii[p, 0]
        bx, by, bz, rb = ends[p, 0], ends[p, 1], ends[p, 2], radii[p, 1]
        for j in range(y0, y1):
            for i in range(x0, x1):
                if done[j, i]:
                    continue
                x, y = (i + 0.5) * CELL_M - HALF_WIDTH_M, (j + 0.5) * CELL_M - HALF_WIDTH_M
                dx, dy, dz = lamp[0] - x, lamp[1] - y, lamp[2]
                n = math.sqrt(dx * dx + dy * dy + dz * dz)
                t = hit_capsule(x, y, 0.0, dx / n, dy / n, dz / n, ax, ay, az, bx, by, bz, ra, rb)
                if t < n:
                    done[j, i] = True
                    blocked[j, i] += 1.0


@njit(cache=True)
def _shadow_box(lamp, start, end, radii):
    """Cells x0, y0, x1, y1 (end excluded) around the shadows of a part's two spheres, generously."""
    x0, y0, x1, y1 = math.inf, math.inf, -math.inf, -math.inf
    for k in range(2):
        point = start if k == 0 else end
        stretch = lamp[2] / max(lamp[2] - point[2] - radii[k], 0.3)
        x, y = lamp[0] + stretch * (point[0] - lamp[0]), lamp[1] + stretch * (point[1] - lamp[1])
        size = 1.8 * stretch * radii[k]
        x0, x1 = min(x0, x - size), max(x1, x + size)
        y0, y1 = min(y0, y - size), max(y1, y + size)
    return _cell(x0), _cell(y0), _cell(x1) + 1, _cell(y1) + 1


@njit(cache=True)
def _cell(place):
    return min(max(int((place + HALF_WIDTH_M) / CELL_M), 0), CELLS - 1)
