"""The filter on simulated people: accuracy, honesty of its covariance, outliers, gaps, hinges, determinism."""

from dataclasses import replace

import ekf_person as made
import numpy as np
import pytest
from poses import pose_with

from capture_rig.errors import InputError
from ekf_tracker import motion_model, track
from ekf_tracker.filter import ArticulatedEkf, PeopleFilter
from ekf_tracker.motion_model import POSE, VELOCITY, DampedVelocity
from mocap_packets.fit import DOUBTFUL, GOOD, PART_NAMES, ReferencePoints
from mocap_packets.people import FittedPeople, PeoplePoints
from mocap_packets.state import NoState, Tracking
from stick_figure.body import Body
from stick_figure.kinematics import forward
from stick_figure.pose import Pose
from stick_figure.skeleton import POINT_NAMES, TORSO_POINTS

IDENTITY = replace(made.IDEAL, motion_model="identity")
SETTLED = 30
HAND, ELBOW = POINT_NAMES.index("left_hand"), POINT_NAMES.index("left_elbow")
LEFT_ARM = [HAND, ELBOW]
ARM_DOUBTFUL = tuple(DOUBTFUL if name == "left arm" else GOOD for name in PART_NAMES)
BENT_POSE = Pose.from_angles(np.array([0.0, 0.0, 1.1]), np.eye(3), made.BENT_ANGLES)


@pytest.mark.parametrize(("speed", "margin", "most_mm"), [(1.0, 0.95, 16.0), (2.0, 0.9, 20.0)])
def test_points_are_filtered_to_half_their_error_and_constant_velocity_beats_identity(body, speed, margin, most_mm):
    """Measured points err by 32 mm in the mean: the length of a 3D Gaussian of 20 mm an axis."""
    person = made.Person(body, speed=speed)
    damped, truth = made.run(ArticulatedEkf(body, made.IDEAL), person, 300)
    identity, _ = made.run(ArticulatedEkf(body, IDENTITY), person, 300)
    damped_mm, identity_mm = (made.errors_mm(s, truth)[SETTLED:].mean() for s in (damped, identity))
    assert damped_mm < margin * identity_mm < 30.0 and damped_mm < most_mm


def test_errors_of_a_person_that_moves_as_the_model_says_fit_the_covariance(body, monkeypatch):
    """NEES over all 48 slots and NIS of the points, on motion drawn from the motion model itself."""
    gentle, settings = DampedVelocity((8.0, 15.0, 15.0, 8.0)), replace(made.IDEAL, limit_sd_rad=0.0)
    monkeypatch.setattr(track, "motion_model", lambda settings: gentle)
    monkeypatch.setattr(motion_model, "EXPECTED", np.inf)
    F, Q = made.dense_matrices(gentle.transition(1 / 60))
    Q_half = np.linalg.cholesky(Q)
    nees, nis = [], []
    for seed in range(6):
        rng = np.random.default_rng(seed)
        pose, velocity, ekf = BENT_POSE, np.zeros(24), ArticulatedEkf(body, settings)
        for k in range(90):
            noise = Q_half @ rng.standard_normal(48)
            pose = pose.retract(F[POSE, VELOCITY] @ velocity + noise[POSE])
            velocity = F[VELOCITY, VELOCITY] @ velocity + noise[VELOCITY]
            points = forward(body, pose) + 0.02 * rng.standard_normal((15, 3))
            state = ekf.step(made.stamp(k), points, made.isotropic(0.02), made.ALL)
            if k >= SETTLED:
                e = np.concatenate([pose.minus(state.pose), velocity - state.velocity])
                nees.append(e @ np.linalg.solve(state.covariance, e))
                nis.append(state.normalised_innovation)
    # the mean of 360 chi-squares of 48 degrees spreads by 0.011, but successive errors are alike: allow ten times that
    assert np.mean(nees) / 48 == pytest.approx(1.0, abs=0.1)
    # 360 sets of 45 degrees: the innovations are white, so four standard deviations of the mean
    assert np.mean(nis) == pytest.approx(1.0, abs=4 * np.sqrt(2 / (360 * 45)))


def test_drift_leads_to_the_next_prediction(body, person):
    """What the consumer of a prediction computes equals what the filter will predict."""
    ekf = ArticulatedEkf(body, made.IDEAL)
    states, _ = made.run(ekf, person, 40)
    expected = forward(body, states[-1].pose.retract(states[-1].predicted_velocity / 60.0))
    blind = ekf.step(made.stamp(40), np.zeros((15, 3)), made.isotropic(0.02), made.NONE)
    assert np.linalg.norm(blind.points_world - expected, axis=1).max() < 1e-6
    assert np.linalg.norm(expected - states[-1].points_world, axis=1).max() > 1e-3


