"""The tracker set after set: acquiring, following, missing data, predictions."""

from types import SimpleNamespace

import numpy as np
import pytest
import synthetic_people as synthetic

from icp_tracker.articulated_fit import ArticulatedSettings
from icp_tracker.initialization.initial_pose import InitialPose, KnownPose
from icp_tracker.people.people_tracker import PeopleTracker
from icp_tracker.tracker import IcpTracker, TrackerSettings
from mocap_packets.hull import HullProducts
from stick_figure.kinematics import forward

FPS, SIGMA = 40.0, 0.034
SETTINGS = TrackerSettings(articulated=ArticulatedSettings(model_sigma_m=SIGMA))


def stamp(frame):
    return 1_000_000_000 + round(frame * 1e9 / FPS)


def error_mm(body, result, truth):
    return 1e3 * np.linalg.norm(result.reference_points_world - forward(body, truth), axis=1).mean()


@pytest.fixture
def motion(body):
    rng = np.random.default_rng(1)
    poses = synthetic.smooth_motion(120, seed=1, fps=FPS)
    return poses, [synthetic.stick_cloud(body, pose, rng, 300, SIGMA) for pose in poses]


@pytest.mark.parametrize(
    ("method", "mean_mm", "worst_mm"), [("articulated", 16.0, 40.0), ("hierarchical", 45.0, 150.0)]
)
def test_motion_is_followed(body, motion, method, mean_mm, worst_mm):
    """300 points, sigma 34 mm, 40 Hz: the bound of a single set is about 14 mm."""
    poses, clouds = motion
    settings = TrackerSettings(method=method, articulated=SETTINGS.articulated)
    tracker = IcpTracker(KnownPose(poses[0], body), settings)
    results = [tracker.step(HullProducts.of_points(stamp(k), cloud)) for k, cloud in enumerate(clouds)]
    errors_mm = [error_mm(body, r, p) for r, p in zip(results, poses, strict=True)]
    assert np.mean(errors_mm) < mean_mm and max(errors_mm) < worst_mm
    assert {r.state for r in results} == {"tracking"}
    assert results[0].started_from == "initial"
    assert {r.started_from for r in results[1:]} == {"own"}
    assert all(r.visible.all() and r.reason == "" for r in results)


def test_motion_is_followed_across_missing_and_empty_sets(body, motion):
    poses, clouds = motion
    tracker = IcpTracker(KnownPose(poses[0], body), SETTINGS)
    errors = []
    for k, (pose, cloud) in enumerate(zip(poses, clouds, strict=True)):
        if k % 7 == 3:
            continue  # the set never came
        result = tracker.step(HullProducts.of_points(stamp(k), cloud if k % 7 != 5 else np.empty((0, 3))))
        errors.append(error_mm(body, result, pose))
    assert np.mean(errors) < 25.0
    assert errors[-1] < 30.0


@pytest.mark.parametrize(("later", "followed_s"), [(1, 1 / FPS), (80, 0.1)], ids=["the next set", "after 2 s"])
def test_set_without_points_keeps_the_prediction_followed_for_a_tenth_of_a_second_at_most(
    body, motion, later, followed_s
):
    poses, clouds = motion
    tracker = IcpTracker(KnownPose(poses[0], body), SETTINGS)
    tracker.step(HullProducts.of_points(stamp(0), clouds[0]))
    velocity = np.linspace(-1.0, 1.0, 24)
    prediction = SimpleNamespace(stamp_ns=stamp(0), pose=poses[5], velocity=velocity)
    result = tracker.step(HullProducts.of_points(stamp(later), np.empty((0, 3))), prediction)
    expected = forward(body, poses[5].retract(velocity * followed_s))
    assert np.abs(result.reference_points_world - expected).max() < 1e-7
    assert result.started_from == str(stamp(0))
    assert result.state == "lost" and result.solution is None and "0 centerline points" in result.reason
    assert not result.visible.any() and (np.linalg.eigvalsh(result.covariance) >= 99.0).all()
    nothing = SimpleNamespace(stamp_ns=stamp(later), pose=None, velocity=None)
    assert tracker.step(HullProducts.of_points(stamp(later + 1), clouds[5]), nothing).started_from == "own"


def test_points_that_are_not_finite_are_dropped_and_counted(body, motion):
    poses, clouds = motion
    clean, dirty = (PeopleTracker(lambda: IcpTracker(KnownPose(poses[0], body), SETTINGS)) for _ in range(2))
    bad = np.vstack([[np.nan, 0, 0], clouds[0], [0, np.inf, 0], [0.0, 0.0, 1.0]])
    sigma = np.zeros(len(bad))
    sigma[-1] = np.nan
    (result,) = dirty.step(HullProducts.of_points(stamp(0), bad, sigma), {})
    (expected,) = clean.step(HullProducts.of_points(stamp(0), clouds[0]), {})
    assert result.dropped_points == 3
    assert np.array_equal(result.reference_points_world, expected.reference_points_world)


def test_first_pose_that_explains_nothing_is_not_believed(body, motion):
    poses, clouds = motion
    tracker = IcpTracker(KnownPose(poses[0], body), SETTINGS)
    everywhere = np.random.default_rng(2).uniform([-2, -2, 0], [2, 2, 2], (300, 3))
    result = tracker.step(HullProducts.of_points(stamp(0), everywhere))
    assert result.state == "acquiring"
    assert "explains only" in result.reason
    assert tracker.step(HullProducts.of_points(stamp(1), clouds[1])).state == "tracking"
    fitted = SimpleNamespace(find_pose=lambda seen: InitialPose(poses[0], body, is_fitted=True))
    assert IcpTracker(fitted, SETTINGS).step(HullProducts.of_points(stamp(0), everywhere)).state == "tracking"
