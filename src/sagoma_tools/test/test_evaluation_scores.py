"""Points, angles, covariance coverage, jitter and time to track against values known by construction."""

from dataclasses import replace

import numpy as np
import pytest
from evaluation_tracks import SLOT, track_of, truth_of, turns, walker
from scipy.spatial.transform import Rotation

from capture_rig.errors import InputError
from capture_rig.session import WRIST_FRACTION
from sagoma_tools.evaluation.scores import (
    INSIDE_95,
    angle_truth,
    defined,
    mean_of_known,
    nees_of,
    score,
    score_angles,
    share_below,
)
from sagoma_tools.evaluation.track import Track
from sagoma_tools.evaluation.track_evaluation import jitter, time_to_track_s

FPS = 60.0
BENT = {"left_elbow": -1.2, "right_elbow": -0.9, "left_knee": 0.8, "right_knee": 1.1, "neck_x": 0.2, "left_hip_y": -0.5}
BENT |= {"left_shoulder_y": 0.3, "right_shoulder_y": -0.4, "left_hip_z": 0.2, "right_hip_z": -0.25}
POINTS, ANGLES = walker(**BENT)
TEN = POINTS[:10]
STILL = POINTS[:1]


# --- points


def test_an_offset_that_turns_with_the_body_is_reported_removed_and_no_lack_of_coverage():
    moved = TEN.copy()
    moved[:, 9] += 0.1 * turns(10)[:, :, 0]
    scores = score(track_of(moved), truth_of(TEN))
    assert scores.point_offset_mm[9] == pytest.approx([100.0, 0.0, 0.0], abs=1e-6)
    assert scores.point_offset_mm[10] == pytest.approx([0.0, 0.0, 0.0], abs=1e-6)
    assert scores.points.mean_mm[9] == scores.points.rmse_mm[9] == pytest.approx(100.0)
    assert scores.points.mean_mm_without_offset[9] == pytest.approx(0.0, abs=1e-6)
    assert scores.points.inside_95[9] == 0.0
    assert scores.points.inside_95_without_offset[9] == 1.0
    assert scores.figures()["inside_95_without_offset"] > scores.all_points.inside_95


def test_score_reports_each_points_own_statistics():
    moved = TEN.copy()
    moved[:, 7, 2] += 0.001 * np.array([0, 10, 20, 30, 40, 50, 60, 70, 80, 300])
    scores = score(track_of(moved), truth_of(TEN))
    assert scores.points.median_mm[7] == pytest.approx(45.0)
    assert scores.points.mean_mm[7] == pytest.approx(66.0)
    assert scores.points.rmse_mm[7] == pytest.approx(np.sqrt((20400 + 90000) / 10))  # 10^2 + .. + 80^2 = 20400
    assert scores.points.over_200mm[[7, 8]] == pytest.approx([0.1, 0.0])
    assert scores.all_points.over_200mm == pytest.approx(0.1)  # frames with one lost point


def test_score_compares_wrists_where_the_reference_ends_there():
    truth = truth_of(truth_of(TEN, wrist_fraction=WRIST_FRACTION).comparable(TEN), wrist_fraction=WRIST_FRACTION)
    assert not np.allclose(truth.points_world[:, 11], TEN[:, 11])
    assert score(track_of(TEN), truth).mean_mm == pytest.approx(0.0, abs=1e-6)


def test_score_leaves_out_what_track_or_truth_lack_and_refuses_a_track_of_other_frames():
    holes = TEN.copy()
    holes[:, 12] = np.nan
    scores = score(track_of(TEN[4:], first=4), truth_of(holes))
    assert (scores.tracked, scores.frames) == (6, 10)
    assert scores.mean_mm == pytest.approx(0.0) and scores.figures()["point_mm"]["right_hand"] is None
    with pytest.raises(InputError, match="shares none of its 10 frames"):
        score(track_of(TEN, first=100), truth_of(TEN))


# --- angles


def test_angle_errors_are_taken_the_short_way_round():
    truly, tracked = ANGLES[:10].copy(), ANGLES[:10].copy()
    truly[:, 3], tracked[:, 3] = np.deg2rad(-178.0), np.pi
    scores = score(track_of(TEN, angles=tracked), truth_of(TEN, truly))
    assert np.rad2deg(scores.angles.rmse_rad[3]) == pytest.approx(2.0)


def test_angle_truth_comes_from_the_points_where_the_reference_has_no_angles_and_is_unknown_where_one_is():
    points = POINTS.copy()
    points[5, 9] = np.nan
    found = angle_truth(truth_of(points))
    assert "inverse kinematics" in found.source
    assert np.isnan(found.angles[5]).all()
    np.testing.assert_allclose(np.delete(found.angles, 5, axis=0), ANGLES[1:], atol=1e-6)


TWISTS = {"left_shoulder_y", "right_shoulder_y", "left_hip_z", "right_hip_z"}
BARELY, JUST = ({**BENT, "left_elbow": -np.deg2rad(bend_deg)} for bend_deg in (19.0, 21.0))
FORWARD = {**BENT, "left_shoulder_z": -np.pi / 2}


