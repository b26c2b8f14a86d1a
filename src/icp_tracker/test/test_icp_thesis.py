"""The hierarchical articulated ICP of thesis 4.3, and its weighted Procrustes against the SVD and geometry."""

import numpy as np
import pytest
import synthetic_people as synthetic
from scipy.spatial.transform import Rotation

from icp_tracker.thesis import procrustes
from icp_tracker.thesis.hierarchical_icp import fit_hierarchical, weight_points, x84_keep
from stick_figure.kinematics import forward


def errors_mm(body, pose, truth):
    return 1e3 * np.linalg.norm(forward(body, pose) - forward(body, truth), axis=1)


@pytest.mark.parametrize("seed", range(2))
def test_noiseless_sticks_are_found_from_a_fifth_of_a_radian_and_five_centimetres(body, seed):
    """The figure starts turned by 0.2 rad in every joint's own random direction and shifted by 5 cm."""
    rng = np.random.default_rng(seed)
    truth = synthetic.smooth_motion(40, seed)[30]
    points = synthetic.stick_cloud(body, truth, rng, 400, 0.0)
    tangent = np.zeros(24)
    for part in (slice(0, 3), slice(3, 6)):
        direction = rng.normal(size=3)
        tangent[part] = direction / np.linalg.norm(direction)
    tangent[:3] *= 0.05
    tangent[3:6] *= 0.2
    tangent[6:] = 0.2 * rng.choice([-1, 1], 18) / np.sqrt(3)
    start = truth.retract(tangent)
    assert errors_mm(body, start, truth).max() > 80
    pose = start
    for _ in range(10):
        pose = fit_hierarchical(body, pose, points)[0]
    assert errors_mm(body, pose, truth).mean() < 12.0  # descendants pull along


def weights(j, stick, squared, epsilon=0.2):
    stick, squared = np.array(stick), np.array(squared, float)
    keep, weight = np.empty(len(stick), bool), np.empty(len(stick))
    match = (stick, np.full(len(stick), 0.5), np.zeros((len(stick), 3)), squared)
    return weight_points(j, match, epsilon, keep, weight), weight


def test_own_points_weigh_one_descendants_epsilon_others_nothing_and_outliers_are_judged_apart():
    squared = np.r_[np.full(20, 0.01**2), 0.3**2, np.full(20, 0.2**2), 0.9**2, 0.0, 0.0, 0.0]
    stick = np.r_[np.full(21, 2), np.full(21, 6), 0, 3, 7]  # the joint's own, of the forearm below, and of others
    own, weight = weights(2, stick, squared)
    assert own == 21
    assert weight[20] == 0 and weight[41] == 0
    assert (weight[:20] == 1).all() and (weight[21:41] == 0.2).all() and not weight[42:].any()


def test_stick_with_two_points_stays_where_its_parent_carries_it(body):
    truth = synthetic.t_pose()
    points = synthetic.stick_cloud(body, truth, np.random.default_rng(2), 300, 0.002)
    head_tip = forward(body, truth)[1]
    points = points[points[:, 2] < forward(body, truth)[2, 2] - 0.02]
    points = np.vstack([points, head_tip + np.array([[0.1, 0, 0], [0.1, 0.01, 0]])])
    pose = fit_hierarchical(body, truth, points)[0]
    assert np.linalg.norm(forward(body, pose)[1] - head_tip) < 0.02


def test_points_far_from_every_stick_do_not_pull(body):
    truth = synthetic.t_pose()
    rng = np.random.default_rng(3)
    points = synthetic.stick_cloud(body, truth, rng, 300, 0.01)
    stray = forward(body, truth)[11] + [0.0, 0.5, 0.8] + 0.02 * rng.normal(size=(8, 3))
    clean = fit_hierarchical(body, truth, points)[0]
    pose = fit_hierarchical(body, truth, np.vstack([points, stray]))[0]
    assert np.linalg.norm(forward(body, pose) - forward(body, clean), axis=1).max() < 0.01


def keep(distances, group, floor=0.005, groups=2):
    kept = np.empty(len(distances), bool)
    count = x84_keep(np.asarray(distances, float), np.asarray(group), groups, floor, kept)
    assert count == kept.sum()
    return kept


