"""The all-joints solve on centerline points and contour rays: derivatives against finite differences, accuracy, soft
constraints, honest covariance."""

from dataclasses import replace

import numpy as np
import pytest
import synthetic_people as synthetic
from refinement_rays import grazing_rays

from icp_tracker.articulated_fit import ArticulatedSettings, VolumeSettings, rays_at_stamp
from mocap_packets.hull import ContourRays
from stick_figure.body_surface import BodySurface
from stick_figure.kinematics import forward, sticks
from stick_figure.least_squares.contour_factor import RayArrays, add_contour, match_rays
from stick_figure.least_squares.extremities import RAYS_PER_INDEPENDENT_SAMPLE, STIFF_SD, straight_extremities
from stick_figure.least_squares.point_factor import add_point_residuals, match_points
from stick_figure.least_squares.posed_model import BodyModel, PoseState, place
from stick_figure.pose import Pose
from stick_figure.skeleton import ANGLE_NAMES, HEAD

SIGMA = 0.034  # a sixth of the hips' distance, the noise of the article's synthetic experiment
CHI2_95 = 7.815  # 95 % point of chi-square with three degrees of freedom
NECK_Y = 7
STEP = 1e-6


def mean_error_mm(body, pose, truth):
    return 1e3 * np.linalg.norm(forward(body, pose) - forward(body, truth), axis=1).mean()


def nearest_on_sticks(ends, points):
    """Stick, position along it and foot point of every point, by plain numpy."""
    A, d = ends[:, 0], ends[:, 1] - ends[:, 0]
    u = np.clip(np.einsum("njk,jk->nj", points[:, None] - A, d) / (d * d).sum(1), 0, 1)
    feet = A + u[..., None] * d
    stick = np.linalg.norm(points[:, None] - feet, axis=2).argmin(1)
    rows = np.arange(len(points))
    return stick, u[rows, stick], feet[rows, stick]


@pytest.fixture
def scene(body):
    rng = np.random.default_rng(8)
    pose = synthetic.smooth_motion(5, seed=3)[4]
    points = synthetic.stick_cloud(body, pose.retract(0.05 * rng.normal(size=24)), rng, 120)
    return pose, points, rng.uniform(0.5, 2.0, len(points))


def test_normal_equations_are_those_of_finite_difference_jacobians(body, scene):
    pose, points, weight = scene
    data = synthetic.data(points=points, information=weight, gate2=np.full(len(points), 1e12))  # a wide gate: all count
    placed = synthetic.placed(body, pose)
    H, g = synthetic.equations(add_point_residuals, points, match_points(data, placed), placed)
    ends = sticks(body, pose)
    stick, u, foot = nearest_on_sticks(ends, points)
    assert {0.0, 1.0} < set(u.tolist())  # both clamped and sliding feet are there

    def feet(x):
        moved = sticks(body, pose.retract(x))[stick]
        return moved[:, 0] + u[:, None] * (moved[:, 1] - moved[:, 0])

    J = np.stack([(feet(STEP * e) - feet(-STEP * e)) / (2 * STEP) for e in np.eye(24)], axis=2)  # (n, 3, 24)
    direction = (ends[:, 1] - ends[:, 0])[stick]
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    slides = (u > 0) & (u < 1)
    J[slides] -= np.einsum("ni,nj,njk->nik", direction[slides], direction[slides], J[slides])
    expected = np.einsum("n,nik,nil->kl", weight, J, J)
    assert np.abs(H - expected).max() < 1e-7 * np.abs(expected).max()
    downhill = np.einsum("n,nik,ni->k", weight, J, points - foot)
    assert np.abs(g - downhill).max() < 1e-7 * np.abs(g).max()


def test_point_noise_weighs_the_points(body):
    """A third of the points is off by a constant shift; saying so in their sigma takes the shift out of the fit."""
    rng = np.random.default_rng(11)
    truth = synthetic.smooth_motion(5, seed=2)[3]
    points = synthetic.stick_cloud(body, truth, rng, 300, 0.01)
    bad = rng.random(len(points)) < 0.34
    points[bad] += [0.0, 0.06, 0.0]
    equal = synthetic.fit(body, truth, points, 0.0)
    told = synthetic.fit(body, truth, points, np.where(bad, 0.3, 0.0))
    assert mean_error_mm(body, told.pose, truth) < 0.5 * mean_error_mm(body, equal.pose, truth)


@pytest.mark.parametrize("hinge", ["left_elbow", "right_knee"])
def test_hinge_passes_straight_and_is_described_the_right_way_round(body, hinge):
    """The limb really bends to the other side of where the fit starts: clipped at straight it would never arrive."""
    slot = ANGLE_NAMES.index(hinge)
    angles = synthetic.t_pose().angles()
    angles[slot] = -0.4 if "elbow" in hinge else 0.4
    start = Pose.from_angles(np.array([0, 0, 1.2]), np.eye(3), angles)
    truth = start.retract(np.eye(24)[6 + slot] * -2 * angles[slot])  # bent the other way
    points = synthetic.stick_cloud(body, truth, np.random.default_rng(12), 400, 0.005)
    fit = synthetic.fit(body, start, points, settings=ArticulatedSettings(max_iterations=12, prior=4.0))
    assert mean_error_mm(body, fit.pose, truth) < 10.0
    assert (fit.pose.hinges[:2] <= 0.15).all() and (fit.pose.hinges[2:] >= -0.15).all()
    assert np.abs(fit.pose.hinges).max() == pytest.approx(0.4, abs=0.05)


