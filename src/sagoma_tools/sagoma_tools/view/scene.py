"""The room in 3D: floor, cameras, skeletons coloured by how sure each point is, hull voxels."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import viser
import viser.transforms

from capture_rig.rig import Rig

from .figures import DrawnPerson, Figure

Array = np.ndarray

VOXEL_M, VOXEL_COLOUR = 0.006, (120, 140, 200)  # small: whoever is inside is seen
FRUSTUM_M, FRUSTUM_LINE_M = 0.2, 0.008
NAME_ABOVE = np.array([0.0, 0.0, 0.1])
"""Of a camera's name, m above its centre."""
CAMERA_COLOUR, LOST_COLOUR = (130, 145, 185), (229, 72, 77)
FLOOR_M, CELL_M, FLOOR_COLOUR = 6.0, 0.5, (96, 102, 114)
SUN = (2.0, -1.0, 4.0)
"""Whence the light comes: above, from where a view begins."""


class RoomScene:
    """Draws into a viser scene; everything is sent once and then moved."""

    def __init__(self, scene: viser.SceneApi) -> None:
        self._scene = scene
        self._people: dict[str, DrawnPerson] = {}
        self._cameras: dict[str, tuple[viser.CameraFrustumHandle, viser.LabelHandle]] = {}
        self._voxels: viser.PointCloudHandle | None = None
        scene.set_up_direction("+z")
        scene.configure_default_lights(enabled=False)  # three cascades of shadows, and
        scene.configure_environment_map(None)  # reflections: seconds until a browser without a GPU has made ready
        scene.add_light_hemisphere("/light/sky", sky_color=(255, 255, 255), ground_color=(90, 90, 110), intensity=1.6)
        scene.add_light_directional("/light/sun", intensity=2.2, position=SUN)
        scene.add_line_segments("/floor", floor_lines(), FLOOR_COLOUR, thickness=1.0, thickness_units="screen")

    def show_rig(self, rig: Rig | None) -> None:
        """Draw every camera as its view's pyramid, with its name; without a rig none."""
        for nodes in self._cameras.values():
            for node in nodes:
                node.remove()
        self._cameras = {}
        for camera in rig.cameras if rig is not None else ():
            R_world_camera = camera.R_camera_world.T
            fov = 2.0 * float(np.arctan(0.5 * camera.height / camera.K[1, 1]))
            frustum = self._scene.add_camera_frustum(
                f"/cameras/{camera.name}",
                fov,
                camera.width / camera.height,
                scale=FRUSTUM_M,
                thickness=FRUSTUM_LINE_M,
                color=CAMERA_COLOUR,
                wxyz=viser.transforms.SO3.from_matrix(R_world_camera).wxyz,
                position=camera.centre_world,
            )
            # not below the frustum in the tree: viser's client would draw it at the origin until that has moved
            place = camera.centre_world + NAME_ABOVE
            label = self._scene.add_label(
                f"/camera_names/{camera.name}", camera.name, anchor="bottom-center", position=place
            )
            self._cameras[camera.name] = frustum, label

    def mark_cameras(self, troubles: Mapping[str, str]) -> None:
        """Draw cameras in trouble red, with the trouble beside their name; all others as ever."""
        for name, (frustum, label) in self._cameras.items():
            text = f"{name}: {troubles[name]}" if name in troubles else name
            if label.text != text:
                label.text = text
                frustum.color = LOST_COLOUR if name in troubles else CAMERA_COLOUR

    def show(self, figures: Mapping[str, Figure]) -> None:
        """Draw these persons, by id, and nobody else."""
        for body_id in [body_id for body_id in self._people if body_id not in figures]:
            self._people.pop(body_id).remove()
        for body_id, figure in figures.items():
            if body_id in self._people:
                self._people[body_id].move(figure)
            else:
                self._people[body_id] = DrawnPerson(self._scene, body_id, figure)

    def show_voxels(self, points_world: Array | None) -> None:
        """Draw the hull's voxels (m, 3), or none."""
        if points_world is None or not len(points_world):
            if self._voxels is not None:
                self._voxels.remove()
                self._voxels = None
            return
        points = points_world.astype(np.float32)
        if self._voxels is None:
            self._voxels = self._scene.add_point_cloud(
                "/hull", points, VOXEL_COLOUR, point_size=VOXEL_M, precision="float32"
            )
        else:
            self._voxels.points = points


def floor_lines() -> Array:
    """(n, 2, 3) m: a square of cells about the origin."""
    half = 0.5 * FLOOR_M
    at = np.linspace(-half, half, round(FLOOR_M / CELL_M) + 1)
    along_x = np.stack([np.stack([np.full_like(at, x), at, np.zeros_like(at)], 1) for x in (-half, half)], 1)
    return np.concatenate([along_x, along_x[..., [1, 0, 2]]]).astype(np.float32)
