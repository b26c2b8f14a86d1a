"""What the page draws of people, and where browsers' views of it stand: and what fills them."""

from contextlib import nullcontext
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from capture_rig.camera import looking_at
from sagoma_tools.overlays import BONES
from sagoma_tools.view.scene import (
    ASPECT,
    FOV_RAD,
    GREEN,
    HEAD_M,
    RED,
    Figure,
    Viewpoint,
    corners_of,
    instances_of,
    rotations_of_z_onto,
    unit_sphere,
)
from stick_figure.skeleton import POINT_NAMES
from virtual_studio.rig import ring

STANDING = np.random.default_rng(5).uniform([-0.4, -0.4, 0.0], [0.4, 0.4, 1.8], (15, 3))
STANDING[:2, 2] = 0.0, 1.8


class Views:
    """A server's views as viser keeps them, without a browser."""

    def __init__(self, count):
        self.initial_camera = SimpleNamespace(position=None, look_at=None, fov=None)
        self.cameras = [SimpleNamespace() for _ in range(count)]

    def get_clients(self):
        return {k: SimpleNamespace(camera=camera, atomic=nullcontext) for k, camera in enumerate(self.cameras)}


def on_screen(views, points):
    """(n, 2) places on the screen, its edges at -1 and 1."""
    position, look_at = np.asarray(views.initial_camera.position), np.asarray(views.initial_camera.look_at)
    T = looking_at(position, look_at)
    x, y, z = (points @ T[:3, :3].T + T[:3, 3]).T
    return np.column_stack([x / ASPECT, y]) / (z * np.tan(0.5 * FOV_RAD))[:, None]


def at(x, y):
    return STANDING + np.array([x, y, 0.0])


def person_at(x, y):
    return {"b0001": Figure(at(x, y), np.full(15, 0.01), "tracking")}


def test_the_first_view_is_filled_by_the_rigs_volume_and_cameras():
    rig = ring(4)
    views = Views(0)
    Viewpoint(views).show_rig(rig)
    shown = [*corners_of(rig.volume.low, rig.volume.high), *(camera.centre_world for camera in rig.cameras)]
    assert 0.85 < np.abs(on_screen(views, np.array(shown))).max() < 1.0


def test_a_standing_person_fills_every_view_once_tracked_and_then_views_are_left_alone():
    views = Views(2)
    viewpoint = Viewpoint(views)
    viewpoint.show_people({"b0001": Figure(at(3.0, 0.0), np.full(15, 0.3), "lost")})
    viewpoint.show_people(person_at(3.0, 1.5))
    places = on_screen(views, at(3.0, 1.5))
    assert np.abs(places).max() < 1.0 and np.ptp(places[:, 1]) > 0.8  # of 2
    assert all(np.array_equal(camera.position, views.initial_camera.position) for camera in views.cameras)
    before = views.cameras[0].position
    viewpoint.show_people(person_at(5.0, 0.0))
    assert views.cameras[0].position is before


# --- balls and spindles

POINTS = np.random.default_rng(3).uniform(-1.0, 2.0, (15, 3))


def test_spindles_reach_from_joint_to_joint_and_balls_lie_on_the_joints():
    drawn = instances_of(Figure(POINTS, np.full(15, 0.01), "tracking"))
    assert np.allclose(drawn.positions[:15], POINTS, atol=1e-6)
    assert drawn.scales[POINT_NAMES.index("head")] == pytest.approx([HEAD_M] * 3)
    tips = Rotation.from_quat(drawn.wxyzs[15:], scalar_first=True).apply([0.0, 0.0, 1.0]) * drawn.scales[15:, 2:]
    assert np.allclose(drawn.positions[15:] - tips, POINTS[BONES[:, 0]], atol=1e-5)
    assert np.allclose(drawn.positions[15:] + tips, POINTS[BONES[:, 1]], atol=1e-5)


def test_the_z_axis_is_turned_onto_every_direction_down_and_nowhere_too():
    directions = np.array([[0.0, 0.0, 2.0], [0.0, 0.0, -0.5], [1.0, 0.0, 0.0], [0.3, -2.0, -0.1], [0.0, 0.0, 0.0]])
    turned = Rotation.from_quat(rotations_of_z_onto(directions), scalar_first=True).apply([0.0, 0.0, 1.0])
    assert np.allclose(turned[:4] * np.linalg.norm(directions[:4], axis=1)[:, None], directions[:4], atol=1e-9)
    assert np.isfinite(turned).all()


def test_sure_points_are_green_unsure_ones_red_and_all_of_somebody_lost():
    sigma = np.full(15, 0.01)
    sigma[POINT_NAMES.index("left_hand")] = 0.3
    colours = instances_of(Figure(POINTS, sigma, "tracking")).colours[:15]
    assert (colours[POINT_NAMES.index("left_hand")] == RED).all() and (colours[0] == GREEN).all()
    assert (instances_of(Figure(POINTS, sigma, "lost")).colours == RED).all()


def test_the_sphere_is_closed_and_faces_outward():
    vertices, faces = unit_sphere()
    assert np.allclose(np.linalg.norm(vertices, axis=1), 1.0)
    a, b, c = (vertices[faces[:, k]].astype(float) for k in range(3))
    volume = np.einsum("ij,ij->i", a, np.cross(b, c)) / 6.0
    assert (volume > -1e-9).all() and 0.8 * 4.19 < volume.sum() < 4.19
