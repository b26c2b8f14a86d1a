"""The room in 3D: floor, cameras, skeletons coloured by how sure each point is, hull voxels; where views stand."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import viser
import viser.transforms
from scipy.spatial import ConvexHull
from scipy.spatial.transform import Rotation

from capture_rig.rig import Rig
from stick_figure.skeleton import POINT_NAMES

from ..overlays import BONES

Array = np.ndarray

VOXEL_M, VOXEL_COLOUR = 0.006, (120, 140, 200)  # small: whoever is inside is seen
FRUSTUM_M, FRUSTUM_LINE_M = 0.2, 0.008
NAME_ABOVE = np.array([0.0, 0.0, 0.1])
"""Of a name, m above a camera's centre, or a person's point of the head."""
CAMERA_COLOUR, LOST_COLOUR = (130, 145, 185), (229, 72, 77)
FLOOR_M, CELL_M, FLOOR_COLOUR = 6.0, 0.5, (96, 102, 114)
SUN = (2.0, -1.0, 4.0)
"""Whence the light comes: above, from where a view begins."""


class RoomScene:
    """Draws into a server's scene; everything is sent once and then moved."""

    def __init__(self, server: viser.ViserServer) -> None:
        scene = self._scene = server.scene
        self._view = Viewpoint(server)
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
        """Draw every camera as its view's pyramid, with its name; without a rig none. Views look at the rig."""
        self._view.show_rig(rig)
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
            label.text = f"{name}: {troubles[name]}" if name in troubles else name
            frustum.color = LOST_COLOUR if name in troubles else CAMERA_COLOUR

    def show(self, figures: Mapping[str, Figure]) -> None:
        """Draw these persons, by id, and nobody else; views look at them once somebody is tracked."""
        self._view.show_people(figures)
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


# people ---------------------------------------------------------------------------------------------------------------


SURE_M, UNSURE_M = 0.02, 0.12
"""Standard deviation of a point that is drawn green, and red: a joint's own width, and a limb's error of one lost."""
GREEN, AMBER, RED = np.array([60, 190, 90.0]), np.array([240, 170, 30.0]), np.array([220, 50, 45.0])
JOINT_M, HEAD_M, BONE_M = 0.038, 0.085, 0.028
"""Radii of the balls and of a spindle's waist: a wrist's and a skull's, and thinner than any limb."""
SPHERE_POINTS = 110
"""Few enough for a browser without a GPU."""
RADII = np.where(np.array(POINT_NAMES) == "head", HEAD_M, JOINT_M)


@dataclass(frozen=True, eq=False)
class Figure:
    """One person at one instant: points_world (15, 3) m, sigma_m (15,) standard deviations, the tracker's state."""

    points_world: Array
    sigma_m: Array
    state: str


@dataclass(frozen=True, eq=False)
class Instances:
    """Where the unit sphere is drawn: positions (n, 3) m, wxyzs (n, 4), scales (n, 3) m, colours (n, 3) uint8."""

    positions: Array
    wxyzs: Array
    scales: Array
    colours: Array


class DrawnPerson:
    """One person in a viser scene, sent once and then moved; viser sends what has changed."""

    def __init__(self, scene: viser.SceneApi, body_id: str, figure: Figure) -> None:
        instances = instances_of(figure)
        self._mesh = scene.add_batched_meshes_simple(
            f"/people/{body_id}",
            *unit_sphere(),
            instances.wxyzs,
            instances.positions,
            batched_scales=instances.scales,
            batched_colors=instances.colours,
            lod="off",
            cast_shadow=False,
            receive_shadow=False,
        )
        self._label = scene.add_label(f"/names/{body_id}", body_id, anchor="bottom-center")
        self.move(figure)

    def move(self, figure: Figure) -> None:
        """Draw the person there."""
        instances, mesh = instances_of(figure), self._mesh
        mesh.batched_positions, mesh.batched_wxyzs = instances.positions, instances.wxyzs
        mesh.batched_scales, mesh.batched_colors = instances.scales, instances.colours
        self._label.position = figure.points_world[POINT_NAMES.index("head")] + NAME_ABOVE

    def remove(self) -> None:
        """Take the person out of the scene."""
        self._mesh.remove()
        self._label.remove()


def instances_of(figure: Figure) -> Instances:
    """Return the balls of a person's points, then the spindles of the bones between them."""
    points, colours = figure.points_world, confidence_colours(figure)
    begins, ends = points[BONES[:, 0]], points[BONES[:, 1]]
    along = ends - begins
    length = np.linalg.norm(along, axis=1).round(3)  # to the mm: what has not changed is not sent
    waist = np.full(len(BONES), BONE_M)
    scales = np.concatenate([np.repeat(RADII[:, None], 3, 1), np.column_stack([waist, waist, 0.5 * length])])
    turns = np.concatenate([np.tile([1.0, 0.0, 0.0, 0.0], (len(points), 1)), rotations_of_z_onto(along)])
    shades = np.concatenate([colours, colours[BONES].mean(1).astype(np.uint8)])
    positions = np.concatenate([points, 0.5 * (begins + ends)])
    return Instances(positions.astype(np.float32), turns.astype(np.float32), scales.astype(np.float32), shades)