def test_identity_model_does_not_drift_but_reports_how_fast_the_body_moved(body, person):
    states, truth = made.run(ArticulatedEkf(body, IDENTITY), person, 120, noise=0.002)
    np.testing.assert_array_equal(states[-1].predicted_velocity, 0.0)
    measured = np.array([s.velocity[:3] for s in states[SETTLED:]])
    true = np.gradient(truth[:, 0], 1 / 60.0, axis=0)[SETTLED:]
    assert np.abs(measured - true).mean() < 0.15 * np.abs(true).max()


# --- points that are missing or wrong -----------------------------------------------------------------------------


def test_doubt_of_a_measured_limb_is_the_filters_too(body, person):
    doubtful = np.arange(15) == HAND
    ekf = ArticulatedEkf(body, made.IDEAL)
    for k, measured in enumerate((doubtful, made.NONE, doubtful)):  # at the first set as at the next
        state = ekf.step(made.stamp(k), person.points(0.0), made.isotropic(0.02), made.ALL, measured)
        assert state.parts == (ARM_DOUBTFUL if measured.any() else (GOOD,) * 5)
    assert np.flatnonzero(state.reference_points.doubtful).tolist() == sorted(LEFT_ARM)


def test_gap_is_the_same_whether_sets_are_missing_or_empty(body, person):
    empty, _ = made.run(
        ArticulatedEkf(body, made.IDEAL), person, 60, visible=lambda k: made.ALL if k < 40 else made.NONE
    )
    ekf = ArticulatedEkf(body, made.IDEAL)
    made.run(ekf, person, 40)
    jumped = ekf.step(made.stamp(59), np.zeros((15, 3)), made.isotropic(0.02), made.NONE)
    np.testing.assert_allclose(jumped.points_world, empty[-1].points_world, atol=1e-6)
    torso = slice(0, 6)  # joints differ by the order in which their cap was applied
    np.testing.assert_allclose(jumped.covariance[torso, torso], empty[-1].covariance[torso, torso], rtol=1e-6)


def test_body_out_of_sight_stops_being_extrapolated(body, person):
    states, _ = made.run(
        ArticulatedEkf(body, made.IDEAL), person, 80, visible=lambda k: made.ALL if k < 40 else made.NONE
    )
    points = np.array([s.points_world for s in states])
    moved_mm = 1e3 * np.linalg.norm(np.diff(points, axis=0), axis=2).mean(axis=1)
    assert moved_mm[39:45].min() > 1.0 and moved_mm[46:].max() < 1e-6


def test_state_goes_from_tracking_through_doubtful_and_lost_back_to_tracking(body, person):
    def visible(k):
        return made.NONE if 30 <= k < 110 else made.ALL

    states, truth = made.run(ArticulatedEkf(body, made.IDEAL), person, 130, visible=visible)
    assert states[29].tracking == Tracking.TRACKING
    assert states[30].tracking == Tracking.DOUBTFUL and "no visible point" in states[30].reason
    assert states[88].tracking == Tracking.DOUBTFUL
    assert states[90].tracking == Tracking.LOST and "no usable point for 1.02 s" in states[90].reason
    assert states[110].tracking == Tracking.TRACKING
    assert made.errors_mm(states, truth)[110].mean() < 35.0


def test_arm_that_is_never_seen_keeps_the_t_pose_and_says_how_little_is_known(body, person):
    visible = ~np.isin(np.arange(15), LEFT_ARM)
    states, truth = made.run(ArticulatedEkf(body, made.IDEAL), person, 60, visible=lambda k: visible)
    seen = made.errors_mm(states, truth)[SETTLED:][:, visible]
    assert seen.mean() < 20.0
    assert np.sqrt(np.trace(states[-1].point_covariance[HAND])) > 0.3


def test_filter_starts_from_part_of_the_torso_and_not_from_less(body, person):
    visible = made.NONE.copy()
    visible[TORSO_POINTS[:3]] = True
    ekf = ArticulatedEkf(body, made.IDEAL)
    waiting = ekf.step(made.stamp(0), person.points(0.0), made.isotropic(0.02), visible)
    assert isinstance(waiting, NoState) and waiting.reason == "waiting for the torso: 3 of 15 points visible"
    assert waiting.tracking == Tracking.ACQUIRING
    visible[TORSO_POINTS[3]] = True
    started = ekf.step(made.stamp(1), person.points(1 / 60), made.isotropic(0.001), visible)
    error = np.linalg.norm(started.points_world - person.points(1 / 60), axis=1)
    assert error[TORSO_POINTS].max() < 5e-3


