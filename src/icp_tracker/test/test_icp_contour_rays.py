"""Contour rays in the solve: the match of rays and surface, its derivatives, and what a fit makes of them."""

import copy
from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import minimize_scalar

from icp_tracker.articulated_fit import (
    ArticulatedSettings,
    ContourSettings,
    VolumeSettings,
    fit_articulated,
    rays_at_stamp,
)
from mocap_packets.hull import ContourRays
from stick_figure.body_surface import BodySurface
from stick_figure.kinematics import forward
from stick_figure.least_squares.contour_factor import RayArrays, add_contour, match_rays
from stick_figure.least_squares.free_ends import straight_ends
from stick_figure.least_squares.placed_figure import Figure, State, place
from stick_figure.pose import Pose

STEP = 1e-6
CAMERAS = np.array([[3.0 * np.cos(a), 3.0 * np.sin(a), 1.6] for a in np.arange(6) * np.pi / 3])
NO_CENTERLINE = np.empty((0, 3))
RAYS_ALONE = ArticulatedSettings(volume=VolumeSettings(weight=0.0), max_iterations=30)


def placed(body, pose):
    """The body of average build in a pose, as the kernels take it."""
    return place(State.of(pose), Figure.of(body))


def clearance(origin, directions, P, Q, radii):
    """(rays, capsules) least of distance to the axis less radius over a dense sampling of each axis: plain numpy."""
    u = np.linspace(0.0, 1.0, 41)[:, None, None]
    points = (P + u * (Q - P)).reshape(-1, 3) - origin
    radius = (radii[:, 0] + u[..., 0] * (radii[:, 1] - radii[:, 0])).reshape(-1)
    gap = np.linalg.norm(np.cross(directions[:, None], points), axis=2) - radius
    return gap.reshape(len(directions), 41, len(P)).min(1)


def grazing_rays(body, pose, rng, per_camera=120):
    """Rays of six cameras that touch the body of ``pose`` without entering it anywhere, with their true normals.

    Each starts at a random point of a silhouette's inside and is turned outward until it just leaves the body.
    """
    posed = placed(body, pose)
    P, Q, radii = posed.P, posed.Q, posed.surface.radii
    rays = []
    for camera in CAMERAS:
        capsule = rng.integers(0, len(P), per_camera)
        inner = (P + rng.random((len(P), 1)) * (Q - P))[capsule]
        ahead = (inner - camera) / np.linalg.norm(inner - camera, axis=1)[:, None]
        aside = np.cross(ahead, rng.normal(size=ahead.shape))
        aside /= np.linalg.norm(aside, axis=1)[:, None]
        far = np.zeros(per_camera)
        for angle in np.arange(0.4, 0.0, -0.004):  # from outside inwards: the outermost crossing is the rim
            inside = clearance(camera, ahead + np.tan(angle) * aside, P, Q, radii).min(1) < 0.0
            far = np.where((far == 0.0) & inside, angle, far)
        low, high = far, far + 0.004
        for _ in range(20):
            middle = 0.5 * (low + high)
            inside = clearance(camera, _turned(ahead, aside, middle), P, Q, radii).min(1) < 0.0
            low, high = np.where(inside, middle, low), np.where(inside, high, middle)
        directions = _turned(ahead, aside, high)
        owner = clearance(camera, directions, P, Q, radii).argmin(1)
        for d, k in zip(directions[far > 0.0], owner[far > 0.0], strict=True):
            rays.append(_touching(camera, d, P[k], Q[k], radii[k]))
    points, directions, normals = (np.array(part) for part in zip(*rays, strict=True))
    count = len(points)
    return ContourRays(points, directions, normals, np.full(count, 0.1), np.full(count, 0.003), np.zeros(count))


def _turned(ahead, aside, angle):
    turned = ahead + np.tan(angle)[:, None] * aside
    return turned / np.linalg.norm(turned, axis=1)[:, None]


def _touching(camera, d, p, q, radii):
    """Where a ray touches a capsule: point on the ray, direction, outward normal."""

    def gap(u):
        c = p + u * (q - p) - camera
        return np.linalg.norm(np.cross(d, c)) - radii[0] - u * (radii[1] - radii[0])

    u = minimize_scalar(gap, bounds=(0.0, 1.0), method="bounded").x
    c = p + u * (q - p) - camera
    normal = (c @ d) * d - c
    return camera + (c @ d) * d, d, normal / np.linalg.norm(normal)


def as_arrays(rays):
    """The rays for the kernels, each of information 1."""
    return RayArrays.of(rays.points_world, rays.directions, rays.normals, rays.half_lengths, np.ones(len(rays)))


