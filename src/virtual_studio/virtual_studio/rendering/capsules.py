"""Casts rays against tapered capsules: exact silhouettes, shading, and the shadow that a body throws on the floor.

A capsule is the hull of two spheres (a, ra) and (b, rb). Kernels take rays as unit directions in the world frame, one
per pixel, and visit only the pixels of each capsule's box.
"""

from __future__ import annotations

import math

import cv2
import numpy as np
from numpy.typing import NDArray

from capture_rig.camera import CameraModel
from capture_rig.kernel import njit

from ..people import Capsules

LIGHT_WORLD = np.array([0.35, 0.25, 0.90]) / np.linalg.norm([0.35, 0.25, 0.90])
"""Direction towards the light that shades bodies and boards, unit."""
BOX_MARGIN_PX = 4
NEAR_M = 0.05
_CUBE = np.array([[x, y, z] for x in (-1.0, 1.0) for y in (-1.0, 1.0) for z in (-1.0, 1.0)])

HALF_WIDTH_M, CELL_M = 4.2, 0.025
CELLS = int(2 * HALF_WIDTH_M / CELL_M)
"""The shadow's map: square cells around the middle of the floor."""
LAMPS_WORLD = np.array([[1.3, 1.0, 3.4], [-1.4, -0.7, 3.4]])
LAMP_POINTS = np.array([[-0.22, -0.22, 0.0], [-0.22, 0.22, 0.0], [0.22, -0.22, 0.0], [0.22, 0.22, 0.0]])
"""Offsets, metres, of the points that sample one lamp's area."""
DARKNESS = 0.55
"""Share of the floor's light that comes from the lamps; the rest is ambient."""
BLUR_CELLS = 1.6


def draw_capsules(
    camera: CameraModel,
    rays: NDArray[np.float64],
    capsules: Capsules,
    light: NDArray[np.float32],
    depth: NDArray[np.float32] | None = None,
) -> tuple[NDArray[np.float32], NDArray[np.uint8]]:
    """Draws a body into a camera's light (h, w), in place.

    depth : along the ray (h, w), m, of things that hide the body where they are nearer; inf elsewhere.
    Returns depth with the body in it, and the silhouette (h, w), 0 or 255, of its visible part.
    """
    depth = np.full(light.shape, np.inf, np.float32) if depth is None else depth.copy()
    mask = np.zeros(light.shape, np.uint8)
    _cast(camera.centre_world, rays, capsules, boxes_px(camera, capsules), depth, light, mask)
    return depth, mask


def silhouette(
    camera: CameraModel, rays: NDArray[np.float64], capsules: Capsules, depth: NDArray[np.float32] | None = None
) -> NDArray[np.uint8]:
    """Returns the mask of :func:`draw_capsules` alone, faster."""
    mask = np.zeros((camera.height, camera.width), np.uint8)
    depth = np.full(mask.shape, np.inf, np.float32) if depth is None else depth
    _cast_silhouette(camera.centre_world, rays, capsules, boxes_px(camera, capsules), depth, mask)
    return mask


def boxes_px(camera: CameraModel, capsules: Capsules) -> NDArray[np.int64]:
    """Returns a pixel box (P, 4) around each capsule: its spheres' cubes, projected."""
    cubes = np.stack([capsules.starts, capsules.ends], 1)[:, :, None] + capsules.radii[:, :, None, None] * _CUBE
    return boxes_around(camera, cubes.reshape(len(cubes), -1, 3))


def boxes_around(camera: CameraModel, points_world: NDArray[np.float64]) -> NDArray[np.int64]:
    """Returns a pixel box (n, 4) x0, y0, x1, y1 (end excluded) around each row of points (n, k, 3), m."""
    pixels = camera.project(points_world)
    depth = points_world @ camera.R_camera_world[2] + camera.t_camera_world[2]
    size = np.array([camera.width, camera.height])
    low, high = pixels.min(1) - BOX_MARGIN_PX, pixels.max(1) + BOX_MARGIN_PX + 1
    unbounded = ~(depth.min(1) > NEAR_M) | np.isnan(pixels).any((1, 2))  # around the camera or beyond its lens
    low[unbounded], high[unbounded] = 0, size
    return np.hstack([np.clip(np.floor(low), 0, size), np.clip(np.ceil(high), 0, size)]).astype(np.int64)


def floor_shadow(capsules: Capsules, strength: float = 1.0) -> NDArray[np.float32]:
    """Returns the share of light that reaches each floor cell (CELLS, CELLS), 1 in the open; rows y, columns x.

    strength : 1 where the lamps give `DARKNESS` of the light, 0 where all of it is ambient.
    """
    blocked = np.zeros((CELLS, CELLS), np.float32)
    lamps = (LAMPS_WORLD[:, None] + LAMP_POINTS).reshape(-1, 3)
    for lamp in lamps:
        _block_light(lamp, capsules, blocked, np.zeros((CELLS, CELLS), np.bool_))
    soft = np.asarray(cv2.GaussianBlur(blocked, (0, 0), BLUR_CELLS), np.float32)
    return np.float32(1.0) - np.float32(strength * DARKNESS / len(lamps)) * soft