# --- hinges, singular poses, long runs ------------------------------------------------------------------------------


@pytest.mark.slow
def test_covariance_stays_positive_definite_over_2000_sets_with_twists_nobody_sees(body):
    """Random motion, arms and legs straight half of the time, points coming and going."""
    rng = np.random.default_rng(9)
    ekf = ArticulatedEkf(body, made.IDEAL)
    person = made.Person(body, 4, speed=1.5)
    for k in range(2000):
        pose = person.pose(k / 60)
        straight = np.sin(0.8 * k / 60 + np.arange(4)) > 0.0
        pose = replace(pose, hinges=np.where(straight, 0.0, pose.hinges))
        points = forward(body, pose) + 0.02 * rng.standard_normal((15, 3))
        state = ekf.step(made.stamp(k), points, made.isotropic(0.02), rng.random(15) < 0.7)
        if isinstance(state, NoState):
            continue
        P = state.covariance
        np.testing.assert_array_equal(P, P.T)
        assert np.linalg.eigvalsh(P)[0] > 0.0
        if k % 10 == 0:
            assert np.diag(P)[6:24].max() < 1.0 + 1e-9
    assert state.tracking == Tracking.TRACKING


def test_arms_pointing_forward_in_gimbal_lock_are_tracked_like_any_other(body):
    """b = -pi/2 of both shoulders: Euler angles are singular there, the filter is not."""
    rng, ekf, errors = np.random.default_rng(3), ArticulatedEkf(body, made.IDEAL), []
    for k in range(120):
        raised = -np.pi / 2 + 0.3 * np.sin(0.1 * k)
        arms = {"left_shoulder_z": raised, "right_shoulder_z": raised, "left_elbow": -0.5, "right_elbow": -0.5}
        points = forward(body, pose_with(**arms))
        state = ekf.step(made.stamp(k), points + 0.01 * rng.standard_normal((15, 3)), made.isotropic(0.01), made.ALL)
        errors.append(1e3 * np.linalg.norm(state.points_world - points, axis=1).mean())
        assert np.isfinite(state.rates).all() and np.abs(state.rates).max() < 60.0
    assert np.mean(errors[SETTLED:]) < 10.0


# --- stamps and other input -----------------------------------------------------------------------------------------


def test_filter_goes_on_with_better_known_sizes_of_the_same_body(body, person):
    ekf = ArticulatedEkf(body, made.IDEAL)
    before, truth = made.run(ekf, person, 60)
    resized = Body(body.half_lengths * 1.01, body.half_shoulder_width * 0.98)
    ekf.set_body(resized)
    after, truth = made.run(ekf, person, 30, start=60)
    assert ekf.body is resized
    # no start from nothing: velocity is known at once, and the error stays that of a settled filter
    assert np.abs(after[0].velocity - before[-1].velocity).max() < 3.5
    assert np.trace(after[0].covariance) < 4.0 * np.trace(before[-1].covariance)
    assert made.errors_mm(after, truth).mean() < 25.0


def test_person_who_is_not_measured_begins_anew_and_points_that_cannot_be_used_move_nobodys_filter(body, person):
    people, bodies, points = PeopleFilter(), {1: body, 2: body}, person.points(0.0)
    first, elsewhere, spoilt = (
        ReferencePoints(points + np.array([x, 0.0, 0.0]), sign * made.isotropic(0.01), made.ALL)
        for x, sign in ((0.0, 1.0), (3.0, 1.0), (0.0, -1.0))
    )
    with pytest.raises(InputError):
        people.step(FittedPeople(made.stamp(1), PeoplePoints({1: first, 2: spoilt}), bodies))
    for k, measured in enumerate(({1: first, 2: first}, {1: first}, {1: first, 2: elsewhere}), start=1):
        states = people.step(FittedPeople(made.stamp(k), PeoplePoints(measured), bodies))
        assert list(states) == list(measured)
    np.testing.assert_allclose(states[2].points_world, elsewhere.points_world, atol=0.01)
    assert np.abs(states[2].velocity[:3]).max() < 0.1  # m/s