def disturbed(pose, rng, turn, shift):
    step = turn * rng.normal(size=24)
    step[:3] = shift * rng.normal(size=3)
    return pose.retract(step)


@pytest.fixture(scope="module")
def posed(body, synthetic):
    rng = np.random.default_rng(5)
    pose = synthetic.smooth_motion(40, seed=3)[30]
    return body, pose, grazing_rays(body, pose, rng), rng


@pytest.fixture
def scene(posed):
    return *posed[:3], copy.deepcopy(posed[3])


def test_rays_touch_the_surface_at_the_true_pose(scene):
    body, pose, rays, _ = scene
    _, _, distance, separation = match_rays(as_arrays(rays), placed(body, pose), 0.05)
    assert len(rays) > 300
    # a tapered capsule's true contour lies off the middle of its cone by less than this
    assert np.percentile(np.abs(distance), 95) < 2e-3
    assert np.percentile(separation, 95) < 0.02  # at rounded ends the contour does not face the axis


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


def test_the_gradient_of_the_squared_distances_is_the_pull(scene, synthetic):
    body, pose, rays, rng = scene
    off = disturbed(pose, rng, 0.05, 0.02)
    match, radii = match_rays(as_arrays(rays), placed(body, off), 0.05), Figure.of(body).surface.radii
    _, g = synthetic.equations(
        add_contour, as_arrays(rays), match, placed(body, off), synthetic.weights(), straight_ends(0.0)
    )

    def cost(slot, step):
        """Half the squared distances with the axis points held to their capsules, as the linearisation does."""
        moved, capsule = placed(body, off.retract(step * np.eye(24)[slot])), match.capsule
        c = moved.P[capsule] + match.along[:, None] * (moved.Q - moved.P)[capsule]
        radius = radii[capsule, 0] + match.along * (radii[capsule, 1] - radii[capsule, 0])
        e = np.einsum("ni,ni->n", rays.normals, rays.points_world - c) - radius
        return 0.5 * (e * e).sum()

    numeric = np.array([(cost(k, STEP) - cost(k, -STEP)) / (2 * STEP) for k in range(24)])
    # the neck has no twist of its own, which only a head that is not round notices, and hardly
    assert np.abs(numeric + g).max() < 5e-4 * np.abs(g).max()


@pytest.mark.parametrize("seed", range(4))
def test_contour_rays_alone_bring_a_disturbed_pose_back(scene, seed):
    body, pose, rays, _ = scene
    start = disturbed(pose, np.random.default_rng(seed), 0.1, 0.03)
    before = np.linalg.norm(forward(body, start) - forward(body, pose), axis=1).mean()
    fit = fit_articulated(body, start, NO_CENTERLINE, settings=RAYS_ALONE, contour_rays=rays)
    error = np.linalg.norm(fit.reference_points_world - forward(body, pose), axis=1)
    assert before > 0.04
    # the head's twist and the pull towards its rest leave a few millimetres at the crown
    assert error.mean() < 0.008 and error.max() < 0.035


def test_contour_rays_without_weight_change_nothing(scene):
    body, pose, rays, rng = scene
    off = ContourSettings(weight=0.0)
    start, points = disturbed(pose, rng, 0.05, 0.02), forward(body, pose)
    settings = replace(RAYS_ALONE, contour=off)
    alone = fit_articulated(body, start, points, settings=settings)
    beside = fit_articulated(body, start, points, settings=settings, contour_rays=rays)
    assert np.array_equal(alone.reference_points_world, beside.reference_points_world)


def test_thinned_rays_spread_over_all_of_them(scene):
    *_, rays, _ = scene
    thin = rays.thinned(50)
    rows = [int(np.flatnonzero((rays.points_world == p).all(1))[0]) for p in thin.points_world]
    assert len(thin) == 50 and np.diff(rows).max() <= len(rays) // 50 + 1
    assert rays.thinned(10**6) is rays


def test_rays_of_another_time_touch_the_moving_body_as_it_is_at_the_stamp(scene):
    body, pose, rays, _ = scene
    velocity, later_s = np.random.default_rng(8).normal(size=24), 0.02  # m/s, rad/s
    at_stamp, late = pose.retract(-velocity * later_s), replace(rays, time_s=np.full(len(rays), later_s))

    def off_m(rays):
        return np.abs(match_rays(as_arrays(rays), placed(body, at_stamp), 0.05).distance)

    back = rays_at_stamp(late, body, at_stamp, velocity)
    assert np.median(off_m(late)) > 0.01 and np.median(off_m(back)) < 0.001
    assert np.percentile(off_m(back), 90) < 0.005 and not back.time_s.any()
    assert rays_at_stamp(rays, body, at_stamp, velocity) is rays  # of cameras in step
