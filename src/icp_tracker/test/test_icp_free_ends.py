"""Hands that bend at the wrist and feet that turn at the ankle, while the figure's pose says nothing of them."""

from dataclasses import replace

import numpy as np
import pytest
import refinement_rays as made

from capture_rig.rigid import rotation_matrix
from icp_tracker.articulated_fit import ArticulatedSettings, ContourSettings, VolumeSettings, fit_articulated
from stick_figure.body import Body
from stick_figure.body_surface import END_CAPSULES, BodySurface
from stick_figure.kinematics import forward

FREE = ArticulatedSettings(volume=VolumeSettings(weight=0.0), max_iterations=20)
STIFF = replace(FREE, contour=ContourSettings(turn_sd=0.0))
HAND, FOOT = END_CAPSULES[0], END_CAPSULES[2]


@pytest.fixture(scope="module")
def bent():
    """A body whose left hand is bent at the wrist and left foot at the ankle, the rays of it, and its pose."""
    rng, body = np.random.default_rng(3), Body.from_stature(1.75)
    pose, surface = made.moving_pose(rng), BodySurface.of(body)
    start, end = surface.start.copy(), surface.end.copy()
    end[HAND] = start[HAND] + rotation_matrix(np.array([0.5, 0.0, 0.3])) @ (end[HAND] - start[HAND])
    ankle, R = np.array([0.0, 0.0, -body.lengths[8]]), rotation_matrix(np.array([0.0, 0.5, 0.0]))
    start[FOOT], end[FOOT] = ankle + R @ (start[FOOT] - ankle), ankle + R @ (end[FOOT] - ankle)
    rays = made.rays_on(body, surface._replace(start=start, end=end), pose, rng, each=24)
    return body, pose, rays


def fitted(bent, settings):
    body, pose, rays = bent
    points = np.zeros((1, 3))  # far from everything
    return fit_articulated(body, pose, points, settings=settings, contour_rays=rays).reference_points_world


def test_bent_hand_and_foot_leave_elbow_and_ankle_where_they_are(bent):
    body, pose, _ = bent
    truth = forward(body, pose)
    free, stiff = (np.linalg.norm(fitted(bent, s) - truth, axis=1) for s in (FREE, STIFF))
    assert free[[7, 9, 13]].max() < 0.015  # left elbow, knee, ankle
    assert free[[7, 9, 13]].mean() < 0.85 * stiff[[7, 9, 13]].mean()


def test_hand_tip_follows_the_hand(bent):
    body, pose, _ = bent
    surface, truth = BodySurface.of(body), forward(body, pose)
    wrist, tip = surface.start[HAND], np.array([0.0, body.lengths[6], 0.0])
    shift = rotation_matrix(np.array([0.5, 0.0, 0.3])) @ (tip - wrist) - (tip - wrist)
    moved = np.linalg.norm(fitted(bent, FREE)[11] - truth[11])
    assert moved == pytest.approx(np.linalg.norm(shift), rel=0.35)


def test_reference_points_of_an_ideal_figure_are_those_of_its_pose(bent):
    body, pose, rays = bent
    for settings, rigid in ((ArticulatedSettings.of_ideal_figure(), True), (ArticulatedSettings(), False)):
        fit = fit_articulated(body, pose, np.zeros((1, 3)), settings=settings, contour_rays=rays)
        off = np.linalg.norm(fit.reference_points_world - forward(body, fit.pose), axis=1)
        assert (off.max() < 1e-9) == rigid
