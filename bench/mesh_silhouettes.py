"""Exact silhouettes of meshes: every pixel whose centre lies in a triangle, through the lens, of all people at once."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from mesh_body import MeshBody
from mesh_motions import MeshMotion
from numpy.typing import NDArray

from capture_rig import Rig
from capture_rig.camera import CameraModel
from capture_rig.kernel import njit

Array = NDArray[np.float64]
NEAR_M = 0.1
"""What is nearer to a camera than this is not drawn."""


def mesh_silhouettes(rig: Rig, bodies: list[MeshBody], motions: list[MeshMotion], frame: int) -> dict[str, np.ndarray]:
    """Every camera's picture (H, W), 0 or 255, of the people in one frame."""
    vertices = [
        body.posed(motion.rotations[frame], motion.roots[frame])[0]
        for body, motion in zip(bodies, motions, strict=True)
    ]
    triangles = [body.triangles for body in bodies]
    return {camera.name: silhouette(camera, vertices, triangles) for camera in rig.cameras}


def silhouette(camera: CameraModel, vertices: Iterable[Array], triangles: Iterable[NDArray[np.int32]]) -> np.ndarray:
    """One camera's picture of meshes in the world."""
    canvas = Canvas(np.zeros((camera.height, camera.width), np.float32))
    for points, corners in zip(vertices, triangles, strict=True):
        canvas.draw(camera, points, corners, np.zeros(len(corners)))
    return canvas.mask


class Canvas:
    """A camera's light (h, w), drawn into; depth (h, w) m of what was drawn, and its silhouette (h, w), 0 or 255."""

    def __init__(self, light: NDArray[np.float32]) -> None:
        self.light = light
        self.depth, self.mask = np.full(light.shape, np.inf, np.float32), np.zeros(light.shape, np.uint8)

    def draw(self, camera: CameraModel, vertices: Array, triangles: NDArray[np.int32], shades: Array) -> None:
        """Draws a mesh in the world, triangle t in the light shades[t]."""
        pixels = camera.project(vertices)
        depth = vertices @ camera.R_camera_world[2] + camera.t_camera_world[2]
        pixels[depth < NEAR_M] = np.nan
        _draw(pixels, depth, triangles, shades, self.light, self.depth, self.mask)


@njit(cache=True)
def _draw(
    pixels: Array,
    away: Array,
    triangles: NDArray[np.int32],
    shades: Array,
    light: NDArray[np.float32],
    depth: NDArray[np.float32],
    mask: NDArray[np.uint8],
) -> None:
    """Sets the pixels whose centres, at whole numbers, lie in a triangle or on its edge, where it is the nearest."""
    height, width = mask.shape
    for t in range(len(triangles)):
        a, b, c = triangles[t, 0], triangles[t, 1], triangles[t, 2]
        ax, ay, bx, by, cx, cy = pixels[a, 0], pixels[a, 1], pixels[b, 0], pixels[b, 1], pixels[c, 0], pixels[c, 1]
        area = (bx - ax) * (cy - ay) - (by - ay) * (cx - ax)
        if not area * area > 0.0:
            continue
        distance = (away[a] + away[b] + away[c]) / 3.0
        left, right = max(0.0, np.ceil(min(ax, bx, cx))), min(width - 1.0, np.floor(max(ax, bx, cx)))
        top, bottom = max(0.0, np.ceil(min(ay, by, cy))), min(height - 1.0, np.floor(max(ay, by, cy)))
        sign = 1.0 if area > 0.0 else -1.0
        for y in range(int(top), int(bottom) + 1):
            for x in range(int(left), int(right) + 1):
                if (
                    sign * ((bx - ax) * (y - ay) - (by - ay) * (x - ax)) >= 0.0
                    and sign * ((cx - bx) * (y - by) - (cy - by) * (x - bx)) >= 0.0
                    and sign * ((ax - cx) * (y - cy) - (ay - cy) * (x - cx)) >= 0.0
                    and distance < depth[y, x]
                ):
                    depth[y, x], light[y, x], mask[y, x] = distance, shades[t], 255
