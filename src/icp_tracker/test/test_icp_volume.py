"""The hull's voxels in the fit: body surface, its derivatives, room for the arms, torso heading; the voxel cloud."""

import numpy as np
import pytest

from icp_tracker.articulated_fit import ArticulatedSettings, VolumeSettings, fit_articulated
from mocap_packets.hull import VoxelSamples
from stick_figure.body_surface import TORSO_CAPSULES, BodySurface
from stick_figure.kinematics import forward, sticks
from stick_figure.least_squares.placed_figure import Figure, State, place, surface_distances
from stick_figure.least_squares.surface_factor import (
    CLEARANCE_M,
    add_arm_clearance,
    add_inside,
    add_surface,
    torso_distance,
)
from stick_figure.pose import Pose
from stick_figure.skeleton import ANGLE_NAMES

STEP = 1e-6
NOT_NECK = np.delete(np.arange(24), [6, 7])
NECK_TOLERANCE = 1e-4  # the neck has no twist of its own, which a head that is not round notices, but hardly


def signed_distances(points, P, Q, radii):
    """(points, capsules) signed distances to the capsules, by plain numpy."""
    d = Q - P
    u = np.clip(np.einsum("nkj,kj->nk", points[:, None] - P, d) / (d * d).sum(1), 0, 1)
    gap = np.linalg.norm(points[:, None] - P - u[..., None] * d, axis=2)
    return gap - (radii[:, 0] + u * (radii[:, 1] - radii[:, 0]))


def capsules(placed):
    """World ends P, Q (k, 3) and radii (k, 2) of the body's capsules."""
    return placed.P, placed.Q, placed.surface.radii


def surface_of(synthetic, body, pose, rng, count=1500):
    """Points spread over the outside of the body."""
    P, Q, radii = capsules(synthetic.placed(body, pose))
    capsule = rng.integers(0, len(P), 4 * count)
    u = rng.random(len(capsule))
    axis = (Q - P)[capsule] / np.linalg.norm(Q - P, axis=1)[capsule][:, None]
    across = np.cross(axis, rng.normal(size=(len(capsule), 3)))
    across /= np.linalg.norm(across, axis=1)[:, None]
    radius = radii[capsule, 0] + u * (radii[capsule, 1] - radii[capsule, 0])
    points = P[capsule] + u[:, None] * (Q - P)[capsule] + radius[:, None] * across
    outside = signed_distances(points, P, Q, radii).min(1) > -1e-6
    return points[outside][:count]


def bent(pose, **angles):
    values = pose.angles()
    for name, value in angles.items():
        values[ANGLE_NAMES.index(name)] = value
    return Pose.from_angles(pose.position_world, pose.R_world_torso, values)


def test_flesh_is_as_symmetric_as_the_body(body, synthetic):
    P, Q, radii = capsules(synthetic.placed(body, synthetic.t_pose((0, 0, 0))))
    ends = np.sort(np.round(np.abs(np.vstack([P, Q])[:, 1]), 9))
    assert np.isclose(P[:, 1].sum() + Q[:, 1].sum(), 0.0, atol=1e-9)
    assert np.allclose(ends[ends > 1e-6][::2], ends[ends > 1e-6][1::2])
    assert (radii > 0).all() and (radii < 0.15).all()


def test_flesh_of_an_adult_weighs_what_an_adult_does(body, synthetic):
    """Volume by Monte Carlo: 1.75 m tall, about the 65 to 85 litres of the people it stands for."""
    pose = synthetic.t_pose((0, 0, 1.2))
    P, Q, radii = capsules(synthetic.placed(body, pose))
    low, high = np.minimum(P, Q).min(0) - 0.15, np.maximum(P, Q).max(0) + 0.15
    samples = np.random.default_rng(1).uniform(low, high, (60_000, 3))
    litres = 1e3 * np.prod(high - low) * (signed_distances(samples, P, Q, radii).min(1) < 0).mean()
    assert 50 < litres < 90