def test_head_that_nothing_shows_returns_to_rest(body):
    truth = synthetic.t_pose()
    points = synthetic.stick_cloud(body, truth, np.random.default_rng(13), 300, 0.01)
    neck = forward(body, truth)[2]
    points = points[points[:, 2] < neck[2] - 0.02]  # nothing of the head is seen
    start = truth.retract(np.eye(24)[NECK_Y] * 1.2)
    fit = synthetic.fit(body, start, points, settings=ArticulatedSettings(max_iterations=20, prior=4.0))
    direction = fit.pose.R_joints[0, :, 2]
    assert not fit.visible[1] and np.arctan2(direction[0], direction[2]) == pytest.approx(0.1, abs=0.2)


def test_covariance_of_points_holds_what_it_says(body):
    """Those of half a stick count as one, so that it is large for independent noise: that holds it in 95 % and more."""
    settings, inside = ArticulatedSettings(model_sigma_m=SIGMA, prior=5.0), []
    for seed in range(3):
        rng = np.random.default_rng(seed)
        for truth in synthetic.smooth_motion(40, seed):
            fit = synthetic.fit(body, truth, synthetic.stick_cloud(body, truth, rng, 300, SIGMA), settings=settings)
            error = fit.reference_points_world - forward(body, truth)
            inside.append(np.einsum("pi,pij,pj->p", error, np.linalg.inv(fit.covariance), error) < CHI2_95)
    assert np.mean(inside, axis=0).min() > 0.95


def test_limb_without_points_is_invisible_and_uncertain(body):
    truth = synthetic.t_pose()
    points = synthetic.stick_cloud(body, truth, np.random.default_rng(15), 300, 0.01)
    stick, _, _ = nearest_on_sticks(sticks(body, truth), points)
    points = points[(stick != HEAD) & (stick != 6)]  # no head, no left forearm
    fit = synthetic.fit(body, truth, points, settings=ArticulatedSettings(prior=4.0))
    assert not fit.visible[[1, 11]].any()
    assert fit.visible[[0, 2, 3, 4, 5, 6, 7, 8, 9, 10, 12, 13, 14]].all()
    sd = np.sqrt(np.trace(fit.covariance, axis1=1, axis2=2))
    assert sd[11] > 5 * sd[12]
    assert sd[1] > 4 * sd[2]
    assert (np.linalg.eigvalsh(fit.covariance) > 0).all()


# --- contour rays -----------------------------------------------------------------------------------------------------

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
def ray_scene(body):
    pose = synthetic.smooth_motion(40, seed=3)[30]
    return body, pose, grazing_rays(body, pose, np.random.default_rng(5))


def test_a_ray_beyond_the_hulls_stretch_belongs_to_the_other_of_two_limbs_in_line():
    P, Q = np.array([[2.0, 0.0, 0.0], [3.0, 0.0, 0.0]]), np.array([[2.0, 0.0, 1.0], [3.0, 0.0, 1.0]])
    surface = BodySurface(np.zeros(2, int), P, Q, np.full((2, 2), 0.05))
    upright = Pose(np.zeros(3), np.eye(3), np.tile(np.eye(3), (5, 1, 1)), np.zeros(4))
    torso_at_zero = BodyModel(np.ones(10), np.zeros((10, 3)), surface)
    two_limbs = place(PoseState.of(upright), torso_at_zero)
    at = [np.array([[x, 0.05, 0.5]]) for x in (2.0, 3.0)]
    rays = [
        ContourRays(p, np.array([[1.0, 0, 0]]), np.array([[0, 1.0, 0]]), np.array([0.1]), np.ones(1), np.zeros(1))
        for p in at
    ]
    assert [int(match_rays(as_arrays(ray), two_limbs, 0.05).capsule[0]) for ray in rays] == [0, 1]


def test_the_gradient_of_the_squared_distances_is_the_pull(ray_scene):
    body, pose, rays = ray_scene
    rng = np.random.default_rng(6)
    off = disturbed(pose, rng, 0.05, 0.02)
    match, radii = match_rays(as_arrays(rays), synthetic.placed(body, off), 0.05), BodyModel.of(body).surface.radii
    _, g = synthetic.equations(
        add_contour,
        as_arrays(rays),
        match,
        synthetic.placed(body, off),
        synthetic.WIDE_M,
        straight_extremities(RAYS_PER_INDEPENDENT_SAMPLE / STIFF_SD**2),
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
def test_contour_rays_alone_bring_a_disturbed_pose_back(ray_scene, seed):
    body, pose, rays = ray_scene
    start = disturbed(pose, np.random.default_rng(seed), 0.1, 0.03)
    before = np.linalg.norm(forward(body, start) - forward(body, pose), axis=1).mean()
    fit = synthetic.fit(body, start, NO_CENTERLINE, settings=RAYS_ALONE, contour_rays=rays)
    error = np.linalg.norm(fit.reference_points_world - forward(body, pose), axis=1)
    assert before > 0.04
    # the head's twist and the pull towards its rest leave a few millimetres at the crown
    assert error.mean() < 0.008 and error.max() < 0.035


def test_rays_of_another_time_touch_the_moving_body_as_it_is_at_the_stamp(ray_scene):
    body, pose, rays = ray_scene
    velocity, later_s = np.random.default_rng(8).normal(size=24), 0.02  # m/s, rad/s
    at_stamp, late = pose.retract(-velocity * later_s), replace(rays, time_s=np.full(len(rays), later_s))

    def off_m(rays):
        return np.abs(match_rays(as_arrays(rays), synthetic.placed(body, at_stamp), 0.05).distance)

    back = rays_at_stamp(late, body, at_stamp, velocity)
    assert np.median(off_m(late)) > 0.01 and np.median(off_m(back)) < 0.001
    assert np.percentile(off_m(back), 90) < 0.005 and not back.time_s.any()
    assert rays_at_stamp(rays, body, at_stamp, velocity) is rays  # of cameras in step
