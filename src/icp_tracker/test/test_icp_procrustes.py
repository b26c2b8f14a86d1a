"""Weighted Procrustes against a numerical minimiser, the SVD, and geometry."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from icp_tracker.thesis.procrustes import (
    swing_rotation,
    weighted_extended_procrustes,
    weighted_procrustes_about,
    weighted_swing_about,
)


def extended(a, b, w):
    R, t = np.empty((3, 3)), np.empty(3)
    angle = weighted_extended_procrustes(a, b, w, R, t)
    return R, t, angle


def about(joint, a, b, w):
    R = np.empty((3, 3))
    weighted_procrustes_about(joint, a, b, w, R)
    return R


def svd_rotation(S):
    """The thesis's eq. 4.8-4.9 in row convention, with the determinant against reflections."""
    U, _, Vt = np.linalg.svd(S)
    return Vt.T @ np.diag([1.0, 1.0, np.linalg.det(Vt.T @ U.T)]) @ U.T


def noisy_pair(rng, n=20, noise=0.05, flatness=1.0):
    a = rng.normal(size=(n, 3)) * [1.0, 0.7, 0.4 * flatness]
    R = Rotation.from_rotvec(rng.normal(size=3)).as_matrix()
    b = a @ R.T + rng.normal(size=3) + noise * rng.normal(size=(n, 3))
    return a, b, rng.uniform(0.1, 3.0, n)


@pytest.mark.parametrize("flatness", [1.0, 0.0])
@pytest.mark.parametrize("seed", range(10))
def test_rotation_equals_svd_with_determinant_repair(seed, flatness):
    """Of noisy points in a plane the plain SVD gives a reflection as often as not."""
    a, b, w = noisy_pair(np.random.default_rng(100 + seed), n=6, noise=0.1, flatness=flatness)
    R, t, angle = extended(a, b, w)
    ca, cb = w @ a / w.sum(), w @ b / w.sum()
    expected = svd_rotation((a - ca).T @ ((b - cb) * w[:, None]))
    assert np.abs(R - expected).max() < 1e-11
    assert np.abs(t - (cb - expected @ ca)).max() < 1e-11
    assert angle == pytest.approx(Rotation.from_matrix(expected).magnitude(), abs=1e-7)


def test_zero_weights_leave_the_model_where_it_is():
    R, t, angle = extended(np.ones((3, 3)), np.zeros((3, 3)), np.zeros(3))
    assert np.array_equal(R, np.eye(3))
    assert np.array_equal(t, np.zeros(3))
    assert angle == 0.0


@pytest.mark.parametrize("turn", [None, np.pi * np.array([0.6, 0.0, 0.8])], ids=["any", "half"])
@pytest.mark.parametrize("seed", range(6))
def test_rotation_about_a_joint_equals_svd_of_the_moment_about_it(seed, turn):
    rng = np.random.default_rng(seed)
    joint = rng.normal(size=3)
    a, b, w = noisy_pair(rng)
    b += joint - b.mean(0) + 0.1 * rng.normal(size=3)
    if turn is not None:
        b = joint + (a - joint) @ Rotation.from_rotvec(turn).as_matrix().T
    expected = svd_rotation((a - joint).T @ ((b - joint) * w[:, None]))
    assert np.abs(about(joint, a, b, w) - expected).max() < 1e-11


def test_lone_stick_swings_without_twist():
    rng = np.random.default_rng(7)
    joint, direction = np.array([0.1, 0.2, 0.3]), np.array([0.0, 0.0, 1.0])
    target = np.array([0.6, 0.0, 0.8])
    along = rng.uniform(0.05, 0.4, 30)
    a, b = joint + along[:, None] * direction, joint + along[:, None] * target
    R = np.empty((3, 3))
    angle = weighted_swing_about(joint, direction, a, b, np.ones(30), R)
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
    angle = swing_rotation(direction, -2.0 * direction, R)
    assert angle == pytest.approx(np.pi)
    assert np.abs(R @ direction + direction).max() < 1e-12
    assert np.linalg.det(R) == pytest.approx(1.0)
