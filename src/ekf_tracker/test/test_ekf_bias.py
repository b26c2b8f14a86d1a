"""Covariances that include errors which last: against simulated biases, and against the gain that must not change; the
trunk's bend, from the torso's measured points."""

from dataclasses import replace

import numpy as np
import pytest
from ekf_person import ALL, IDEAL, NONE, Person, ellipsoid_distances, isotropic, run, stamp
from scipy.stats import chi2

from capture_rig.rigid import rotation_matrix
from ekf_tracker.bias import JOINT_SD_M, TrunkBendFilter
from ekf_tracker.filter import ArticulatedEkf
from ekf_tracker.measurement import Measurement
from ekf_tracker.settings import MeasurementBiasSettings
from stick_figure.body import BEND_NUMBERS, Body
from stick_figure.kinematics import forward
from stick_figure.pose import Pose
from stick_figure.skeleton import POINT_NAMES, T_POSE_ANGLES
from stick_figure.trunk_bend import LEFT_Z, PELVIS_YAW, REST_SD, RIGHT_X

SETTLED = 30
HAND, HIP = POINT_NAMES.index("left_hand"), POINT_NAMES.index("left_hip")
WHOLE = MeasurementBiasSettings(share=1.0, joints=0.0)


def run_with_biased_pose(body, seed, lasting, tau_s=0.5, sd=0.03, frames=240):
    """Points of a pose that strays from the true one (Gauss-Markov over tau) plus 3 mm of noise; R is their sum.

    The stray pose is scaled so that the measured points err by about ``sd`` on each axis. Returns the states, the true
    points and the true poses.
    """
    rng, person = np.random.default_rng(seed), Person(body, seed, speed=0.7)
    ekf, decay = ArticulatedEkf(body, replace(IDEAL, measurement_bias=lasting)), np.exp(-1 / (60 * tau_s))
    slots = np.full(24, 0.06)
    slots[:3] = 0.02
    stray, states, truth, poses = slots * rng.standard_normal(24), [], [], []
    at = [forward(body, person.pose(0).retract(slots * rng.standard_normal(24))) for _ in range(200)]
    R = np.array([np.cov((np.array(at)[:, i] - person.points(0)[i]).T) for i in range(15)]) + 0.003**2 * np.eye(3)
    for k in range(frames):
        pose = person.pose(k / 60)
        points = forward(body, pose.retract(stray)) + 0.003 * rng.standard_normal((15, 3))
        states.append(ekf.step(stamp(k), points, R, ALL))
        truth.append(forward(body, pose))
        poses.append(pose)
        stray = decay * stray + np.sqrt(1 - decay**2) * slots * rng.standard_normal(24)
    return states[SETTLED:], np.array(truth[SETTLED:]), poses[SETTLED:]


def share_inside(states, truth):
    errors = np.array([s.points_world for s in states]) - truth
    covariances = np.array([s.point_covariance for s in states])
    return (ellipsoid_distances(errors, covariances) < chi2.ppf(0.95, 3)).mean()


def test_errors_of_points_and_joints_that_last_fit_their_covariance(body):
    """The share of points inside their 95 % ellipsoids; each tangent slot's squared error over its variance."""
    runs = [run_with_biased_pose(body, seed, WHOLE) for seed in range(4)]
    assert 0.88 < np.mean([share_inside(states, truth) for states, truth, _ in runs]) < 0.99
    ratios = []
    for states, _, poses in runs:
        errors = np.array([pose.minus(state.pose) for pose, state in zip(poses, states, strict=True)])
        ratios.append(errors**2 / np.array([np.diag(state.covariance)[:24] for state in states]))
    assert 0.3 < np.mean(ratios) < 1.2
    fleeting = [run_with_biased_pose(body, seed, IDEAL.measurement_bias)[:2] for seed in range(2)]
    assert np.mean([share_inside(*one) for one in fleeting]) < 0.75


