"""Rotations and rigid fits against SciPy, which finds them another way."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from capture_rig.rigid import nearest_rotation, rigid_transform, rotation_matrix, rotation_vector


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