def test_nearest_flesh_is_the_least_signed_distance(body, synthetic):
    posed = synthetic.placed(body, synthetic.smooth_motion(5, seed=1)[4])
    P, Q, radii = capsules(posed)
    points = np.random.default_rng(2).uniform(P.min(0) - 0.3, P.max(0) + 0.3, (300, 3))
    capsule, _, distance = surface_distances(points, posed)
    expected = signed_distances(points, P, Q, radii)
    assert np.abs(distance - expected.min(1)).max() < 1e-12
    assert np.array_equal(capsule, expected.argmin(1))


def test_gradient_of_voxels_equals_the_slope_of_their_squared_distances(body, synthetic):
    rng = np.random.default_rng(3)
    pose = synthetic.smooth_motion(5, seed=2)[4]
    voxels = surface_of(synthetic, body, pose.retract(0.05 * rng.normal(size=24)), rng, 300)
    _, g = voxel_equations(body, pose, voxels, synthetic)

    def cost(x):
        P, Q, _ = capsules(synthetic.placed(body, pose.retract(x)))
        return 0.5 * (signed_distances(voxels, P, Q, even_radii(body)).min(1) ** 2).sum()

    slope = np.array([(cost(STEP * e) - cost(-STEP * e)) / (2 * STEP) for e in np.eye(24)])
    assert np.abs(g + slope).max() < NECK_TOLERANCE * np.abs(g).max()
    assert np.abs(g + slope)[NOT_NECK].max() < 1e-6 * np.abs(g).max()


def test_hessian_of_voxels_is_the_sum_of_finite_difference_derivatives(body, synthetic):
    rng = np.random.default_rng(4)
    pose = synthetic.smooth_motion(5, seed=3)[4]
    voxels = surface_of(synthetic, body, pose.retract(0.02 * rng.normal(size=24)), rng, 200)
    H, _ = voxel_equations(body, pose, voxels, synthetic)
    radii = even_radii(body)

    def distances(x):
        P, Q, _ = capsules(synthetic.placed(body, pose.retract(x)))
        return signed_distances(voxels, P, Q, radii).min(1)

    J = np.stack([(distances(STEP * e) - distances(-STEP * e)) / (2 * STEP) for e in np.eye(24)], axis=1)
    error = np.abs(H - J.T @ J)
    assert error.max() < NECK_TOLERANCE * np.abs(H).max()
    assert error[np.ix_(NOT_NECK, NOT_NECK)].max() < 1e-6 * np.abs(H).max()


def even_radii(body):
    """Radii without taper: a taper tilts the surface against the axis, which the solver's normal leaves out."""
    return np.repeat(BodySurface.of(body).radii.mean(1, keepdims=True), 2, axis=1)


def voxel_equations(body, pose, voxels, synthetic):
    figure = Figure.of(body)
    even = place(State.of(pose), figure._replace(surface=figure.surface._replace(radii=even_radii(body))))
    return synthetic.equations(add_surface, synthetic.data(voxels=voxels), even, synthetic.weights(voxel=1.0))


def test_arm_in_the_torso_is_pushed_out_along_the_slope_of_its_depth(body, synthetic):
    pose = bent(synthetic.t_pose((0.1, 0.2, 1.2), 0.4), left_shoulder_x=-1.9, left_elbow=-0.8)
    weights = synthetic.weights(clearance=1.0)
    H, g = synthetic.equations(add_arm_clearance, synthetic.placed(body, pose), weights)

    def cost(x):
        moved = pose.retract(np.r_[np.zeros(6), x])
        P, Q, radii = capsules(synthetic.placed(body, moved))
        ends, total = sticks(body, moved), 0.0
        for stick, places in ((2, (0.5, 0.75, 1.0)), (6, (0.3, 0.6, 0.85))):
            points = np.array([ends[stick, 0] + u * (ends[stick, 1] - ends[stick, 0]) for u in places])
            nearest = signed_distances(points, P[:TORSO_CAPSULES], Q[:TORSO_CAPSULES], radii[:TORSO_CAPSULES])
            total += 0.5 * (np.maximum(CLEARANCE_M - nearest.min(1), 0) ** 2).sum()
        return total

    slope = np.array([(cost(STEP * e) - cost(-STEP * e)) / (2 * STEP) for e in np.eye(18)])
    assert cost(np.zeros(18)) > 1e-4
    assert np.abs(g[6:] + slope).max() < 0.1 * np.abs(slope).max()
    assert not g[:6].any() and not H[:6].any()


