"""The room in 3D: floor, cameras, skeletons coloured by how sure each point is, hull voxels."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import viser
import viser.transforms

from capture_rig.rig import Rig

from ..overlays.drawing import BONES

Array = np.ndarray

SURE_M, UNSURE_M = 0.02, 0.12
"""Standard deviation of a point that is drawn green, and red: a joint's own width, and a limb's error of one lost."""
GREEN, AMBER, RED = np.array([60, 190, 90.0]), np.array([240, 170, 30.0]), np.array([220, 50, 45.0])
BONE_M, JOINT_M, VOXEL_M = 0.035, 0.07, 0.02
FRUSTUM_M = 0.2
CAMERA_COLOUR, LOST_COLOUR = (150, 160, 190), (229, 72, 77)
FLOOR_M = 6.0


@dataclass(frozen=True, eq=False)
class Figure:
    """One person at one instant: points_world (15, 3) m, sigma_m (15,) standard deviations, the tracker's state."""

    points_world: Array
    sigma_m: Array
    state: str


class RoomScene:
    """Draws into a viser scene; everything is sent once and then moved."""

    def __init__(self, scene: viser.SceneApi) -> None:
        self._scene = scene
        self._figures: dict[str, tuple[viser.LineSegmentsHandle, viser.PointCloudHandle, viser.LabelHandle]] = {}
        self._cameras: dict[str, tuple[viser.CameraFrustumHandle, viser.LabelHandle]] = {}
        self._voxels: viser.PointCloudHandle | None = None
        scene.set_up_direction("+z")
        scene.add_grid("/floor", FLOOR_M, FLOOR_M, cell_size=0.5, section_size=1.0)

    def show_rig(self, rig: Rig) -> None:
        """Draw every camera as its view's pyramid, with its name."""
        for nodes in self._cameras.values():
            for node in nodes:
                node.remove()
        self._cameras = {}
        for camera in rig.cameras:
            R_world_camera = camera.R_camera_world.T
            fov = 2.0 * float(np.arctan(0.5 * camera.height / camera.K[1, 1]))
            frustum = self._scene.add_camera_frustum(
                f"/cameras/{camera.name}",
                fov,
                camera.width / camera.height,
                scale=FRUSTUM_M,
                color=CAMERA_COLOUR,
                wxyz=viser.transforms.SO3.from_matrix(R_world_camera).wxyz,
                position=camera.centre_world,
            )
            label = self._scene.add_label(f"/cameras/{camera.name}/name", camera.name)
            self._cameras[camera.name] = frustum, label

    def mark_cameras(self, troubles: Mapping[str, str]) -> None:
        """Draw cameras in trouble red, with the trouble beside their name; all others as ever."""
        for name, (frustum, label) in self._cameras.items():
            text = f"{name}: {troubles[name]}" if name in troubles else name
            if label.text != text:
                label.text = text
                frustum.color = LOST_COLOUR if name in troubles else CAMERA_COLOUR

    def show(self, figures: dict[str, Figure]) -> None:
        """Draw these persons, by id, and nobody else."""
        for body_id in [body_id for body_id in self._figures if body_id not in figures]:
            for handle in self._figures.pop(body_id):
                handle.remove()
        for body_id, figure in figures.items():
            colours = confidence_colours(figure)
            ends = figure.points_world[BONES].astype(np.float32)
            bone_colours = colours[BONES]
            points = figure.points_world.astype(np.float32)
            if body_id not in self._figures:
                name = f"/people/{body_id}"
                bones = self._scene.add_line_segments(f"{name}/bones", ends, bone_colours, thickness=BONE_M)
                joints = self._scene.add_point_cloud(
                    f"{name}/joints", points, colours, point_size=JOINT_M, point_shape="circle", precision="float32"
                )
                label = self._scene.add_label(f"{name}/name", body_id, position=points[1], anchor="bottom-center")
                self._figures[body_id] = bones, joints, label
                continue
            bones, joints, label = self._figures[body_id]
            bones.points, bones.colors = ends, bone_colours
            joints.points, joints.colors = points, colours
            label.position = points[1]

    def show_voxels(self, points_world: Array | None) -> None:
        """Draw the hull's voxels (m, 3), or none."""
        if self._voxels is not None:
            self._voxels.remove()
            self._voxels = None
        if points_world is not None and len(points_world):
            self._voxels = self._scene.add_point_cloud(
                "/hull", points_world.astype(np.float32), (120, 140, 200), point_size=VOXEL_M, precision="float32"
            )


def confidence_colours(figure: Figure) -> Array:
    """(15, 3) uint8: green for sure points, amber, red for unsure ones; all red when the person is lost."""
    doubt = np.clip((figure.sigma_m - SURE_M) / (UNSURE_M - SURE_M), 0.0, 1.0)
    if figure.state == "lost":
        doubt = np.ones_like(doubt)
    low = GREEN + (AMBER - GREEN) * np.minimum(2.0 * doubt, 1.0)[:, None]
    return (low + (RED - AMBER) * np.maximum(2.0 * doubt - 1.0, 0.0)[:, None]).astype(np.uint8)
