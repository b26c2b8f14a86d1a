"""The trunk's bend, from the torso's measured points."""

import numpy as np
import pytest

from capture_rig.rigid import rotation_matrix
from ekf_tracker.bias import TorsoBend
from ekf_tracker.measurement import Measurement
from stick_figure.body import BEND_NUMBERS, Body
from stick_figure.kinematics import forward
from stick_figure.pose import Pose
from stick_figure.skeleton import T_POSE_ANGLES
from stick_figure.trunk_bend import LEFT_Z, PELVIS_YAW, REST_SD, RIGHT_X

BODY = Body.from_stature(1.75)
POSE = Pose.from_angles([1.0, 2.0, 1.0], rotation_matrix(np.array([0.3, -0.2, 1.0])), T_POSE_ANGLES)
BEND = np.zeros(BEND_NUMBERS)
BEND[[LEFT_Z, PELVIS_YAW, RIGHT_X]] = 0.04, 0.12, 0.02
FRAME_NS = 16_666_667


def measured(bend, sd_m=0.003, rng=None, visible=None):
    points = forward(BODY.bent(bend), POSE)
    if rng is not None:
        points = points + rng.normal(0.0, sd_m, points.shape)
    visible = np.ones(15, bool) if visible is None else visible
    return Measurement.checked(points, np.tile(sd_m**2 * np.eye(3), (15, 1, 1)), visible, 1e-3)


def test_shoulders_and_hips_lie_where_they_were_measured():
    bent = TorsoBend(1.0).bent(BODY, 0, measured(BEND))
    off = bent.torso_points[1:] - BODY.bent(BEND).torso_points[1:]
    off -= off.mean(axis=0)  # which way the torso itself faces is a matter of definition
    assert bent.bend[LEFT_Z] == pytest.approx(0.04, abs=0.005)
    assert np.abs(off[:, 2]).max() < 0.004
    assert bent.straight is BODY


def test_noise_is_averaged_over_sets_and_counted():
    rng, trunk, found = np.random.default_rng(2), TorsoBend(1.0), []
    for k in range(200):
        found.append(trunk.bent(BODY, k * FRAME_NS, measured(np.zeros(BEND_NUMBERS), 0.01, rng)).bend[LEFT_Z])
    once = TorsoBend(1.0).bent(BODY, 0, measured(np.zeros(BEND_NUMBERS), 0.01, rng))
    assert np.std(found) < 0.5 * REST_SD[LEFT_Z]
    assert np.std(found) == pytest.approx(np.sqrt(trunk.covariance[LEFT_Z, LEFT_Z]), rel=0.5)
    assert np.abs(once.bend).max() > 0.0


def test_bend_fades_to_rest_while_the_torso_is_hidden():
    trunk, hidden = TorsoBend(1.0), np.ones(15, bool)
    hidden[[2, 3]] = False
    trunk.bent(BODY, 0, measured(BEND))
    gone = trunk.bent(BODY, 2_000_000_000, measured(BEND, visible=hidden))
    assert np.abs(gone.bend).max() < 1e-3
    assert np.allclose(np.sqrt(np.diag(trunk.covariance)), REST_SD, rtol=0.01)


def test_rigid_torso_is_left_as_it_is():
    assert TorsoBend(0.0).bent(BODY, 0, measured(BEND)) is BODY