def test_torso_distance_is_negative_inside_with_a_normal_that_points_out(body, synthetic):
    posed, normal = synthetic.placed(body, synthetic.t_pose((0, 0, 1.2))), np.empty(3)
    assert torso_distance(posed.t0 + np.array([0.05, 0.0, 0.0]), posed, normal) < 0
    assert normal[0] > 0.9
    assert torso_distance(posed.t0 + np.array([0.0, 0.5, 0.0]), posed, normal) == pytest.approx(
        0.5 - 0.16, abs=0.02
    )  # half the trunk's width
    assert normal[1] > 0.99


def test_hull_shows_the_heading_that_the_centerline_cannot(body, synthetic):
    """Arms hang down: the torso's stick and its slices say nothing of where it faces, its flat surface does."""
    rng = np.random.default_rng(5)
    truth = bent(synthetic.t_pose(), left_shoulder_x=-1.45, right_shoulder_x=np.pi + 1.45)
    turn = np.zeros(24)
    turn[5] = 0.35
    voxels = VoxelSamples.checked(surface_of(synthetic, body, truth, rng), np.ones(1500, bool))
    torso = sticks(body, truth)[0]
    points = torso[0] + np.linspace(0, 1, 40)[:, None] * (torso[1] - torso[0])

    def heading_error(settings):
        fit = fit_articulated(body, truth.retract(turn), points, 0.0, voxels, settings)
        across = forward(body, fit.pose)[5] - forward(body, fit.pose)[6]
        return abs(np.arctan2(-across[0], across[1]))

    blind = ArticulatedSettings(max_iterations=20, volume=VolumeSettings(weight=0.0, inside_weight=0.0))
    assert heading_error(blind) > 0.2
    assert heading_error(ArticulatedSettings(max_iterations=20)) < 0.07


def test_voxel_cloud_keeps_finite_samples_and_spreads_its_choice():
    points = np.arange(30.0).reshape(10, 3)
    points[4, 1] = np.nan
    surface = np.array([1, 1, 1, 0, 1, 1, 1, 0, 1, 1], bool)
    cloud = VoxelSamples.checked(points, surface)
    assert len(cloud) == 9
    assert np.array_equal(cloud.surface_points(100)[:, 0], [0, 3, 6, 15, 18, 24, 27])
    assert np.array_equal(cloud.surface_points(3)[:, 0], [0, 6, 18])


def test_stick_outside_the_hull_is_pulled_in_along_the_slope_of_its_distance(body, synthetic):
    slack = 0.05
    truth = synthetic.t_pose()
    pose = bent(truth, left_shoulder_x=0.8, right_elbow=-0.9)
    hull = synthetic.voxels(body, truth, 0.05)
    weights = synthetic.weights(inside=1.0, inside_slack=slack)
    _, g = synthetic.equations(add_inside, synthetic.data(hull=hull), synthetic.placed(body, pose), weights)

    def cost(x):
        ends = sticks(body, pose.retract(x))[1:]
        points = np.concatenate([ends[:, 0] + u * (ends[:, 1] - ends[:, 0]) for u in (1 / 3, 2 / 3, 1.0)])
        nearest = np.linalg.norm(points[:, None] - hull, axis=2).min(1)
        return 0.5 * (np.maximum(nearest - slack, 0.0) ** 2).sum()

    slope = np.array([(cost(STEP * e) - cost(-STEP * e)) / (2 * STEP) for e in np.eye(24)])
    assert cost(np.zeros(24)) > 0.01
    assert np.abs(g + slope).max() < NECK_TOLERANCE * np.abs(g).max()
    assert np.abs(g + slope)[NOT_NECK].max() < 1e-6 * np.abs(g).max()


def test_pose_inside_the_hull_feels_no_pull(body, synthetic):
    truth = synthetic.t_pose()
    data = synthetic.data(hull=synthetic.voxels(body, truth, 0.03))
    weights = synthetic.weights(inside=1.0, inside_slack=0.045, inside_gate=0.2)
    H, g = synthetic.equations(add_inside, data, synthetic.placed(body, truth), weights)
    assert not g.any() and not H.any()
