"""Frame sets that are missing, limbs that jump, rates, and joint limits: what a consumer of the joint states sees."""

from dataclasses import replace

import numpy as np
import pytest
from ekf_person import ALL, BENT_ANGLES, IDEAL, NONE, Person, ellipsoid_distances, errors_mm, isotropic, run, stamp
from poses import pose_with
from scipy.spatial.transform import Rotation
from scipy.stats import chi2

from ekf_tracker.filter import ArticulatedEkf
from mocap_packets.state import BodyState, Tracking
from stick_figure.joint_limits import add_joint_limits
from stick_figure.kinematics import forward
from stick_figure.skeleton import POINT_NAMES

GAP_AT = 60
ARMS = [[POINT_NAMES.index(f"{side}_{part}") for part in ("elbow", "hand")] for side in ("left", "right")]


def through_gap(body, seed, missing, sets_arrive, settings=None):
    """States and truth of a person who is not seen for so many sets; whether empty sets arrive meanwhile, or none."""
    ekf, person = ArticulatedEkf(body, settings), Person(body, seed)
    if sets_arrive:
        hidden = range(GAP_AT, GAP_AT + missing)
        return run(ekf, person, GAP_AT + missing + 30, visible=lambda k: NONE if k in hidden else ALL)
    before, truth = run(ekf, person, GAP_AT)
    after, truth_after = run(ekf, person, 30, start=GAP_AT + missing, rng=np.random.default_rng(8))
    return [*before, *after], np.concatenate([truth, truth_after])


@pytest.mark.parametrize("sets_arrive", [True, False])
@pytest.mark.parametrize("missing", [1, 60, 300])
def test_body_is_tracked_again_with_the_first_set_after_a_gap(body, missing, sets_arrive):
    first, later = [], []
    for seed in range(3):
        states, truth = through_gap(body, seed, missing, sets_arrive, IDEAL)
        assert states[-30].tracking == Tracking.TRACKING
        errors = errors_mm(states, truth)
        first.append(errors[-30].mean())
        later.append(errors[-20:].mean())
    assert np.mean(first) < 35.0  # measured points err by 32 mm
    assert np.mean(later) < 17.0


@pytest.mark.parametrize(("missing", "limit_mm"), [(1, 25.0), (10, 200.0), (59, 500.0)])
def test_estimate_coasts_within_bounds_and_claims_no_more_than_it_knows(body, missing, limit_mm):
    settings, inside, errors, spreads = IDEAL, [], [], []
    for seed in range(4):
        states, truth = through_gap(body, seed, missing, True, settings)
        last, error = states[GAP_AT + missing - 1], states[GAP_AT + missing - 1].points_world
        error = error - truth[GAP_AT + missing - 1]
        inside.append(ellipsoid_distances(error, last.point_covariance) < chi2.ppf(0.95, 3))
        errors.append(1e3 * np.linalg.norm(error, axis=1).mean())
        spreads.append([np.trace(s.point_covariance.sum(0)) for s in states[GAP_AT - 1 : GAP_AT + missing]])
    assert np.mean(errors) < limit_mm
    assert np.mean(inside) > 0.85
    assert (np.diff(spreads, axis=1) > 0.0).all()


def test_arms_that_change_places_for_a_set_are_right_again_with_the_next(body, person):
    arms = [*ARMS[0], *ARMS[1]]

    def spoil(k, points):
        if k == 60:
            points[arms] = points[[*ARMS[1], *ARMS[0]]]

    errors = errors_mm(*run(ArticulatedEkf(body, IDEAL), person, 90, spoil=spoil))[:, arms]
    assert errors[60].max() > 200.0 and errors[61:].mean() < 2.0 * errors[30:60].mean()


@pytest.mark.parametrize("fps", [30.0, 100.0])
def test_published_rates_have_the_truths_sign_size_and_hardly_any_lag(body, person, fps):
    """Rates against central differences of the true angles, points with 5 mm of noise; lag by cross-correlation."""
    frames, settled = round(8 * fps), round(0.5 * fps)
    states, _ = run(ArticulatedEkf(body, IDEAL), person, frames, noise=0.005, fps=fps)
    assert all(isinstance(s, BodyState) for s in states)
    published = np.array([s.rates for s in states])[settled:]
    times, step = np.arange(settled, frames) / fps, 1e-3
    true = np.array([(person.pose(t + step).angles() - person.pose(t - step).angles()) / (2 * step) for t in times])
    shifts, inner, lags_s = np.arange(-6, 7), slice(10, -10), []
    for slot in range(18):
        match = [(published[inner, slot] * np.roll(true[:, slot], shift)[inner]).sum() for shift in shifts]
        best = int(np.argmax(match))
        left, centre, right = match[best - 1], match[best], match[best + 1]
        lags_s.append((shifts[best] + 0.5 * (left - right) / (left - 2 * centre + right)) / fps)
    slopes = (published * true).sum(0) / (true**2).sum(0)
    assert np.abs(lags_s).max() < 0.05 and np.median(np.abs(lags_s)) < 0.025
    assert slopes.min() > 0.85 and slopes.max() < 1.1


