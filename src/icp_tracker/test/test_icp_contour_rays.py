"""Contour rays in the solve: the match of rays and surface, its derivatives, and what a fit makes of them."""

from dataclasses import replace

import numpy as np
import pytest
import synthetic_people as synthetic
from refinement_rays import grazing_rays

from icp_tracker.articulated_fit import ArticulatedSettings, VolumeSettings, rays_at_stamp
from mocap_packets.hull import ContourRays
from stick_figure.body_surface import BodySurface
from stick_figure.kinematics import forward
from stick_figure.least_squares.contour_factor import RayArrays, add_contour, match_rays
from stick_figure.least_squares.free_ends import straight_ends
from stick_figure.least_squares.placed_figure import Figure, State, place
from stick_figure.pose import Pose

STEP = 1e-6
NO_CENTERLINE = np.empty((0, 3))
RAYS_ALONE = ArticulatedSettings(volume=VolumeSettings(weight=0.0), max_iterations=30)


def as_arrays(rays):
    """The rays for the kernels, each of information 1."""
    return RayArrays.of(rays.points_world, rays.directions, rays.normals, rays.half_lengths, np.ones(len(rays)))


def disturbed(pose, rng, turn, shift):
    step = turn * rng.normal(size=24)
    step[:3] = shift * rng.normal(size=3)
    return pose.retract(step)


@pytest.fixture(scope="module")
def scene(body):
    pose = synthetic.smooth_motion(40, seed=3)[30]
    return body, pose, grazing_rays(body, pose, np.random.default_rng(5))


def test_rays_touch_the_surface_at_the_true_pose(scene):
    body, pose, rays = scene
    _, _, distance, separation = match_rays(as_arrays(rays), synthetic.placed(body, pose), 0.05)
    assert len(rays) > 250
    assert np.abs(distance).max() < 1e-9 and separation.max() < 1e-9


def test_a_ray_beyond_the_hulls_stretch_belongs_to_the_other_of_two_limbs_in_line():
    P, Q = np.array([[2.0, 0.0, 0.0], [3.0, 0.0, 0.0]]), np.array([[2.0, 0.0, 1.0], [3.0, 0.0, 1.0]])
    surface = BodySurface(np.zeros(2, int), P, Q, np.full((2, 2), 0.05))
    upright = Pose(np.zeros(3), np.eye(3), np.tile(np.eye(3), (5, 1, 1)), np.zeros(4))
    torso_at_zero = Figure(np.ones(10), np.zeros((10, 3)), surface)
    two_limbs = place(State.of(upright), torso_at_zero)
    at = [np.array([[x, 0.05, 0.5]]) for x in (2.0, 3.0)]
    rays = [
        ContourRays(p, np.array([[1.0, 0, 0]]), np.array([[0, 1.0, 0]]), np.array([0.1]), np.ones(1), np.zeros(1))
        for p in at
    ]
    assert [int(match_rays(as_arrays(ray), two_limbs, 0.05).capsule[0]) for ray in rays] == [0, 1]


def test_the_gradient_of_the_squared_distances_is_the_pull(scene):
    body, pose, rays = scene
    rng = np.random.default_rng(6)
    off = disturbed(pose, rng, 0.05, 0.02)
    match, radii = match_rays(as_arrays(rays), synthetic.placed(body, off), 0.05), Figure.of(body).surface.radii
    _, g = synthetic.equations(
        add_contour, as_arrays(rays), match, synthetic.placed(body, off), synthetic.weights(), straight_ends(0.0)
    )

    def cost(slot, step):
        """Half the squared distances with the axis points held to their capsules, as the linearisation does."""
        moved, capsule = synthetic.placed(body, off.retract(step * np.eye(24)[slot])), match.capsule
        c = moved.P[capsule] + match.along[:, None] * (moved.Q - moved.P)[capsule]
        radius = radii[capsule, 0] + match.along * (radii[capsule, 1] - radii[capsule, 0])
        e = np.einsum("ni,ni->n", rays.normals, rays.points_world - c) - radius
        return 0.5 * (e * e).sum()

    numeric = np.array([(cost(k, STEP) - cost(k, -STEP)) / (2 * STEP) for k in range(24)])
    # the neck has no twist of its own, which only a head that is not round notices, and hardly
    assert np.abs(numeric + g).max() < 5e-4 * np.abs(g).max()


@pytest.mark.parametrize("seed", range(2))
def test_contour_rays_alone_bring_a_disturbed_pose_back(scene, seed):
    body, pose, rays = scene
    start = disturbed(pose, np.random.default_rng(seed), 0.1, 0.03)
    before = np.linalg.norm(forward(body, start) - forward(body, pose), axis=1).mean()
    fit = synthetic.fit(body, start, NO_CENTERLINE, settings=RAYS_ALONE, contour_rays=rays)
    error = np.linalg.norm(fit.reference_points_world - forward(body, pose), axis=1)
    assert before > 0.04
    # the head's twist and the pull towards its rest leave a few millimetres at the crown
    assert error.mean() < 0.008 and error.max() < 0.035


def test_rays_of_another_time_touch_the_moving_body_as_it_is_at_the_stamp(scene):
    body, pose, rays = scene
    velocity, later_s = np.random.default_rng(8).normal(size=24), 0.02  # m/s, rad/s
    at_stamp, late = pose.retract(-velocity * later_s), replace(rays, time_s=np.full(len(rays), later_s))

    def off_m(rays):
        return np.abs(match_rays(as_arrays(rays), synthetic.placed(body, at_stamp), 0.05).distance)

    back = rays_at_stamp(late, body, at_stamp, velocity)
    assert np.median(off_m(late)) > 0.01 and np.median(off_m(back)) < 0.001
    assert np.percentile(off_m(back), 90) < 0.005 and not back.time_s.any()
    assert rays_at_stamp(rays, body, at_stamp, velocity) is rays  # of cameras in step
