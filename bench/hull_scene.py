"""The scene that the hull's benchmark carves: the built-in body in several poses, seen by a ring of cameras."""

from __future__ import annotations

from functools import cache

import numpy as np

from capture_rig import Rig, Volume
from stick_figure.body import Body
from virtual_studio.motions.catalogue import tour
from virtual_studio.people import Capsules, VolumetricBody
from virtual_studio.rendering.camera import VirtualCamera
from virtual_studio.rig import ring

VOLUME = Volume(np.array([-1.25, -1.25, 0.0]), np.array([1.25, 1.25, 2.2]))
STATURE_M, TOUR_S, TOUR_FPS = 1.75, 12.0, 10.0
PLACES_M = ((0.6, 0.5), (-0.6, 0.5), (0.0, -0.6))  # how far several bodies are shifted

Masks = dict[str, np.ndarray]


@cache
def scene(cameras: int, poses: int, bodies: int = 1) -> tuple[Rig, list[Masks]]:
    """A ring of cameras and one above, 640 x 480 with lens distortion, and exact canvas silhouettes.

    The bodies move through ``poses`` poses of the built-in tour, side by side.
    """
    rig = Rig(ring(cameras - 1).cameras, VOLUME)
    eyes = {camera.name: VirtualCamera(camera) for camera in rig.cameras}
    body = Body.from_stature(STATURE_M)
    motion = tour(body, TOUR_S, TOUR_FPS)
    frames = []
    for index in np.linspace(0, len(motion.poses) - 1, poses).astype(int):
        capsules = _side_by_side(VolumetricBody(body).place(motion.poses[index]), bodies)
        seen = {name: eye.render(capsules, None)[1] for name, eye in eyes.items()}
        frames.append({c.name: c.undistorted_view().undistort_mask(seen[c.name]) for c in rig.cameras})
    return rig, frames


def _side_by_side(capsules: Capsules, bodies: int) -> Capsules:
    places = np.column_stack([PLACES_M[:bodies], np.zeros(bodies)]) if bodies > 1 else np.zeros((1, 3))
    starts, ends = (np.concatenate([points + place for place in places]) for points in (capsules.starts, capsules.ends))
    return Capsules(starts, ends, np.tile(capsules.radii, (len(places), 1)), np.tile(capsules.albedo, len(places)))
