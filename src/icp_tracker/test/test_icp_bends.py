"""What the pose says nothing of: a trunk that bends, hands and feet that turn."""

from dataclasses import replace

import numpy as np
import pytest
import refinement_rays as made
import synthetic_people as synthetic

from capture_rig.rigid import rotation_matrix
from icp_tracker.articulated_fit import ArticulatedSettings, ContourSettings, VolumeSettings, make_data, minimise
from icp_tracker.monitor.evidence import match_to
from icp_tracker.refinement.bend_estimator import TrunkBendEstimator
from mocap_packets.hull import NO_VOXELS
from stick_figure.body import BEND_NUMBERS, Body
from stick_figure.body_surface import EXTREMITY_CAPSULES, BodySurface
from stick_figure.kinematics import forward
from stick_figure.least_squares.posed_model import BodyModel, PoseState
from stick_figure.trunk_bend import LEFT_Z, PELVIS_YAW, RIGHT_X

BENDS = ArticulatedSettings(volume=VolumeSettings(weight=0.0))
RIGID = replace(BENDS, contour=replace(BENDS.contour, rigid=True))
FRAME_NS = 16_666_667
BEND = np.zeros(BEND_NUMBERS)
BEND[[LEFT_Z, PELVIS_YAW, RIGHT_X]] = 0.04, 0.12, 0.02


@pytest.fixture(scope="module")
def followed():
    """A body with a bent trunk in one pose, the bend that was found after a second, and the points' errors (m) with
    and without it."""
    rng, body = np.random.default_rng(5), Body.from_stature(1.75)
    pose, bent = made.moving_pose(rng), body.bent(BEND)
    rays = made.rays_on(bent, BodyModel.of(bent).surface, pose, rng, each=40)
    errors = []
    for settings in (BENDS, RIGID):
        trunk, found = TrunkBendEstimator(settings), pose
        data = make_data(np.zeros((1, 3)), 0.0, NO_VOXELS, settings, rays)
        for k in range(60):
            found, _, _ = minimise(trunk.of(body), found, data, settings)
            match = match_to(BodyModel.of(trunk.of(body)), PoseState.of(found), data)
            trunk.update(k * FRAME_NS, body, found, data.contour_rays, match)
        errors.append(np.linalg.norm(forward(trunk.of(body), found) - forward(bent, pose), axis=1))
    return trunk, errors


def test_shoulders_and_hips_are_found_where_they_have_moved(followed):
    _, (bends, rigid) = followed
    assert bends.mean() < 0.6 * rigid.mean()
    assert bends[3] < 0.6 * rigid[3]
    assert bends[[4, 5, 6]].max() < 0.01 < rigid[3]


def test_rigid_torso_stays_at_rest(followed):
    trunk, _ = followed  # the last one, of the setting 0
    body = Body.from_stature(1.75)
    assert trunk.of(body) is body and not trunk.bend.any()


# --- hands that bend at the wrist and feet that turn at the ankle -----------------------------------------------------

FREE = ArticulatedSettings(volume=VolumeSettings(weight=0.0), max_iterations=20)
STIFF = replace(FREE, contour=ContourSettings(rigid=True))
HAND, FOOT = EXTREMITY_CAPSULES[0], EXTREMITY_CAPSULES[2]


@pytest.fixture(scope="module")
def bent_ends():
    """A body whose left hand is bent at the wrist and left foot at the ankle, the rays of it, and its pose."""
    rng, body = np.random.default_rng(3), Body.from_stature(1.75)
    pose, surface = made.moving_pose(rng), BodySurface.of(body)
    start, end = surface.start.copy(), surface.end.copy()
    end[HAND] = start[HAND] + rotation_matrix(np.array([0.5, 0.0, 0.3])) @ (end[HAND] - start[HAND])
    ankle, R = np.array([0.0, 0.0, -body.lengths[8]]), rotation_matrix(np.array([0.0, 0.5, 0.0]))
    start[FOOT], end[FOOT] = ankle + R @ (start[FOOT] - ankle), ankle + R @ (end[FOOT] - ankle)
    rays = made.rays_on(body, surface._replace(start=start, end=end), pose, rng, each=24)
    return body, pose, rays


def fitted(bent_ends, settings):
    body, pose, rays = bent_ends
    points = np.zeros((1, 3))  # far from everything
    return synthetic.fit(body, pose, points, settings=settings, contour_rays=rays).reference_points_world


def test_bent_hand_and_foot_leave_elbow_and_ankle_where_they_are(bent_ends):
    body, pose, _ = bent_ends
    truth = forward(body, pose)
    free, stiff = (np.linalg.norm(fitted(bent_ends, s) - truth, axis=1) for s in (FREE, STIFF))
    assert free[[7, 9, 13]].max() < 0.015  # left elbow, knee, ankle
    assert free[[7, 9, 13]].mean() < 0.85 * stiff[[7, 9, 13]].mean()


def test_hand_tip_follows_the_hand(bent_ends):
    body, pose, _ = bent_ends
    surface, truth = BodySurface.of(body), forward(body, pose)
    wrist, tip = surface.start[HAND], np.array([0.0, body.lengths[6], 0.0])
    shift = rotation_matrix(np.array([0.5, 0.0, 0.3])) @ (tip - wrist) - (tip - wrist)
    moved = np.linalg.norm(fitted(bent_ends, FREE)[11] - truth[11])
    assert moved == pytest.approx(np.linalg.norm(shift), rel=0.35)


def test_reference_points_of_an_ideal_figure_are_those_of_its_pose(bent_ends):
    body, pose, rays = bent_ends
    for settings, rigid in ((ArticulatedSettings.of_ideal_figure(), True), (ArticulatedSettings(), False)):
        fit = synthetic.fit(body, pose, np.zeros((1, 3)), settings=settings, contour_rays=rays)
        off = np.linalg.norm(fit.reference_points_world - forward(body, fit.pose), axis=1)
        assert (off.max() < 1e-9) == rigid
