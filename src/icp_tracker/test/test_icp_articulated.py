"""The all-joints solve: derivatives against finite differences, accuracy, soft constraints, honest covariance."""

import numpy as np
import pytest
import synthetic_people as synthetic

from icp_tracker import articulated_fit
from icp_tracker.articulated_fit import ArticulatedSettings
from stick_figure.kinematics import forward, sticks
from stick_figure.least_squares.point_factor import add_point_residuals, match_points
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


def normal_equations(body, pose, points, weight):
    """H and g of points that all count by their information: the gate is wide."""
    data = synthetic.data(points=points, information=weight, gate2=np.full(len(points), 1e12))
    placed = synthetic.placed(body, pose)
    return synthetic.equations(add_point_residuals, points, match_points(data, placed), placed)


def no_rest(monkeypatch):
    """The head has no rest and joints no limits."""
    for sd in ("NECK_SD", "LIMIT_SD"):
        monkeypatch.setattr(articulated_fit, sd, 1e9)


@pytest.fixture
def scene(body):
    rng = np.random.default_rng(8)
    pose = synthetic.smooth_motion(5, seed=3)[4]
    points = synthetic.stick_cloud(body, pose.retract(0.05 * rng.normal(size=24)), rng, 120)
    return pose, points, rng.uniform(0.5, 2.0, len(points))


def test_normal_equations_are_those_of_finite_difference_jacobians(body, scene):
    pose, points, weight = scene
    H, g = normal_equations(body, pose, points, weight)
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


def test_head_returns_to_rest_only_with_the_neck_prior(body, monkeypatch):
    truth = synthetic.t_pose()
    points = synthetic.stick_cloud(body, truth, np.random.default_rng(13), 300, 0.01)
    neck = forward(body, truth)[2]
    points = points[points[:, 2] < neck[2] - 0.02]  # nothing of the head is seen
    start = truth.retract(np.eye(24)[NECK_Y] * 1.2)

    def pitch():
        fit = synthetic.fit(body, start, points, settings=ArticulatedSettings(max_iterations=20, prior=4.0))
        assert not fit.visible[1]
        direction = fit.pose.R_joints[0, :, 2]
        return np.arctan2(direction[0], direction[2])

    assert pitch() == pytest.approx(0.1, abs=0.2)
    no_rest(monkeypatch)
    assert pitch() > 1.0


def test_covariance_of_independent_points_holds_what_it_says(body, monkeypatch):
    """Independent noise of known size, correlation factor 1: 95 % ellipsoids hold the truth 85 to 99 % of the time."""
    no_rest(monkeypatch)
    settings = ArticulatedSettings(model_sigma_m=SIGMA, correlation=1.0, prior=5.0)
    inside = []
    for seed in range(5):
        rng = np.random.default_rng(seed)
        for truth in synthetic.smooth_motion(60, seed):
            fit = synthetic.fit(body, truth, synthetic.stick_cloud(body, truth, rng, 300, SIGMA), settings=settings)
            error = fit.reference_points_world - forward(body, truth)
            inside.append(np.einsum("pi,pij,pj->p", error, np.linalg.inv(fit.covariance), error) < CHI2_95)
    share = np.mean(inside, axis=0)
    assert share.min() > 0.85
    assert share.max() <= 0.99


def test_covariance_grows_where_the_points_do_not_fit(body):
    truth = synthetic.t_pose()
    settings = ArticulatedSettings(model_sigma_m=0.01, gate_m=0.3)
    small, large = (
        synthetic.fit(
            body, truth, synthetic.stick_cloud(body, truth, np.random.default_rng(14), 300, noise), settings=settings
        )
        for noise in (0.01, 0.05)
    )
    sd = [np.sqrt(np.trace(fit.covariance, axis1=1, axis2=2)).mean() for fit in (small, large)]
    assert sd[1] > 3.5 * sd[0]


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
    assert sd[1] > 5 * sd[2]
    assert (np.linalg.eigvalsh(fit.covariance) > 0).all()
