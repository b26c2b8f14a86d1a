"""The room in 3D: floor, cameras, skeletons coloured by uncertainty, hull voxels; viewpoints."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import viser
import viser.transforms

from capture_rig.rig import Rig
from stick_figure.skeleton import POINT_NAMES

from ..overlays import BONES

Array = np.ndarray

VOXEL_M, VOXEL_COLOUR = 0.006, (120, 140, 200)  # small, so that the skeleton inside is seen
FRUSTUM_M, FRUSTUM_LINE_M = 0.2, 0.008
NAME_ABOVE = np.array([0.0, 0.0, 0.1])
"""Of a name, m above a camera's centre, or a person's point of the head."""
CAMERA_COLOUR = 130, 145, 185
FLOOR_M, CELL_M, FLOOR_COLOUR = 6.0, 0.5, (96, 102, 114)
FOV_RAD = np.deg2rad(50.0)
"""Vertical: a person is not distorted at the edges, and a room of four metres fits from five away."""
AZIMUTH_RAD, ELEVATION_RAD = np.deg2rad(-22.5), np.deg2rad(15.0)
LEVEL = np.cos(ELEVATION_RAD)
BACKWARD = np.array([LEVEL * np.cos(AZIMUTH_RAD), LEVEL * np.sin(AZIMUTH_RAD), np.sin(ELEVATION_RAD)])
"""Direction of a viewpoint: above, at the front right, between the cameras of a ring of four or eight."""
ROOM = np.array([[-1.4, -1.4, 0.0], [1.4, 1.4, 2.2]])
"""Corners of the room that is shown while no rig is known, m."""
PERSON_M = 1.2
"""Radius about a person's middle that is shown: of somebody tall with stretched arms."""


class ViewerScene:
    """Draws into a server's scene; everything is sent once and then moved.

    Views show the rig's volume and cameras or, once somebody is tracked, the persons, and are the browsers' own then.
    """

    def __init__(self, server: viser.ViserServer) -> None:
        scene = self._scene = server.scene
        self._server = server
        self._people: dict[str, DrawnPerson] = {}
        self._cameras: list[viser.SceneNodeHandle] = []
        scene.set_up_direction("+z")
        scene.configure_default_lights(enabled=False)  # nothing here is lit: shadows and reflections would cost a
        scene.configure_environment_map(None)  # browser without a GPU seconds until it has made ready
        scene.add_line_segments("/floor", floor_lines(), FLOOR_COLOUR, thickness=1.0, thickness_units="screen")
        nothing = np.empty((0, 3), np.float32)
        self._voxels = scene.add_point_cloud("/hull", nothing, VOXEL_COLOUR, point_size=VOXEL_M, precision="float32")
        server.initial_camera.fov = FOV_RAD
        self.show_rig(None)

    def show_rig(self, rig: Rig | None) -> None:
        """Draw every camera as its view's pyramid, with its name; without a rig none."""
        shown = [*ROOM] if rig is None else [rig.volume.low, rig.volume.high, *(c.centre_world for c in rig.cameras)]
        self._point_views_at(np.array(shown))
        self._on_people = False
        while self._cameras:
            self._cameras.pop().remove()
        for camera in rig.cameras if rig is not None else ():
            frustum = self._scene.add_camera_frustum(
                f"/cameras/{camera.name}",
                2.0 * float(np.arctan(0.5 * camera.height / camera.K[1, 1])),
                camera.width / camera.height,
                scale=FRUSTUM_M,
                thickness=FRUSTUM_LINE_M,
                color=CAMERA_COLOUR,
                wxyz=viser.transforms.SO3.from_matrix(camera.R_camera_world.T).wxyz,
                position=camera.centre_world,
            )
            # not below the frustum in the tree: viser's client would draw it at the origin until that has moved
            name, place = f"/camera_names/{camera.name}", camera.centre_world + NAME_ABOVE
            label = self._scene.add_label(name, camera.name, anchor="bottom-center", position=place)
            self._cameras += [frustum, label]

    def show(self, figures: Mapping[str, PersonPose]) -> None:
        """Draw these persons, by id, and nobody else."""
        tracked = [figure.points_world for figure in figures.values() if figure.state != "lost"]
        if tracked and not self._on_people:
            self._on_people = True
            self._point_views_at(np.concatenate(tracked), PERSON_M)
        for body_id in [body_id for body_id in self._people if body_id not in figures]:
            self._people.pop(body_id).remove()
        for body_id, figure in figures.items():
            if body_id in self._people:
                self._people[body_id].move(figure)
            else:
                self._people[body_id] = DrawnPerson(self._scene, body_id, figure)

    def show_voxels(self, points_world: Array | None) -> None:
        """Draw the hull's voxels (m, 3), or none."""
        points = np.empty((0, 3)) if points_world is None else points_world
        self._voxels.points = points.astype(np.float32)

    def _point_views_at(self, points_world: Array, radius_m: float = 0.0) -> None:
        """Show the ball about these points (n, 3), of this radius at least, in all views and in those to come."""
        middle = 0.5 * (points_world.min(0) + points_world.max(0))
        radius_m = max(radius_m, np.linalg.norm(points_world - middle, axis=1).max())
        place = middle + radius_m / np.sin(0.5 * FOV_RAD) * BACKWARD
        self._server.initial_camera.position, self._server.initial_camera.look_at = place, middle
        for client in self._server.get_clients().values():
            with client.atomic():
                client.camera.position, client.camera.look_at = place, middle


