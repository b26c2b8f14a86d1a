"""Renders one camera's view of calibration boards and their holders: lens, focus, exposure and noise."""

from __future__ import annotations

import math
from itertools import pairwise

import cv2
import numpy as np

from capture_rig.camera import CameraModel
from capture_rig.kernel import njit
from capture_rig.lens import Array

from ..boards import BACK, BLACK, WHITE, BoardPrint, PosedBoard, PosePath
from ..people import Capsules
from ..rig import view_room
from .camera import Light
from .capsules import boxes_around, draw_capsules, lambert

SAMPLES = 48
LENS_BLUR_PX, EXPOSURE_S = 0.6, 0.008
"""Standard deviation of a point's picture in a lens that is in focus."""
OUTLINE_POINTS = 16
STILL_PX = 0.1
"""Motion below this, while the shutter is open, is not drawn."""
MOST_INSTANTS = 9


class BoardCamera:
    """Renders the room with a board and its holder through a camera's own lens."""

    def __init__(self, camera: CameraModel) -> None:
        self.camera = camera
        self._view, self._ideal = view_room(camera), ideal_corners(camera)

    def empty_room(self) -> Light:
        return self._view.grey

    def render(
        self, board: PosedBoard, people: Capsules | None = None, blur_px: float = LENS_BLUR_PX, samples: int = SAMPLES
    ) -> Light:
        """Returns the light of a board and of people, blurred by the lens (standard deviation, px).

        samples : of a pixel on an edge; few are fast, many are exact.
        """
        light, printed, poses = self._view.grey.copy(), board.print, board.T_world_board
        depth = np.full(light.shape, np.inf, np.float32)
        if people is not None:
            depth, _ = draw_capsules(self.camera, self._view.rays, people, light)
        ring, share = printed.sheet_board[[0, 1, 3, 2, 0]], np.linspace(0.0, 1.0, OUTLINE_POINTS, endpoint=False)
        outline = np.concatenate([a + share[:, None] * (b - a) for a, b in pairwise(ring)])  # a lens bends its edges
        places = np.concatenate([outline @ T[:3, :3].T + T[:3, 3] for T in poses])  # while the shutter is open
        (box,) = boxes_around(self.camera, places[None])
        if (box[2:] > box[:2]).all():
            # from ideal image coordinates [x, y, 1] to texels, scaled so that the last row gives 1 / depth
            in_camera = self.camera.T_camera_world @ poses
            homographies = printed.H_texel_board @ np.linalg.inv(in_camera[:, :3, [0, 1, 3]])
            greys, offsets = np.array([self._greys(T) for T in poses]), sample_offsets(samples)
            cast_board(
                self._ideal, homographies, greys, printed.texture, printed.edge_distance, offsets, box, depth, light
            )
        if blur_px > 0:
            cv2.GaussianBlur(light, (0, 0), blur_px, dst=light, borderType=cv2.BORDER_REPLICATE)
        return light

    def film(
        self, board: BoardPrint, path: PosePath, t: float, people: Capsules | None, samples: int = SAMPLES
    ) -> Light:
        """Returns the light of a board on its path while the shutter is open: ``t`` is the middle of that, s."""
        posed = PosedBoard(board, exposure_poses(self.camera, board, path, t))
        return self.render(posed, people, samples=samples)

    def _greys(self, T_world_board: Array) -> Array:
        """Return (2,) light from black and white; from both the same, of the sheet, where its back is seen."""
        towards = self.camera.centre_world - T_world_board[:3, 3]
        in_front = float(T_world_board[:3, 2] @ towards) > 0.0
        normal = T_world_board[:3, 2] if in_front else -T_world_board[:3, 2]
        return lambert(*normal) * np.array([BLACK, WHITE] if in_front else [BACK, BACK])


def exposure_poses(camera: CameraModel, board: BoardPrint, path: PosePath, t: float) -> Array:
    """Returns a board's poses (K, 4, 4) while the shutter is open; K by its motion in the picture."""
    shutter = np.array([-0.5, 0.5]) * EXPOSURE_S + t
    opened, closed = (camera.project(board.sheet_board @ T[:3, :3].T + T[:3, 3]) for T in map(path, shutter))
    moved_px = float(np.nan_to_num(np.abs(closed - opened)).max())
    if moved_px < STILL_PX:
        return path(t)[None]
    instants = min(3 + 2 * int(moved_px / 2.0), MOST_INSTANTS)  # an odd number: one of them is the middle
    between = (np.arange(instants) + 0.5) / instants
    return np.array([path(time) for time in shutter[0] + between * EXPOSURE_S])


def ideal_corners(camera: CameraModel) -> Array:
    """Returns normalised undistorted coordinates (h + 1, w + 1, 2) of pixel corners; NaN beyond the lens model."""
    y, x = np.mgrid[: camera.height + 1, : camera.width + 1] - 0.5
    rays = camera.rays_world(np.column_stack([x.ravel(), y.ravel()])) @ camera.R_camera_world.T
    return np.ascontiguousarray((rays[:, :2] / rays[:, 2:]).reshape(camera.height + 1, camera.width + 1, 2))


# --- Kernels that draw flat prints: coverage and brightness of each pixel.
#
# Pixels that lie on one field, or beside the print, take one look-up; those on an edge are sampled. ``ideal``
# (h + 1, w + 1, 2) are the normalised undistorted image coordinates of the pixels' corners.

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
    things drawn already, which hide the print where they are nearer.
    """
    corners, middle = np.empty((4, 2)), homographies[len(homographies) // 2]
    for py in range(box[1], box[3]):
        for px in range(box[0], box[2]):
            for k in range(4):  # ideal image coordinates of the pixel's corners, row by row
                corners[k, 0] = ideal[py + k // 2, px + k % 2, 0]
                corners[k, 1] = ideal[py + k // 2, px + k % 2, 1]
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
        m, sx, sy = (i // 2) % instants, offsets[i, 0], offsets[i, 1]
        a, b, c, d = (1.0 - sy) * (1.0 - sx), (1.0 - sy) * sx, sy * (1.0 - sx), sy * sx
        x = a * corners[0, 0] + b * corners[1, 0] + c * corners[2, 0] + d * corners[3, 0]
        y = a * corners[0, 1] + b * corners[1, 1] + c * corners[2, 1] + d * corners[3, 1]
        u, v, _ = _texel(homographies[m], x, y)
        if 0.0 <= u < columns and 0.0 <= v < rows:
            covered += 1.0 / samples
            grey += _grey(greys[m], texture[int(v), int(u)]) / samples
    return covered, grey


@njit(cache=True, nogil=True)
def _grey(black_white, level):
    return black_white[0] + level / 255.0 * (black_white[1] - black_white[0])