def test_a_joint_lies_elsewhere_along_the_axes_of_its_own_stick(body, person):
    settings = replace(IDEAL, measurement_bias=MeasurementBiasSettings(share=0.0, joints=2.0))
    with_joints, _ = run(ArticulatedEkf(body, settings), person, 40)
    without, _ = run(ArticulatedEkf(body, IDEAL), person, 40)
    added = with_joints[-1].point_covariance - without[-1].point_covariance
    forward, left, up = with_joints[-1].pose.R_world_torso.T
    for axis, sd in zip((forward, left, up), JOINT_SD_M[HIP], strict=True):
        assert axis @ added[HIP] @ axis == pytest.approx((2.0 * sd) ** 2, rel=1e-6)


def test_gain_follows_what_is_new_in_a_set_and_not_what_lasts(body):
    """A hand that sets off is followed at once although the fit is uncertain by centimetres, most of which last."""
    person = Person(body, 2, speed=3.0)
    errors = {}
    for share in (0.0, 0.95):
        settings = replace(IDEAL, measurement_bias=MeasurementBiasSettings(share=share, joints=0.0))
        rng, ekf, found = np.random.default_rng(5), ArticulatedEkf(body, settings), []
        for k in range(90):
            measured = person.points(k / 60) + 0.002 * rng.standard_normal((15, 3))
            state = ekf.step(stamp(k), measured, isotropic(0.02), ALL)
            found.append(np.linalg.norm(state.points_world - person.points(k / 60), axis=1)[HAND])
        errors[share] = 1e3 * np.mean(found[SETTLED:])
    assert errors[0.95] < 4.0
    assert errors[0.95] < 0.5 * errors[0.0]


def test_points_that_went_unseen_keep_what_lasted_and_grow_beyond_it(body, person):
    states, _ = run(ArticulatedEkf(body), person, 60, visible=lambda k: ALL if k < 40 else NONE)
    variances = np.array([np.trace(s.point_covariance[HAND]) for s in states])
    assert (np.diff(variances[39:]) > 0.0).all()


def test_slots_that_no_point_bears_on_are_not_widened(body, person):
    """The arm was never seen: its joints' prior is all there is to say."""
    visible = ALL.copy()
    visible[[HAND, POINT_NAMES.index("left_elbow")]] = False
    states, _ = run(ArticulatedEkf(body), person, 20, visible=lambda k: visible)
    fleeting, _ = run(ArticulatedEkf(body, IDEAL), person, 20, visible=lambda k: visible)
    shoulder = [8, 12, 10, 14]
    np.testing.assert_allclose(
        np.diag(states[-1].covariance)[shoulder], np.diag(fleeting[-1].covariance)[shoulder], rtol=1e-6
    )


# --- the trunk's bend -------------------------------------------------------------------------------------------------

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
    bent = TrunkBendFilter(1.0).bent(BODY, 0, measured(BEND))
    off = bent.torso_points[1:] - BODY.bent(BEND).torso_points[1:]
    off -= off.mean(axis=0)  # which way the torso itself faces is a matter of definition
    assert bent.bend[LEFT_Z] == pytest.approx(0.04, abs=0.005)
    assert np.abs(off[:, 2]).max() < 0.004
    assert bent.straight is BODY


def test_noise_is_averaged_over_sets_and_counted():
    rng, trunk, found = np.random.default_rng(2), TrunkBendFilter(1.0), []
    for k in range(200):
        found.append(trunk.bent(BODY, k * FRAME_NS, measured(np.zeros(BEND_NUMBERS), 0.01, rng)).bend[LEFT_Z])
    once = TrunkBendFilter(1.0).bent(BODY, 0, measured(np.zeros(BEND_NUMBERS), 0.01, rng))
    assert np.std(found) < 0.5 * REST_SD[LEFT_Z]
    assert np.std(found) == pytest.approx(np.sqrt(trunk.covariance[LEFT_Z, LEFT_Z]), rel=0.5)
    assert np.abs(once.bend).max() > 0.0


def test_bend_fades_to_rest_while_the_torso_is_hidden():
    trunk, hidden = TrunkBendFilter(1.0), np.ones(15, bool)
    hidden[[2, 3]] = False
    trunk.bent(BODY, 0, measured(BEND))
    gone = trunk.bent(BODY, 2_000_000_000, measured(BEND, visible=hidden))
    assert np.abs(gone.bend).max() < 1e-3
    assert np.allclose(np.sqrt(np.diag(trunk.covariance)), REST_SD, rtol=0.01)
