"""Angles, covariance coverage, jitter and time to track against values known by construction."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from capture_rig.session import Truth
from mocap_packets.fit import GOOD
from sagoma_tools.evaluation.scores import STRAIGHT_RAD, angle_truth, covariance_coverage, defined, score_angles
from sagoma_tools.evaluation.track import Track
from sagoma_tools.evaluation.track_evaluation import jitter, time_to_track_s
from stick_figure.body import Body
from stick_figure.kinematics import forward
from stick_figure.pose import T_POSE_ANGLES, Pose
from stick_figure.skeleton import ANGLE_NAMES

FPS = 60.0
NOBODY = Track.of_states([])
SLOT = {name: slot for slot, name in enumerate(ANGLE_NAMES)}


def walker(frames: int = 40, **angles_rad: float) -> tuple[np.ndarray, np.ndarray]:
    """Points (F, 15, 3) and angles (F, 18) of a figure that turns and moves on, with constant joint angles."""
    angles = T_POSE_ANGLES.copy()
    for name, value in angles_rad.items():
        angles[SLOT[name]] = value
    turns = [Rotation.from_euler("z", 0.05 * k).as_matrix() for k in range(frames)]
    body = Body.from_stature(1.8)
    points = [forward(body, Pose.from_angles([0.01 * k, 0, 1.0], R, angles)) for k, R in enumerate(turns)]
    return np.stack(points), np.tile(angles, (frames, 1))


def truth_of(points_world: np.ndarray, angles: np.ndarray | None = None) -> Truth:
    return Truth(np.arange(len(points_world)), points_world, angles, 1.0, Path("truth.csv"))


def track_of(points_world: np.ndarray, states: list[str] | None = None, first: int = 0) -> Track:
    count = len(points_world)
    covariance = np.broadcast_to(np.eye(3) * 1e-4, (count, 15, 3, 3)).copy()
    states = states or ["tracking"] * count
    parts = np.full((count, 5), GOOD)
    return Track(first + np.arange(count), points_world, covariance, np.zeros((count, 18)), np.array(states), parts)


BENT = {
    "left_elbow": -1.2,
    "right_elbow": -0.9,
    "left_knee": 0.8,
    "right_knee": 1.1,
    "left_shoulder_y": 0.3,
    "right_shoulder_y": -0.4,
    "left_hip_z": 0.2,
    "right_hip_z": -0.25,
    "neck_x": 0.2,
    "left_hip_y": -0.5,
}


def test_angle_truth_comes_from_the_points_where_the_reference_has_no_angles():
    points, angles = walker(**BENT)
    found = angle_truth(truth_of(points))
    assert "inverse kinematics" in found.source
    np.testing.assert_allclose(found.angles, angles, atol=1e-6)


def test_angle_truth_of_a_frame_with_an_unknown_point_is_unknown():
    points, _ = walker(**BENT)
    points[5, 9] = np.nan
    found = angle_truth(truth_of(points))
    assert np.isnan(found.angles[5]).all()
    assert np.isfinite(found.angles[[4, 6]]).all()


def test_twists_count_only_where_elbow_and_knee_are_bent():
    _, straight = walker(1)
    _, bent = walker(1, **BENT)
    twists = [SLOT[name] for name in ("left_shoulder_y", "right_shoulder_y", "left_hip_z", "right_hip_z")]
    assert not defined(straight)[0, twists].any()
    assert defined(straight)[0].sum() == 18 - len(twists)
    assert defined(bent)[0].all()


@pytest.mark.parametrize(("bend_deg", "expected"), [(19.0, False), (21.0, True)])
def test_twists_count_from_twenty_degrees_on(bend_deg, expected):
    assert np.rad2deg(STRAIGHT_RAD) == pytest.approx(20.0)
    _, angles = walker(1, left_elbow=-np.deg2rad(bend_deg))
    assert defined(angles)[0, SLOT["left_shoulder_y"]] == expected


def test_first_and_third_angle_count_not_where_an_arm_points_straight_forward():
    _, forwards = walker(1, left_shoulder_z=-np.pi / 2, left_elbow=-1.0)
    meaningless = [SLOT["left_shoulder_x"], SLOT["left_shoulder_y"]]
    assert not defined(forwards)[0, meaningless].any()
    assert defined(forwards)[0, SLOT["left_shoulder_z"]]


def test_angle_rmse_leaves_undefined_twists_out_and_says_how_many():
    points, angles = walker(**BENT)
    true = angles.copy()
    true[:30, SLOT["left_elbow"]] = 0.0  # straight for 30 of 40 frames
    wrong = true.copy()
    wrong[:30, SLOT["left_shoulder_y"]] += 2.0
    wrong[30:, SLOT["left_shoulder_y"]] += 0.1
    scores = score_angles(wrong, points, angle_truth(truth_of(points, true)))
    assert scores.rmse_rad[SLOT["left_shoulder_y"]] == pytest.approx(0.1)
    assert scores.share_defined[SLOT["left_shoulder_y"]] == pytest.approx(0.25)
    assert scores.rmse_rad[SLOT["right_shoulder_y"]] == pytest.approx(0.0)


def test_torso_error_is_the_angle_by_which_the_whole_body_is_turned():
    points, angles = walker(**BENT)
    R = Rotation.from_rotvec(0.2 * np.array([2.0, 1.0, 2.0]) / 3.0).as_matrix()
    turned = (points - points[:, :1]) @ R.T + points[:, :1]
    scores = score_angles(angles, turned, angle_truth(truth_of(points)))
    assert scores.torso_rmse_rad == pytest.approx(0.2, abs=1e-6)


def test_nees_of_honest_noise_is_three_and_lies_in_its_interval():
    rng = np.random.default_rng(11)
    A = rng.normal(size=(15, 3, 3))
    P = 1e-4 * (A @ A.transpose(0, 2, 1) + np.eye(3))
    errors = np.einsum("pij,fpj->fpi", np.linalg.cholesky(P), rng.normal(size=(4000, 15, 3)))
    found = covariance_coverage(errors, np.broadcast_to(P, (4000, 15, 3, 3)))
    assert found.nees == pytest.approx(3.0, abs=0.05)
    np.testing.assert_allclose(found.point_inside_95, 0.95, atol=0.015)
    # 4000 independent frames: the mean of chi-square(3) has sd sqrt(6 / 4000)
    np.testing.assert_allclose(found.nees_95, 3.0 + 1.96 * np.sqrt(6 / 4000) * np.array([-1.0, 1.0]), atol=2e-3)


def test_nees_grows_by_four_where_a_point_claims_half_the_sd_it_has():
    rng = np.random.default_rng(12)
    errors = rng.normal(0.0, 0.02, (4000, 15, 3))
    P = np.broadcast_to(np.eye(3) * 0.02**2, (4000, 15, 3, 3)).copy()
    P[:, 12] *= 0.25
    found = covariance_coverage(errors, P)
    assert found.point_nees[12] == pytest.approx(12.0, rel=0.05)
    assert found.point_inside_95[12] == pytest.approx(0.418, abs=0.03)  # chi-square(3) at 7.81 / 4
    assert found.point_inside_95[11] == pytest.approx(0.95, abs=0.015)


def test_unknown_errors_do_not_count_and_certainty_counts_as_outside():
    errors, P = np.full((4, 15, 3), 0.01), np.broadcast_to(np.eye(3) * 1e-4, (4, 15, 3, 3)).copy()
    errors[:3, 0] = np.nan
    P[:, 1] = 0.0
    found = covariance_coverage(errors, P)
    assert found.point_nees[0] == pytest.approx(3.0)
    assert found.point_inside_95[1] == 0.0
    assert found.point_nees[1] == np.inf


def test_jitter_of_white_noise_at_rest_is_its_size():
    still, _ = walker(1)
    noise = np.random.default_rng(13).normal(0.0, 0.002, (900, 15, 3))
    found = jitter(track_of(still + noise), FPS, truth_of(np.repeat(still, 900, axis=0)))
    half = 15  # frames in a quarter of a second
    assert found.rms_mm == pytest.approx(2.0 * np.sqrt(3.0) * np.sqrt(1 - 1 / (2 * half + 1)), rel=0.01)
    assert (found.at_rest == 900 - 2 * half).all()


def test_jitter_is_blind_to_what_moves_and_to_a_constant_offset():
    points, _ = walker(200)  # turns by 3 rad/s: nothing rests but what lies on the axis
    still = points.copy()
    still[:, 13:] = points[:1, 13:]  # the feet stand
    found = jitter(track_of(still + 0.05), FPS, truth_of(still))
    assert found.point_rms_mm[13] == pytest.approx(0.0, abs=1e-9)
    assert (found.at_rest[[11, 12]] == 0).all()
    assert np.isnan(found.point_rms_mm[11])
    assert found.rms_mm == pytest.approx(0.0, abs=1e-9)


def test_jitter_without_a_truth_takes_the_tracks_own_rest():
    still, _ = walker(1)
    moving, _ = walker(300)
    points = np.concatenate([np.repeat(still, 300, axis=0), moving])
    trembling = points + np.random.default_rng(14).normal(0.0, 0.001, points.shape)
    found = jitter(track_of(trembling), FPS)
    assert found.rms_mm == pytest.approx(np.sqrt(3.0), rel=0.05)
    assert 200 < found.at_rest[11] < 300


def test_jitter_has_no_value_for_a_track_with_gaps_everywhere():
    still, _ = walker(1)
    track = track_of(np.repeat(still, 40, axis=0))
    gaps = replace(track, frames=2 * track.frames)
    assert np.isnan(jitter(gaps, FPS).rms_mm)


def test_time_to_track_is_that_of_the_first_frame_that_is_called_tracked():
    points, _ = walker(6)
    track = track_of(points, ["acquiring", "doubtful", "doubtful", "tracking", "lost", "tracking"], first=30)
    assert time_to_track_s(track, FPS) == pytest.approx(33 / 60)
    assert np.isnan(time_to_track_s(track_of(points, ["doubtful"] * 6), FPS))


def test_a_track_of_nobody_has_no_jitter():
    found = jitter(NOBODY, FPS)
    assert np.isnan(found.rms_mm) and np.isnan(found.point_rms_mm).all() and found.at_rest.sum() == 0