def shadow_lookup(floor_xy: NDArray[np.float32]) -> NDArray[np.float32]:
    """Returns the cell of `floor_shadow` (h, w, 2) under each pixel's floor point (NaN: no floor), for cv2.remap."""
    cells = (floor_xy + np.float32(HALF_WIDTH_M)) / np.float32(CELL_M) - np.float32(0.5)
    return np.nan_to_num(cells, nan=-100.0)


@njit(cache=True, nogil=True)
def lambert(nx, ny, nz):
    """Light reflected by a white surface with this unit normal: diffuse, and ambient light that comes from above."""
    lamp = nx * LIGHT_WORLD[0] + ny * LIGHT_WORLD[1] + nz * LIGHT_WORLD[2]
    return 0.50 + 0.20 * nz + 0.45 * max(lamp, 0.0)


@njit(cache=True)
def _positive_min(best, t):
    return t if 0.0 < t < best else best


@njit(cache=True, nogil=True)
def hit_capsule(origin, ray, a, b, ra, rb):
    """Distance along the unit ray from origin to the hull of spheres (a, ra) and (b, rb); inf where it misses.

    Points are tuples (x, y, z), so that the compiler keeps them in registers.
    The side is the cone tangent to both spheres (a quadratic in t); the ends are the spheres themselves.
    """
    ox, oy, oz = origin
    dx, dy, dz = ray
    ax, ay, az = a
    bx, by, bz = b
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
def _ends_of(capsules, p):
    """Capsule p as scalars for `hit_capsule`: a, b, ra, rb."""
    a = capsules.starts[p, 0], capsules.starts[p, 1], capsules.starts[p, 2]
    b = capsules.ends[p, 0], capsules.ends[p, 1], capsules.ends[p, 2]
    return a, b, capsules.radii[p, 0], capsules.radii[p, 1]


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
def _cast(origin, rays, capsules, boxes, depth, light, mask):
    """Renders capsules into the arrays of one camera.

    origin (3,); rays (h, w, 3); boxes (P, 4). Only pixels on the body are written: depth (h, w), inf or of hiding
    things before; light (h, w), reflected light 0..1; mask (h, w), 255.
    """
    nearest = np.full(depth.shape, -1, np.int16)
    eye = origin[0], origin[1], origin[2]
    for p in range(len(boxes)):
        a, b, ra, rb = _ends_of(capsules, p)
        for y in range(boxes[p, 1], boxes[p, 3]):
            for x in range(boxes[p, 0], boxes[p, 2]):
                t = hit_capsule(eye, (rays[y, x, 0], rays[y, x, 1], rays[y, x, 2]), a, b, ra, rb)
                if t < depth[y, x]:
                    depth[y, x] = t
                    nearest[y, x] = p
    point, normal = np.empty(3), np.empty(3)
    for y in range(boxes[:, 1].min(), boxes[:, 3].max()):
        for x in range(boxes[:, 0].min(), boxes[:, 2].max()):
            p = nearest[y, x]
            if p < 0:
                continue
            for i in range(3):
                point[i] = origin[i] + depth[y, x] * rays[y, x, i]
            _normal(point, capsules.starts[p], capsules.ends[p], capsules.radii[p, 0], capsules.radii[p, 1], normal)
            light[y, x] = capsules.albedo[p] * lambert(normal[0], normal[1], normal[2])
            mask[y, x] = 255


@njit(cache=True, nogil=True)
def _cast_silhouette(origin, rays, capsules, boxes, depth, mask):
    """Sets mask (h, w) to 255 where a ray meets any capsule; arguments as for `_cast`, whose mask it equals."""
    eye = origin[0], origin[1], origin[2]
    for p in range(len(boxes)):
        a, b, ra, rb = _ends_of(capsules, p)
        for y in range(boxes[p, 1], boxes[p, 3]):
            for x in range(boxes[p, 0], boxes[p, 2]):
                if mask[y, x] == 0:
                    ray = rays[y, x, 0], rays[y, x, 1], rays[y, x, 2]
                    if hit_capsule(eye, ray, a, b, ra, rb) < depth[y, x]:
                        mask[y, x] = 255


@njit(cache=True, nogil=True)
def _block_light(lamp, capsules, blocked, done):
    """Adds 1 to every cell that does not see the lamp: rays from the cells near each capsule's shadow to the lamp."""
    for p in range(len(capsules.starts)):
        x0, y0, x1, y1 = _shadow_box(lamp, capsules.starts[p], capsules.ends[p], capsules.radii[p])
        a, b, ra, rb = _ends_of(capsules, p)
        for j in range(y0, y1):
            for i in range(x0, x1):
                if done[j, i]:
                    continue
                x, y = (i + 0.5) * CELL_M - HALF_WIDTH_M, (j + 0.5) * CELL_M - HALF_WIDTH_M
                dx, dy, dz = lamp[0] - x, lamp[1] - y, lamp[2]
                n = math.sqrt(dx * dx + dy * dy + dz * dz)
                if hit_capsule((x, y, 0.0), (dx / n, dy / n, dz / n), a, b, ra, rb) < n:
                    done[j, i] = True
                    blocked[j, i] += 1.0


@njit(cache=True)
def _shadow_box(lamp, start, end, radii):
    """Cells x0, y0, x1, y1 (end excluded) around the shadows of a capsule's two spheres, generously."""
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
