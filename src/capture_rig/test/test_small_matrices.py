"""Rotations and rigid fits against SciPy, small positive definite matrices against LAPACK."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from capture_rig.rigid import nearest_rotation, rigid_transform, rotation_matrix, rotation_vector
from capture_rig.small_matrices import diagonalise, inverse3, inverse_positive, positive3, solve_positive


@pytest.mark.parametrize("angle", [0.0, 1e-12, 1e-7, 0.1, 2.0, np.pi - 1e-7, np.pi - 1e-12, np.pi])
def test_rotation_vectors_and_matrices_are_scipy_s_and_inverse_up_to_half_a_turn(angle):
    for axis in Rotation.random(5, np.random.default_rng(2)).as_matrix()[:, 0]:
        R = rotation_matrix(angle * axis)
        np.testing.assert_allclose(R, Rotation.from_rotvec(angle * axis).as_matrix(), atol=1e-15)
        np.testing.assert_allclose(rotation_matrix(rotation_vector(R)), R, atol=1e-14)
        assert np.linalg.norm(rotation_vector(R)) == pytest.approx(angle, abs=1e-12)


def test_nearest_rotation_is_never_a_reflection():
    np.testing.assert_allclose(np.linalg.det(nearest_rotation(np.diag([1.0, 1.0, -0.2]))), 1.0)


def test_nearest_rotation_is_the_polar_factor_also_of_a_singular_matrix():
    rng = np.random.default_rng(5)
    for R in Rotation.random(20, rng).as_matrix():
        axes = Rotation.random(random_state=rng).as_matrix()
        flat = R @ axes @ np.diag([2.0, 0.5, 0.0]) @ axes.T  # as of points in a plane
        np.testing.assert_allclose(nearest_rotation(flat), R, atol=1e-14)


def test_nearest_rotations_of_a_stack_are_those_of_its_matrices_and_leave_rotations_alone():
    rng = np.random.default_rng(0)
    exact = Rotation.random(20, rng).as_matrix()
    disturbed = exact + 0.05 * rng.normal(size=exact.shape)
    np.testing.assert_allclose(nearest_rotation(exact), exact, atol=1e-12)
    np.testing.assert_allclose(nearest_rotation(disturbed), [nearest_rotation(M) for M in disturbed], atol=1e-15)
    assert (np.linalg.norm(nearest_rotation(disturbed) - disturbed) <= np.linalg.norm(exact - disturbed)).all()


def test_rigid_transform_moves_points_as_scipy_does():
    rng = np.random.default_rng(1)
    for R in Rotation.random(4, rng).as_matrix():
        source = rng.normal(size=(7, 3))
        target = source @ R.T + rng.normal(size=3) + 0.01 * rng.normal(size=source.shape)
        found, shift = rigid_transform(source, target)
        expected, _ = Rotation.align_vectors(target - target.mean(0), source - source.mean(0))
        np.testing.assert_allclose(found, expected.as_matrix(), atol=1e-9)
        np.testing.assert_allclose(shift, target.mean(0) - found @ source.mean(0), atol=1e-12)


# --- positive definite matrices ---------------------------------------------------------------------------------------


def positive_matrix(n, rng):
    M = rng.normal(size=(n, n + 6))
    return M @ M.T


@pytest.mark.parametrize("n", [3, 10, 24])
def test_solution_and_inverse_equal_those_of_lapack(n):
    rng = np.random.default_rng(9)
    M, b = positive_matrix(n, rng), rng.normal(size=n)
    x = np.empty(n)
    assert solve_positive(M, b, np.empty((n, n)), x)
    inverse = inverse_positive(M)
    assert np.abs(x - np.linalg.solve(M, b)).max() < 1e-9 * np.abs(x).max()
    assert np.abs(inverse - np.linalg.inv(M)).max() < 1e-9 * np.abs(inverse).max()
    assert np.array_equal(inverse, inverse.T)
    S, by_cofactors = np.ascontiguousarray(M[:3, :3]), np.empty((3, 3))
    inverse3(S, by_cofactors)
    assert positive3(S)
    np.testing.assert_allclose(by_cofactors, np.linalg.inv(S), rtol=1e-9)


def test_a_matrix_may_be_overwritten_by_its_factor_and_only_its_lower_triangle_is_read():
    rng = np.random.default_rng(3)
    M, b, x = positive_matrix(10, rng), rng.normal(size=10), np.empty(10)
    work = np.tril(M)
    assert solve_positive(work, b, work, x)
    np.testing.assert_allclose(x, np.linalg.solve(M, b), rtol=1e-9)


@pytest.mark.parametrize("spoilt", [-1.0, 0.0, np.nan])
def test_a_matrix_that_is_not_positive_definite_is_refused(spoilt):
    S = np.eye(24)
    S[7, 7] = spoilt
    with pytest.raises(ValueError, match="not positive definite"):
        inverse_positive(S)
    assert not solve_positive(S, np.ones(24), np.empty((24, 24)), np.empty(24))
    assert not positive3(np.ascontiguousarray(S[6:9, 6:9]))


@pytest.mark.parametrize(
    "eigenvalues", [(4.0, 1.0, -2.0, 0.5), (3.0, 3.0, -1.0, -1.0), (1e6, 1.0, 1e-3, 0.0), (0.0,) * 4]
)
def test_eigenvectors_span_the_matrix_again(eigenvalues):
    axes = np.linalg.qr(np.random.default_rng(4).normal(size=(4, 4)))[0]
    S = axes @ np.diag(eigenvalues) @ axes.T
    D, V = 0.5 * (S + S.T), np.empty((4, 4))
    diagonalise(D, V)
    np.testing.assert_allclose(np.sort(np.diag(D)), np.sort(eigenvalues), atol=1e-14 * np.abs(S).max())
    np.testing.assert_allclose(V.T @ V, np.eye(4), atol=1e-14)
    np.testing.assert_allclose(V @ np.diag(np.diag(D)) @ V.T, S, atol=1e-14 * np.abs(S).max())