def rotations_of_z_onto(directions: Array) -> Array:
    """Quaternions wxyz (n, 4) of turns of the z axis onto directions (n, 3): about y, then about z."""
    x, y, z = directions.T
    turns = Rotation.from_euler("ZY", np.column_stack([np.arctan2(y, x), np.arctan2(np.hypot(x, y), z)]))
    return turns.as_quat(scalar_first=True)


def confidence_colours(figure: Figure) -> Array:
    """(15, 3) uint8: green for sure points, amber, red for unsure ones; all red when the person is lost."""
    doubt = np.clip((figure.sigma_m - SURE_M) / (UNSURE_M - SURE_M), 0.0, 1.0)
    if figure.state == "lost":
        doubt = np.ones_like(doubt)
    low = GREEN + (AMBER - GREEN) * np.minimum(2.0 * doubt, 1.0)[:, None]
    return (low + (RED - AMBER) * np.maximum(2.0 * doubt - 1.0, 0.0)[:, None]).astype(np.uint8)


def unit_sphere() -> tuple[Array, Array]:
    """Return vertices (n, 3) and outward faces (m, 3) of a unit sphere: the hull of a Fibonacci spiral."""
    k = np.arange(SPHERE_POINTS) + 0.5
    z, around = 1.0 - 2.0 * k / SPHERE_POINTS, np.pi * (1.0 + np.sqrt(5.0)) * k
    level = np.sqrt(1.0 - z**2)
    vertices = np.column_stack([level * np.cos(around), level * np.sin(around), z])
    faces = ConvexHull(vertices).simplices
    inward = np.linalg.det(vertices[faces]) < 0.0
    faces[inward] = faces[inward, ::-1]
    return vertices.astype(np.float32), faces.astype(np.uint32)


# views ----------------------------------------------------------------------------------------------------------------


FOV_RAD = np.deg2rad(50.0)
"""Vertical: a person is not distorted at the edges, and a room of four metres fits from five away."""
AZIMUTH_RAD, ELEVATION_RAD = np.deg2rad(-22.5), np.deg2rad(15.0)
LEVEL = np.cos(ELEVATION_RAD)
BACKWARD = np.array([LEVEL * np.cos(AZIMUTH_RAD), LEVEL * np.sin(AZIMUTH_RAD), np.sin(ELEVATION_RAD)])
"""Whence a view looks: from above, and from the front to the right, between the cameras of a ring of four or eight."""
ROOM = np.array([[-1.4, -1.4, 0.0], [1.4, 1.4, 2.2]])
"""Corners of the room that is shown while no rig is known, m."""
PERSON_M = 1.2
"""Radius about a person's middle that is shown: of somebody tall with stretched arms."""


class Viewpoint:
    """Places browsers' views: the rig's volume fills the screen or, once somebody is tracked, the persons. From then on
    they are the browsers' own."""

    def __init__(self, server: viser.ViserServer) -> None:
        self._server = server
        server.initial_camera.fov = FOV_RAD
        self.show_rig(None)

    def show_rig(self, rig: Rig | None) -> None:
        """Look at its volume and cameras, until somebody is tracked."""
        shown = [*ROOM] if rig is None else [rig.volume.low, rig.volume.high, *(c.centre_world for c in rig.cameras)]
        self._on_people = False
        self._show(np.array(shown))

    def show_people(self, figures: Mapping[str, Figure]) -> None:
        """Look at who is tracked, the first time that somebody is."""
        tracked = [figure.points_world for figure in figures.values() if figure.state != "lost"]
        if tracked and not self._on_people:
            self._on_people = True
            self._show(np.concatenate(tracked), PERSON_M)

    def _show(self, points_world: Array, radius_m: float = 0.0) -> None:
        """Show the ball about these points (n, 3), of this radius at least, in all views and in those to come."""
        look_at = 0.5 * (points_world.min(0) + points_world.max(0))
        radius_m = max(radius_m, np.linalg.norm(points_world - look_at, axis=1).max())
        position = look_at + radius_m / np.sin(0.5 * FOV_RAD) * BACKWARD
        self._server.initial_camera.position, self._server.initial_camera.look_at = position, look_at
        for client in self._server.get_clients().values():
            with client.atomic():
                client.camera.position, client.camera.look_at = position, look_at