@pytest.mark.parametrize(
    ("pose", "undefined"),
    [
        ({}, TWISTS),
        (BENT, set()),
        (BARELY, {"left_shoulder_y"}),
        (JUST, set()),
        (FORWARD, {"left_shoulder_x", "left_shoulder_y"}),
    ],
    ids=["straight", "bent", "bent by 19 degrees", "bent by 21 degrees", "arm straight forward"],
)
def test_angles_that_have_no_meaning_do_not_count(pose, undefined):
    _, angles = walker(1, **pose)
    assert {name for name, slot in SLOT.items() if not defined(angles)[0, slot]} == undefined


def test_angle_rmse_leaves_undefined_twists_out_and_says_how_many():
    true = ANGLES.copy()
    true[:30, SLOT["left_elbow"]] = 0.0  # straight for 30 of 40 frames
    wrong = true.copy()
    wrong[:30, SLOT["left_shoulder_y"]] += 2.0
    wrong[30:, SLOT["left_shoulder_y"]] += 0.1
    scores = score_angles(wrong, POINTS, angle_truth(truth_of(POINTS, true)))
    assert scores.rmse_rad[SLOT["left_shoulder_y"]] == pytest.approx(0.1)
    assert scores.share_defined[SLOT["left_shoulder_y"]] == pytest.approx(0.25)
    assert scores.rmse_rad[SLOT["right_shoulder_y"]] == pytest.approx(0.0)


def test_torso_error_is_the_angle_by_which_the_whole_body_is_turned():
    R = Rotation.from_rotvec(0.2 * np.array([2.0, 1.0, 2.0]) / 3.0).as_matrix()
    turned = (POINTS - POINTS[:, :1]) @ R.T + POINTS[:, :1]
    scores = score_angles(ANGLES, turned, angle_truth(truth_of(POINTS)))
    assert scores.torso_rmse_rad == pytest.approx(0.2, abs=1e-6)


# --- covariance


def test_nees_of_honest_noise_is_three_and_four_times_that_where_a_point_claims_half_the_sd_it_has():
    rng = np.random.default_rng(11)
    A = rng.normal(size=(15, 3, 3))
    P = 1e-4 * (A @ A.transpose(0, 2, 1) + np.eye(3))
    errors = np.einsum("pij,fpj->fpi", np.linalg.cholesky(P), rng.normal(size=(4000, 15, 3)))
    P[12] *= 0.25
    nees = nees_of(errors, np.broadcast_to(P, (4000, 15, 3, 3)))
    expected, inside = np.full(15, 3.0), np.full(15, 0.95)
    expected[12], inside[12] = 12.0, 0.418  # chi-square(3) at 7.81 / 4
    np.testing.assert_allclose(mean_of_known(nees, 0), expected, rtol=0.05)
    np.testing.assert_allclose(share_below(INSIDE_95, nees, 0), inside, atol=0.03)


# --- jitter and time to track


def test_jitter_of_white_noise_at_rest_is_its_size():
    noise = np.random.default_rng(13).normal(0.0, 0.002, (900, 15, 3))
    rms_mm, at_rest = jitter(track_of(STILL + noise), FPS, truth_of(np.repeat(STILL, 900, axis=0)))
    half = 15  # frames in a quarter of a second
    assert rms_mm == pytest.approx(2.0 * np.sqrt(3.0) * np.sqrt(1 - 1 / (2 * half + 1)), rel=0.01)
    assert (at_rest == 900 - 2 * half).all()


def test_jitter_is_blind_to_what_moves_and_to_a_constant_offset():
    still, _ = walker(200, **BENT)  # turns by 3 rad/s: nothing rests but what lies on the axis
    still[:, 13:] = STILL[:, 13:]  # the feet stand
    rms_mm, at_rest = jitter(track_of(still + 0.05), FPS, truth_of(still))
    assert (at_rest[[11, 12]] == 0).all()
    assert rms_mm == pytest.approx(0.0, abs=1e-9)


def test_jitter_without_a_truth_takes_the_tracks_own_rest():
    moving, _ = walker(300, **BENT)
    points = np.concatenate([np.repeat(STILL, 300, axis=0), moving])
    trembling = points + np.random.default_rng(14).normal(0.0, 0.001, points.shape)
    rms_mm, at_rest = jitter(track_of(trembling), FPS)
    assert rms_mm == pytest.approx(np.sqrt(3.0), rel=0.05)
    assert 200 < at_rest[11] < 300


def test_jitter_has_no_value_for_a_track_with_gaps_everywhere_or_of_nobody():
    track = track_of(np.repeat(STILL, 40, axis=0))
    assert np.isnan(jitter(replace(track, frames=2 * track.frames), FPS)[0])
    rms_mm, at_rest = jitter(Track.of_states([]), FPS)
    assert np.isnan(rms_mm) and at_rest.sum() == 0


def test_time_to_track_is_that_of_the_first_frame_that_is_called_tracked():
    states = ["acquiring", "doubtful", "doubtful", "tracking", "lost", "tracking"]
    assert time_to_track_s(track_of(POINTS[:6], states, first=30), FPS) == pytest.approx(33 / 60)
    assert np.isnan(time_to_track_s(track_of(POINTS[:6], "doubtful"), FPS))
