"""People in 3D: a ball a joint and a spindle a bone, all of one person one mesh of instances, coloured by certainty.

One mesh, because a browser's time goes by draw calls and messages, not by triangles: a person who moves is two or three
arrays a frame. Point clouds and line segments would be shorter to write, but viser's client builds the one's shader and
the other's buffers anew whenever colours or points change, which without a GPU takes longer than to draw the room.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import viser

from stick_figure.skeleton import POINT_NAMES

from ..overlays.drawing import BONES

Array = np.ndarray

SURE_M, UNSURE_M = 0.02, 0.12
"""Standard deviation of a point that is drawn green, and red: a joint's own width, and a limb's error of one lost."""
GREEN, AMBER, RED = np.array([60, 190, 90.0]), np.array([240, 170, 30.0]), np.array([220, 50, 45.0])
COLOUR_STEPS = 16
"""Shades between sure and unsure: fewer than the eye tells apart side by side, so that colours are seldom sent."""
JOINT_M, HEAD_M, BONE_M = 0.038, 0.085, 0.028
"""Radii of the balls and of a spindle's waist: a wrist's and a skull's, and thinner than any limb."""
SCALE_STEP_M = 0.002
"""Bones are sent anew when one has become longer or shorter by so much: less than anybody sees."""
SPHERE_MERIDIANS, SPHERE_PARALLELS = 12, 8
RADII = np.where(np.array(POINT_NAMES) == "head", HEAD_M, JOINT_M)
LABEL_ABOVE_HEAD_M = 0.16


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
    """One person in a viser scene, sent once and then moved."""

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
        self._sent = instances
        self._move_label(figure)

    def move(self, figure: Figure) -> None:
        """Send what has changed."""
        instances, mesh = instances_of(figure), self._mesh
        mesh.batched_positions, mesh.batched_wxyzs = instances.positions, instances.wxyzs
        scales, colours = self._sent.scales, self._sent.colours
        if np.abs(instances.scales - scales).max() > SCALE_STEP_M:
            mesh.batched_scales = scales = instances.scales
        if not np.array_equal(instances.colours, colours):
            mesh.batched_colors = colours = instances.colours
        self._sent = Instances(instances.positions, instances.wxyzs, scales, colours)
        self._move_label(figure)

    def remove(self) -> None:
        """Take the person out of the scene."""
        self._mesh.remove()
        self._label.remove()

    def _move_label(self, figure: Figure) -> None:
        x, y, z = figure.points_world[POINT_NAMES.index("head")]
        self._label.position = x, y, z + LABEL_ABOVE_HEAD_M


def instances_of(figure: Figure) -> Instances:
    """Return the balls of a person's points, then the spindles of the bones between them."""
    points, colours = figure.points_world, confidence_colours(figure)
    begins, ends = points[BONES[:, 0]], points[BONES[:, 1]]
    along = ends - begins
    length = np.linalg.norm(along, axis=1)
    waist = np.full(len(BONES), BONE_M)
    scales = np.concatenate([np.repeat(RADII[:, None], 3, 1), np.column_stack([waist, waist, 0.5 * length])])
    turns = np.concatenate([np.tile([1.0, 0.0, 0.0, 0.0], (len(points), 1)), rotations_of_z_onto(along)])
    shades = np.concatenate([colours, colours[BONES].mean(1).astype(np.uint8)])
    positions = np.concatenate([points, 0.5 * (begins + ends)])
    return Instances(positions.astype(np.float32), turns.astype(np.float32), scales.astype(np.float32), shades)


def rotations_of_z_onto(directions: Array) -> Array:
    """Quaternions wxyz (n, 4) of the shortest turns of the z axis onto directions (n, 3), of any length but zero."""
    length = np.linalg.norm(directions, axis=1, keepdims=True)
    x, y, z = (directions / np.where(length > 0.0, length, 1.0)).T
    halves = np.column_stack([1.0 + z, -y, x, np.zeros_like(x)])
    norm = np.linalg.norm(halves, axis=1, keepdims=True)
    upside_down = norm < 1e-6  # half a turn, about any axis across
    return np.where(upside_down, [0.0, 1.0, 0.0, 0.0], halves / np.where(upside_down, 1.0, norm))


def confidence_colours(figure: Figure) -> Array:
    """(15, 3) uint8: green for sure points, amber, red for unsure ones; all red when the person is lost."""
    doubt = np.clip((figure.sigma_m - SURE_M) / (UNSURE_M - SURE_M), 0.0, 1.0)
    doubt = np.round(doubt * COLOUR_STEPS) / COLOUR_STEPS
    if figure.state == "lost":
        doubt = np.ones_like(doubt)
    low = GREEN + (AMBER - GREEN) * np.minimum(2.0 * doubt, 1.0)[:, None]
    return (low + (RED - AMBER) * np.maximum(2.0 * doubt - 1.0, 0.0)[:, None]).astype(np.uint8)


def unit_sphere() -> tuple[Array, Array]:
    """Return vertices (n, 3) and outward faces (m, 3) of a unit sphere, few enough for a browser without a GPU."""
    polar = np.linspace(0.0, np.pi, SPHERE_PARALLELS + 1)
    around = np.linspace(0.0, 2.0 * np.pi, SPHERE_MERIDIANS, endpoint=False)
    ring = np.column_stack([np.cos(around), np.sin(around)])
    vertices = np.concatenate([np.column_stack([np.sin(p) * ring, np.full(len(ring), np.cos(p))]) for p in polar])
    row, column = np.divmod(np.arange(SPHERE_PARALLELS * SPHERE_MERIDIANS), SPHERE_MERIDIANS)
    right = (column + 1) % SPHERE_MERIDIANS
    here, beside = row * SPHERE_MERIDIANS + column, row * SPHERE_MERIDIANS + right
    below, across = here + SPHERE_MERIDIANS, beside + SPHERE_MERIDIANS
    faces = np.concatenate([np.column_stack([here, below, across]), np.column_stack([here, across, beside])])
    return vertices.astype(np.float32), faces.astype(np.uint32)