def floor_lines() -> Array:
    """(n, 2, 3) m: a square of cells about the origin."""
    half = 0.5 * FLOOR_M
    at = np.linspace(-half, half, round(FLOOR_M / CELL_M) + 1)
    along_x = np.stack([np.stack([np.full_like(at, x), at, np.zeros_like(at)], 1) for x in (-half, half)], 1)
    return np.concatenate([along_x, along_x[..., [1, 0, 2]]]).astype(np.float32)


# people ---------------------------------------------------------------------------------------------------------------


SURE_M, UNSURE_M = 0.02, 0.12
"""Standard deviation of a point that is drawn green, and red: a joint's own width, and a limb's error of one lost."""
GREEN, AMBER, RED = np.array([60, 190, 90.0]), np.array([240, 170, 30.0]), np.array([220, 50, 45.0])
HEAD = slice(POINT_NAMES.index("head"), POINT_NAMES.index("head") + 1)
JOINT_M, HEAD_M, BONE_M = 0.038, 0.085, 0.04
"""Radii of joints and head: a wrist's and a skull's; thickness of a bone's line."""


@dataclass(frozen=True, eq=False)
class PersonPose:
    """One person at one instant: points_world (15, 3) m, sigma_m (15,) standard deviations, the tracker's state."""

    points_world: Array
    sigma_m: Array
    state: str


class DrawnPerson:
    """One person in a viser scene, sent once and then moved; viser sends the changes."""

    def __init__(self, scene: viser.SceneApi, body_id: str, figure: PersonPose) -> None:
        points, colours = figure.points_world.astype(np.float32), confidence_colours(figure)

        def balls(name: str, which: slice, radius_m: float) -> viser.PointCloudHandle:
            place = f"/people/{body_id}/{name}", points[which], colours[which]
            return scene.add_point_cloud(*place, point_size=radius_m, point_shape="circle", precision="float32")

        self._joints, self._head = balls("joints", slice(None), JOINT_M), balls("head", HEAD, HEAD_M)
        bones = f"/people/{body_id}/bones", points[BONES], colours[BONES]
        self._bones = scene.add_line_segments(*bones, thickness=BONE_M)
        self._label = scene.add_label(f"/names/{body_id}", body_id, anchor="bottom-center")
        self.move(figure)

    def move(self, figure: PersonPose) -> None:
        """Draw the person there."""
        points, colours = figure.points_world.astype(np.float32), confidence_colours(figure)
        self._joints.points, self._joints.colors = points, colours
        self._head.points, self._head.colors = points[HEAD], colours[HEAD]
        self._bones.points, self._bones.colors = points[BONES], colours[BONES]
        self._label.position = figure.points_world[HEAD][0] + NAME_ABOVE

    def remove(self) -> None:
        """Remove the person from the scene."""
        for node in (self._joints, self._head, self._bones, self._label):
            node.remove()


def confidence_colours(figure: PersonPose) -> Array:
    """(15, 3) uint8: green for sure points, amber, red for unsure ones; all red when the person is lost."""
    doubt = np.clip((figure.sigma_m - SURE_M) / (UNSURE_M - SURE_M), 0.0, 1.0)
    if figure.state == "lost":
        doubt = np.ones_like(doubt)
    low = GREEN + (AMBER - GREEN) * np.minimum(2.0 * doubt, 1.0)[:, None]
    return (low + (RED - AMBER) * np.maximum(2.0 * doubt - 1.0, 0.0)[:, None]).astype(np.uint8)
