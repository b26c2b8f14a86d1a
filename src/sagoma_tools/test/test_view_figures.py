"""People as the page draws them: where the balls and spindles lie, their colours, and when they are kept."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from sagoma_tools.overlays import BONES
from sagoma_tools.view.scene import GREEN, HEAD_M, RED, Figure, instances_of, rotations_of_z_onto, unit_sphere
from stick_figure.skeleton import POINT_NAMES

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
