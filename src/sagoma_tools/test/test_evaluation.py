"""Scoring a track against a truth whose error is known by construction, and drawing back in image pixels."""

from pathlib import Path

import numpy as np
import pytest

from capture_rig.errors import InputError
from capture_rig.session import WRIST_FRACTION, Truth
from sagoma_tools.evaluation.scores import score
from sagoma_tools.evaluation.track import Track
from stick_figure.body import Body
from stick_figure.kinematics import forward
from stick_figure.pose import T_POSE_ANGLES, Pose

FRAMES = np.arange(10, 20)


@pytest.fixture
def points_world() -> np.ndarray:
    """(10, 15, 3) a walking T-pose that turns a little every frame."""
    body = Body.from_stature(1.75)
    turn = [np.array([[np.cos(a), -np.sin(a), 0], [np.sin(a), np.cos(a), 0], [0, 0, 1]]) for a in 0.1 * np.arange(10)]
    return np.stack([forward(body, Pose.from_angles([0.1 * k, 0, 1], R, T_POSE_ANGLES)) for k, R in enumerate(turn)])


def truth_of(points_world: np.ndarray, wrist_fraction: float = 1.0, angles: np.ndarray | None = None) -> Truth:
    return Truth(FRAMES, points_world, angles, wrist_fraction, Path("truth.csv"))


def track_of(points_world: np.ndarray, sd_m: float = 0.01, frames: np.ndarray = FRAMES) -> Track:
    covariance = np.broadcast_to(np.eye(3) * sd_m**2, (*points_world.shape, 3)).copy()
    angles, parts = np.tile(T_POSE_ANGLES, (len(frames), 1)), np.full((len(frames), 5), "good")
    return Track(frames, points_world, covariance, angles, tracking(len(frames)), parts)


def tracking(count: int) -> np.ndarray:
    return np.full(count, "tracking")


def test_score_reports_the_distance_when_every_point_is_moved_by_it(points_world):
    scores = score(track_of(points_world + np.array([0.0, 0.03, 0.04])), truth_of(points_world))
    assert scores.mean_mm == pytest.approx(50.0)
    assert scores.rmse_mean_mm == pytest.approx(50.0)
    assert scores.over_200mm == 0.0
    assert scores.tracked == scores.frames == 10


def test_score_removes_an_offset_that_turns_with_the_pelvis(points_world):
    turn = [np.array([[np.cos(a), -np.sin(a), 0], [np.sin(a), np.cos(a), 0], [0, 0, 1]]) for a in 0.1 * np.arange(10)]
    biased = points_world.copy()
    biased[:, 3] += np.stack([R @ [0.0, 0.06, 0.0] for R in turn])
    scores = score(track_of(biased), truth_of(points_world))
    assert scores.point_mm[3] == pytest.approx(60.0)
    assert scores.point_mm_without_offset[3] == pytest.approx(0.0, abs=1e-6)


def test_score_counts_frames_with_one_lost_point(points_world):
    lost = points_world.copy()
    lost[:3, 11] += [0.25, 0.0, 0.0]
    assert score(track_of(lost), truth_of(points_world)).over_200mm == pytest.approx(0.3)


def test_score_compares_wrists_where_the_reference_ends_there(points_world):
    truth = truth_of(truth_of(points_world, WRIST_FRACTION).comparable(points_world), WRIST_FRACTION)
    assert not np.allclose(truth.points_world[:, 11], points_world[:, 11])
    assert score(track_of(points_world), truth).mean_mm == pytest.approx(0.0, abs=1e-6)


def test_score_leaves_out_frames_that_the_track_lacks(points_world):
    scores = score(track_of(points_world[:4], frames=FRAMES[:4]), truth_of(points_world))
    assert (scores.tracked, scores.frames) == (4, 10)
    assert scores.mean_mm == pytest.approx(0.0)


def test_score_refuses_a_track_of_other_frames(points_world):
    with pytest.raises(InputError, match="shares none of its 10 frames"):
        score(track_of(points_world, frames=FRAMES + 100), truth_of(points_world))


def test_share_inside_the_ellipsoid_is_near_95_percent_for_honest_noise(points_world):
    rng = np.random.default_rng(5)
    noise = rng.normal(0.0, 0.02, (40, *points_world.shape))
    shares = [score(track_of(points_world + n, sd_m=0.02), truth_of(points_world)).coverage.inside_95 for n in noise]
    assert np.mean(shares) == pytest.approx(0.95, abs=0.01)


def test_a_constant_offset_is_reported_and_is_no_lack_of_coverage(points_world):
    rng = np.random.default_rng(6)
    forward_world = np.stack([[np.cos(a), np.sin(a), 0.0] for a in 0.1 * np.arange(10)])  # as the body turns
    moved = points_world + rng.normal(0.0, 0.005, points_world.shape)
    moved[:, 9] += 0.1 * forward_world
    scores = score(track_of(moved, sd_m=0.005), truth_of(points_world))
    assert scores.point_offset_mm[9] == pytest.approx([100.0, 0.0, 0.0], abs=8.0)
    assert np.abs(scores.point_offset_mm[10]).max() < 8.0
    assert scores.coverage.point_inside_95[9] == 0.0
    assert scores.coverage_without_offset.point_inside_95[9] >= 0.9
    assert scores.figures()["inside_95_without_offset"] > scores.coverage.inside_95


def test_score_reports_each_points_own_statistics(points_world):
    moved = points_world.copy()
    moved[:, 7, 2] += 0.001 * np.array([0, 10, 20, 30, 40, 50, 60, 70, 80, 300])
    scores = score(track_of(moved), truth_of(points_world))
    assert scores.point_median_mm[7] == pytest.approx(45.0)
    assert scores.point_mm[7] == pytest.approx(66.0)
    assert scores.point_rmse_mm[7] == pytest.approx(np.sqrt((20400 + 90000) / 10))  # 10^2 + .. + 80^2 = 20400
    assert scores.point_over_200mm[7] == pytest.approx(0.1)
    assert scores.point_over_200mm[8] == 0.0


def test_a_point_that_the_truth_never_knows_has_no_score(points_world):
    holes = points_world.copy()
    holes[:, 12] = np.nan
    scores = score(track_of(points_world), truth_of(holes))
    assert np.isnan(scores.point_mm[12])
    assert np.isfinite(scores.mean_mm)
    assert scores.figures()["point_mm"]["right_hand"] is None


def test_angle_errors_are_taken_the_short_way_round(points_world):
    angles = np.tile(T_POSE_ANGLES, (10, 1))
    angles[:, 3] = -np.pi + np.deg2rad(2.0)  # the truth says -178 degrees, the track +180
    scores = score(track_of(points_world), truth_of(points_world, angles=angles))
    assert scores.angle_rmse_deg[3] == pytest.approx(2.0)
