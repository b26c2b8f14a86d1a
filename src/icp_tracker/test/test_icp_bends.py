"""A trunk that bends: shoulders that rise, hips that turn, followed from set to set."""

from dataclasses import replace

import numpy as np
import pytest
import refinement_rays as made

from icp_tracker.articulated_fit import ArticulatedSettings, VolumeSettings, make_data, minimise
from icp_tracker.monitor.evidence import match_to
from icp_tracker.refinement.trunk_bend import TrunkBend
from mocap_packets.hull import NO_VOXELS
from stick_figure.body import BEND_NUMBERS, Body
from stick_figure.kinematics import forward
from stick_figure.least_squares.placed_figure import Figure, State
from stick_figure.trunk_bend import LEFT_Z, PELVIS_YAW, RIGHT_X

BENDS = ArticulatedSettings(volume=VolumeSettings(weight=0.0))
RIGID = replace(BENDS, contour=replace(BENDS.contour, bend=0.0))
FRAME_NS = 16_666_667
BEND = np.zeros(BEND_NUMBERS)
BEND[[LEFT_Z, PELVIS_YAW, RIGHT_X]] = 0.04, 0.12, 0.02


@pytest.fixture(scope="module")
def followed():
    """A body with a bent trunk in one pose, the bend that was found after a second, and the points' errors (m) with
    and without it."""
    rng, body = np.random.default_rng(5), Body.from_stature(1.75)
    pose, bent = made.moving_pose(rng), body.bent(BEND)
    rays = made.rays_on(bent, Figure.of(bent).surface, pose, rng, each=40)
    errors = []
    for settings in (BENDS, RIGID):
        trunk, found = TrunkBend(settings), pose
        data = make_data(np.zeros((1, 3)), 0.0, NO_VOXELS, settings, rays)
        for k in range(60):
            found, _, _ = minimise(trunk.of(body), found, data, settings)
            match = match_to(Figure.of(trunk.of(body)), State.of(found), data)
            trunk.look(k * FRAME_NS, body, found, data.contour_rays, match)
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


def test_body_bent_twice_is_bent_once_and_keeps_its_rest():
    body = Body.from_stature(1.75)
    twice = body.bent(BEND).bent(0.5 * BEND)
    assert twice.straight is body and np.array_equal(twice.bend, 0.5 * BEND)
    origins = body.bent(BEND).stick_origins_torso - body.stick_origins_torso
    assert origins[2, 2] == pytest.approx(0.04) and origins[4, 0] == pytest.approx(
        -0.12 * body.stick_origins_torso[4, 1]
    )
