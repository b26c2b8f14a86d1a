"""Sticks inside the hull, trust in the hull, and the covariance's floor."""

from dataclasses import replace

import numpy as np
import pytest

from icp_tracker.acquisition.initial_pose import KnownPose
from icp_tracker.articulated_fit import ArticulatedSettings, VolumeSettings, fit_articulated, make_data, make_weights
from icp_tracker.tracker import IcpTracker, TrackerSettings
from mocap_packets.hull import HullProducts, VoxelSamples
from stick_figure.kinematics import forward, sticks
from stick_figure.least_squares.gauss_newton import loose_hull_weight
from stick_figure.least_squares.placed_figure import surface_distances
from stick_figure.least_squares.surface_factor import SAMPLES, add_inside

STEP = 1e-6
SLACK = 0.04
LEFT_SHOULDER_X = 8
LEFT_ELBOW, LEFT_HAND = 7, 11


def inside_equations(body, pose, voxels, synthetic):
    weights = synthetic.weights(inside=2.0, inside_slack=SLACK)
    return synthetic.equations(add_inside, synthetic.data(hull=voxels), synthetic.placed(body, pose), weights)


def outside_by(body, pose, voxels):
    """Distance beyond the slack of every stick point from the nearest voxel, by plain numpy."""
    ends = sticks(body, pose)[1:]
    along = (np.arange(SAMPLES) + 1.0) / SAMPLES
    points = (ends[:, None, 0] + along[:, None] * (ends[:, None, 1] - ends[:, None, 0])).reshape(-1, 3)
    distance = np.linalg.norm(points[:, None] - voxels, axis=2).min(axis=1)
    return np.maximum(distance - SLACK, 0.0)


def hull_of(body, pose, synthetic):
    """The body's surface as a voxel cloud, surface flagged."""
    points = synthetic.voxels(body, pose)
    cells = {tuple(c) for c in np.round(points / 0.03).astype(int)}
    steps = np.vstack([np.eye(3, dtype=int), -np.eye(3, dtype=int)])
    around = [[tuple(np.round(p / 0.03).astype(int) + s) in cells for s in steps] for p in points]
    return VoxelSamples.checked(points, ~np.all(around, axis=1))


@pytest.fixture
def away(body, synthetic):
    """A pose that is out of the hull of another, and that hull's voxels."""
    truth = synthetic.smooth_motion(5, seed=3)[4]
    pose = truth.retract(0.3 * np.random.default_rng(4).uniform(-1, 1, 24))
    return pose, synthetic.voxels(body, truth)


def test_inside_gradient_is_the_slope_of_the_squared_distances(body, away, synthetic):
    pose, voxels = away
    _, g = inside_equations(body, pose, voxels, synthetic)

    def cost(x):
        return 0.5 * 2.0 * (outside_by(body, pose.retract(x), voxels) ** 2).sum()

    slope = np.array([(cost(STEP * e) - cost(-STEP * e)) / (2 * STEP) for e in np.eye(24)])
    assert np.abs(g).max() > 0.01
    assert np.abs(g + slope).max() < 1e-6 * np.abs(g).max()


def test_inside_hessian_is_the_square_of_the_distances_jacobian(body, away, synthetic):
    pose, voxels = away
    H, _ = inside_equations(body, pose, voxels, synthetic)
    J = np.stack(
        [
            (outside_by(body, pose.retract(STEP * e), voxels) - outside_by(body, pose.retract(-STEP * e), voxels))
            / (2 * STEP)
            for e in np.eye(24)
        ],
        axis=1,
    )
    assert np.abs(H - 2.0 * J.T @ J).max() < 1e-6 * np.abs(H).max()


def test_pose_inside_its_hull_feels_nothing(body, synthetic):
    truth = synthetic.t_pose()
    H, g = inside_equations(body, truth, synthetic.voxels(body, truth), synthetic)
    assert not H.any() and not g.any()


def test_hull_rescues_an_arm_that_the_centerline_does_not_show(body, synthetic):
    """The arm sank by 0.4 rad between two sets, and no slice shows it: only the hull can tell."""
    start = synthetic.t_pose()
    lowering = np.zeros(24)
    lowering[LEFT_SHOULDER_X] = -0.4
    truth = start.retract(lowering)
    points = synthetic.stick_cloud(body, truth, np.random.default_rng(5), 300, 0.01)
    shoulder = forward(body, truth)[3]
    points = points[~((points[:, 1] > shoulder[1] + 0.03) & (points[:, 2] < shoulder[2] + 0.1) & (points[:, 2] > 0.9))]
    hull = hull_of(body, truth, synthetic)

    def hand_error(volume):
        settings = ArticulatedSettings(max_iterations=30, volume=volume)
        fit = fit_articulated(body, start, points, 0.0, hull, settings)
        return np.linalg.norm(fit.reference_points_world - forward(body, truth), axis=1)[LEFT_HAND]

    assert hand_error(VolumeSettings(weight=0.0, inside_weight=0.0, clearance_weight=0.0)) > 0.15
    assert hand_error(VolumeSettings(weight=0.0, clearance_weight=0.0)) < 0.10
    assert hand_error(VolumeSettings()) < 0.05


def test_loose_hull_weighs_less_than_a_tight_one(body, synthetic):
    truth, settings = synthetic.t_pose(), ArticulatedSettings()
    tight = hull_of(body, truth, synthetic)
    centre = truth.position_world
    loose = VoxelSamples.checked(centre + (tight.points_world - centre) * [2.5, 1.3, 1.0], tight.surface)

    def share(hull):
        data = make_data(np.zeros((20, 3)) + centre, 0.0, hull, settings)
        weights = make_weights(data, settings)
        _, _, distance = surface_distances(data.voxels, synthetic.placed(body, truth))
        return loose_hull_weight(weights, distance) / weights.voxel

    assert share(tight) > 0.8
    assert share(loose) < 0.5 * share(tight)


def test_limb_that_only_the_hull_shows_is_visible(body, synthetic):
    truth = synthetic.t_pose()
    points = synthetic.stick_cloud(body, truth, np.random.default_rng(7), 300, 0.01)
    points = points[points[:, 1] < 0.25]  # no left arm
    hidden = fit_articulated(body, truth, points)
    shown = fit_articulated(body, truth, points, 0.0, hull_of(body, truth, synthetic))
    assert not hidden.visible[[LEFT_ELBOW, LEFT_HAND]].any()
    assert shown.visible.all()


def test_first_pose_shows_all_points(body, synthetic):
    truth = synthetic.t_pose()
    points = synthetic.stick_cloud(body, truth, np.random.default_rng(8), 300, 0.01)
    points = points[points[:, 1] < 0.25]
    tracker = IcpTracker(KnownPose(truth, body), TrackerSettings())
    assert tracker.step(HullProducts.of_points(1, points)).visible.all()
    assert not tracker.step(HullProducts.of_points(2, points)).visible.all()


def test_same_hull_gives_the_same_bytes(body, synthetic, away):
    pose, _ = away
    truth = synthetic.t_pose()
    hull = hull_of(body, truth, synthetic)
    points = synthetic.stick_cloud(body, truth, np.random.default_rng(9))
    settings = replace(ArticulatedSettings(), max_iterations=5)
    first, second = (fit_articulated(body, pose, points, 0.0, hull, settings) for _ in range(2))
    for name in ("reference_points_world", "covariance"):
        assert getattr(first, name).tobytes() == getattr(second, name).tobytes()