def test_x84_rejects_nothing_of_a_perfect_set():
    assert keep(np.zeros(50), np.zeros(50, int)).all()
    nearly = np.r_[np.zeros(30), np.full(20, 1e-6)]  # MAD = 0: without the floor 40 % would go
    assert keep(nearly, np.zeros(50, int)).all()
    assert not keep(nearly, np.zeros(50, int), floor=0.0).all()


# --- weighted Procrustes ----------------------------------------------------------------------------------------------


@pytest.mark.parametrize("flatness", [1.0, 0.0], ids=["solid", "flat"])
@pytest.mark.parametrize("seed", range(6))
def test_weighted_rotations_equal_the_svd_with_determinant_repair(seed, flatness):
    """Thesis eq. 4.8-4.9 in row convention; of points in a plane the plain SVD gives a reflection half of the time."""
    rng, R, t = np.random.default_rng(100 + seed), np.empty((3, 3)), np.empty(3)
    a, w = rng.normal(size=(6, 3)) * [1.0, 0.7, 0.4 * flatness], rng.uniform(0.1, 3.0, 6)
    b = a @ Rotation.from_rotvec(rng.normal(size=3)).as_matrix().T + rng.normal(size=3) + 0.1 * rng.normal(size=a.shape)

    def svd_rotation(centre_a, centre_b):
        U, _, Vt = np.linalg.svd((a - centre_a).T @ ((b - centre_b) * w[:, None]))
        return Vt.T @ np.diag([1.0, 1.0, np.linalg.det(Vt.T @ U.T)]) @ U.T

    ca, cb, joint = w @ a / w.sum(), w @ b / w.sum(), rng.normal(size=3)
    expected, about = svd_rotation(ca, cb), np.empty((3, 3))
    angle = procrustes.weighted_extended_procrustes(a, b, w, R, t)
    assert np.abs(R - expected).max() < 1e-11 and np.abs(t - (cb - expected @ ca)).max() < 1e-11
    assert angle == pytest.approx(Rotation.from_matrix(expected).magnitude(), abs=1e-7)
    procrustes.weighted_procrustes_about(joint, a, b, w, about)
    assert np.abs(about - svd_rotation(joint, joint)).max() < 1e-11


def test_zero_weights_leave_the_model_where_it_is():
    R, t = np.empty((3, 3)), np.empty(3)
    assert procrustes.weighted_extended_procrustes(np.ones((3, 3)), np.zeros((3, 3)), np.zeros(3), R, t) == 0.0
    assert np.array_equal(R, np.eye(3)) and not t.any()


def test_lone_stick_swings_without_twist():
    rng = np.random.default_rng(7)
    joint, direction = np.array([0.1, 0.2, 0.3]), np.array([0.0, 0.0, 1.0])
    target = np.array([0.6, 0.0, 0.8])
    along = rng.uniform(0.05, 0.4, 30)
    a, b = joint + along[:, None] * direction, joint + along[:, None] * target
    R = np.empty((3, 3))
    angle = procrustes.weighted_swing_about(joint, direction, a, b, np.ones(30), R)
    rotation = Rotation.from_matrix(R).as_rotvec()
    assert np.abs(R @ direction - target).max() < 1e-12
    assert angle == pytest.approx(np.arctan2(0.6, 0.8), abs=1e-12)
    assert abs(rotation @ direction) < 1e-12  # the axis is across the stick: no twist
    # the Procrustes problem of the same points is rank one: its twist is arbitrary
    S = (a - joint).T @ (b - joint)
    assert np.linalg.svd(S, compute_uv=False)[1] < 1e-12


@pytest.mark.parametrize("direction", np.vstack([np.eye(3), [[1.0, 2.0, -3.0]]]))
def test_swing_to_the_opposite_direction_is_a_half_turn(direction):
    R = np.empty((3, 3))
    angle = procrustes.swing_rotation(direction, -2.0 * direction, R)
    assert angle == pytest.approx(np.pi)
    assert np.abs(R @ direction + direction).max() < 1e-12
    assert np.linalg.det(R) == pytest.approx(1.0)