@pytest.mark.parametrize(
    ("off_m", "told", "released"),
    [(0.25, True, True), (0.03, False, False), (0.25, False, True)],
    ids=["told", "not told", "out of reach"],
)
def test_an_arm_that_was_found_elsewhere_is_there_at_once_and_has_no_speed(body, off_m, told, released):
    """The arm was lost: its points hung off for a second. What lies between the two places is no motion."""
    ekf, arm, off = ArticulatedEkf(body, IDEAL), ARMS[0], np.array([0.0, 0.0, off_m])
    person = Person(body, speed=0.0)
    for k in range(61):
        measured, moved = person.points(0.0), NONE.copy()
        if k < 60:
            measured[arm] += off
        elif told:
            moved[arm] = True
        state = ekf.step(stamp(k), measured, isotropic(0.01), ALL, NONE, moved)
    off_mm = 1e3 * np.linalg.norm(state.points_world[arm] - person.points(0.0)[arm], axis=1).max()
    assert off_mm < 20.0 or not released
    ahead = ekf.step(stamp(63), person.points(0.0), isotropic(0.01), NONE)
    drift_mm = 1e3 * np.linalg.norm(ahead.points_world[arm] - state.points_world[arm], axis=1).max()
    assert (drift_mm < 50.0) == released  # taken for motion, it goes on


def test_a_torso_that_was_found_elsewhere_starts_the_track_anew(body, person):
    ekf, off = ArticulatedEkf(body, IDEAL), np.array([0.4, 0.0, 0.0])
    for k in range(30):
        ekf.step(stamp(k), person.points(0.0) + off, isotropic(0.01), ALL)
    state = ekf.step(stamp(30), person.points(0.0), isotropic(0.01), ALL, NONE, ALL)
    assert np.linalg.norm(state.points_world - person.points(0.0), axis=1).max() < 0.02
    assert np.abs(state.velocity[:3]).max() < 0.1


# --- joint limits -----------------------------------------------------------------------------------------------------

MARGIN = 0.15
NO_LIMITS = replace(IDEAL, limit_sd_rad=0.0)
TIGHT = replace(IDEAL, limit_sd_rad=0.05)


def bent(**angles):
    """Elbows and knees bent, other angles by name."""
    return pose_with(BENT_ANGLES, **angles)


def excess_rad(pose):
    """Length of the residual at a pose: by how much it is out of range."""
    information, gradient = np.zeros((24, 24)), np.zeros(24)
    add_joint_limits(pose.R_joints, pose.hinges, MARGIN, 1.0, information, gradient)
    return float(np.sqrt(gradient @ np.linalg.pinv(information) @ gradient))


def follow(body, pose, settings, frames=40, sd=0.02):
    """The filter's last state after so many sets of a body that stands in this pose."""
    ekf, rng = ArticulatedEkf(body, settings), np.random.default_rng(1)
    for k in range(frames):
        points = forward(body, pose) + sd * rng.standard_normal((15, 3))
        state = ekf.step(stamp(k), points, isotropic(sd), ALL)
    return state


@pytest.mark.parametrize(
    "angles",
    [{"left_shoulder_y": 3 * np.pi / 4 + 0.6}, {"right_hip_z": np.pi / 3 + 0.6}, {"left_hip_x": np.pi / 2 + 0.5}],
)
def test_impossible_points_are_answered_with_a_pose_near_the_limit(body, angles):
    """Points of a limb 0.5 to 0.6 rad out of range: without limits the filter believes them."""
    pose = bent(**angles)
    assert excess_rad(follow(body, pose, NO_LIMITS).pose) > 0.4
    assert excess_rad(follow(body, pose, TIGHT).pose) < 0.25


def test_knee_that_seems_to_bend_forward_stays_near_straight_and_the_thigh_unturned(body):
    """Noise bends a straight knee 0.3 rad the wrong way: its other description, a thigh turned by pi, is impossible."""
    pose = replace(bent(), hinges=np.array([-0.9, -0.9, -0.3, 0.8]))
    limited, free = follow(body, pose, TIGHT), follow(body, pose, NO_LIMITS)
    assert excess_rad(limited.pose) < 0.1
    assert limited.pose.hinges[2] > -MARGIN - 0.1
    assert free.pose.hinges[2] > 0.2 and excess_rad(free.pose) > 1.0


def test_elbow_on_the_wrong_side_is_turned_round_where_the_shoulder_allows_it(body):
    """Upper arm started turned by pi: limits must not keep the arm there."""
    truth = bent(left_shoulder_y=2.2)
    turned = truth.R_joints.copy()
    turned[1] = turned[1] @ Rotation.from_rotvec([0.0, np.pi, 0.0]).as_matrix()
    wrong = replace(truth, R_joints=turned, hinges=truth.hinges * [0.0, 1.0, 1.0, 1.0])
    ekf = ArticulatedEkf(body, IDEAL)
    for k in range(60):
        bend = min(k / 30.0, 1.0)
        pose = replace(truth, hinges=truth.hinges * [bend, 1.0, 1.0, 1.0])
        points = forward(body, wrong if k == 0 else pose)
        state = ekf.step(stamp(k), points, isotropic(0.01), ALL)
    assert 1e3 * np.linalg.norm(state.points_world - forward(body, truth), axis=1).max() < 20.0
    assert state.pose.hinges[0] == pytest.approx(-0.9, abs=0.1)
