"""The hull's voxels in the fit: body surface, its derivatives, trust in the hull, torso heading; the voxel cloud."""

import numpy as np
import synthetic_people as synthetic
from poses import pose_with

from icp_tracker.articulated_fit import ArticulatedSettings, VolumeSettings, make_data, make_weights
from mocap_packets.hull import VoxelSamples
from stick_figure.body_surface import BodySurface
from stick_figure.kinematics import forward, sticks
from stick_figure.least_squares.gauss_newton import hull_slack_weight
from stick_figure.least_squares.point_factor import add_surface
from stick_figure.least_squares.posed_model import BodyModel, PoseState, place, surface_distances

STEP = 1e-6
LEFT_ELBOW, LEFT_HAND = 7, 11
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


def surface_of(body, pose, rng, count=1500):
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


def test_normal_equations_of_voxels_are_those_of_finite_difference_derivatives(body):
    rng = np.random.default_rng(4)
    pose = synthetic.smooth_motion(5, seed=3)[4]
    voxels = surface_of(body, pose.retract(0.02 * rng.normal(size=24)), rng, 200)
    figure = BodyModel.of(body)
    # without taper: a taper tilts the surface against the axis, which the solver's normal leaves out
    radii = np.repeat(BodySurface.of(body).radii.mean(1, keepdims=True), 2, axis=1)
    even = place(PoseState.of(pose), figure._replace(surface=figure.surface._replace(radii=radii)))
    distances_m = surface_distances(voxels, even)
    H, g = synthetic.equations(add_surface, voxels, distances_m, even, 1.0, synthetic.WIDE_M)

    def distances(x):
        P, Q, _ = capsules(synthetic.placed(body, pose.retract(x)))
        return signed_distances(voxels, P, Q, radii).min(1)

    J = np.stack([(distances(STEP * e) - distances(-STEP * e)) / (2 * STEP) for e in np.eye(24)], axis=1)
    error = np.abs(H - J.T @ J)
    assert error.max() < NECK_TOLERANCE * np.abs(H).max()
    assert error[np.ix_(NOT_NECK, NOT_NECK)].max() < 1e-6 * np.abs(H).max()
    uphill = J.T @ distances(np.zeros(24))
    assert np.abs(g + uphill).max() < NECK_TOLERANCE * np.abs(g).max()
    assert np.abs(g + uphill)[NOT_NECK].max() < 1e-6 * np.abs(g).max()


def test_hull_shows_the_heading_that_the_centerline_cannot(body):
    """Arms hang down: the torso's stick and its slices say nothing of where it faces, its flat surface does."""
    rng = np.random.default_rng(5)
    truth = pose_with(at=(0.0, 0.0, 1.2), left_shoulder_x=-1.45, right_shoulder_x=np.pi + 1.45)
    turn = np.zeros(24)
    turn[5] = 0.35
    voxels = VoxelSamples(surface_of(body, truth, rng), np.ones(1500, bool))
    torso = sticks(body, truth)[0]
    points = torso[0] + np.linspace(0, 1, 40)[:, None] * (torso[1] - torso[0])

    def heading_error(settings):
        fit = synthetic.fit(body, truth.retract(turn), points, 0.0, voxels, settings)
        across = forward(body, fit.pose)[5] - forward(body, fit.pose)[6]
        return abs(np.arctan2(-across[0], across[1]))

    blind = ArticulatedSettings(max_iterations=20, volume=VolumeSettings(weight=0.0))
    assert heading_error(blind) > 0.2
    assert heading_error(ArticulatedSettings(max_iterations=20)) < 0.07


def hull_of(body, pose):
    """The body's surface as a voxel cloud, surface flagged."""
    points = synthetic.voxels(body, pose)
    cells = {tuple(c) for c in np.round(points / 0.03).astype(int)}
    steps = np.vstack([np.eye(3, dtype=int), -np.eye(3, dtype=int)])
    around = [[tuple(np.round(p / 0.03).astype(int) + s) in cells for s in steps] for p in points]
    return VoxelSamples(points, ~np.all(around, axis=1))


def test_loose_hull_weighs_less_than_a_tight_one(body):
    truth, settings = synthetic.t_pose(), ArticulatedSettings()
    tight = hull_of(body, truth)
    centre = truth.position_world
    loose = VoxelSamples(centre + (tight.points_world - centre) * [2.5, 1.3, 1.0], tight.surface)

    def share(hull):
        data = make_data(np.zeros((20, 3)) + centre, 0.0, hull, settings)
        weights = make_weights(data, settings)
        _, _, distance = surface_distances(data.voxels, synthetic.placed(body, truth))
        return hull_slack_weight(weights, distance) / weights.voxel

    assert share(tight) > 0.8
    assert share(loose) < 0.5 * share(tight)


def test_limb_that_only_the_hull_shows_is_visible(body):
    truth = synthetic.t_pose()
    points = synthetic.stick_cloud(body, truth, np.random.default_rng(7), 300, 0.01)
    points = points[points[:, 1] < 0.25]  # no left arm
    hidden = synthetic.fit(body, truth, points)
    shown = synthetic.fit(body, truth, points, 0.0, hull_of(body, truth))
    assert not hidden.visible[[LEFT_ELBOW, LEFT_HAND]].any()
    assert shown.visible.all()
