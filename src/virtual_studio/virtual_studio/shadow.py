"""The soft shadow that the body throws on the floor, under two lamps of some size."""

from __future__ import annotations

import math

import cv2
import numpy as np
from numba import njit
from numpy.typing import NDArray

from .body import Capsules
from .ray_caster import hit_capsule

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
