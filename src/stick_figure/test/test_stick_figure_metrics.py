"""Error metrics of thesis 7.2, corrected."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from stick_figure import metrics
from stick_figure.body import Body
from stick_figure.kinematics import forward
from stick_figure.pose import T_POSE_ANGLES, Pose


def turning_truth(frames=40):
    body, turns = Body.from_stature(1.75), np.linspace(0, 5, frames)
    rotations = Rotation.from_rotvec(np.outer(turns, [0, 0, 1])).as_matrix()
    poses = [Pose.from_angles(np.array([t, 0, 1]), R, T_POSE_ANGLES) for t, R in zip(turns, rotations, strict=True)]
    return np.array([forward(body, pose) for pose in poses]), rotations


def test_rotation_angle_resolves_tiny_and_half_turns():
    R = Rotation.random(random_state=1)
    for angle in (0.0, 1e-12, 1e-9, 0.5, np.pi - 1e-9, np.pi):
        turned = Rotation.from_rotvec([0, angle, 0]) * R
        found = metrics.rotation_angle(turned.as_matrix(), R.as_matrix())
        assert found == pytest.approx(angle, abs=2e-15 + 1e-12 * angle)


def test_angle_errors_wrap_around_the_circle():
    estimate, truth = np.full((3, 18), np.pi - 0.01), np.full((3, 18), -np.pi + 0.01)
    np.testing.assert_allclose(metrics.rmse_angles(estimate, truth), 0.02, atol=1e-12)


def test_pelvis_rotation_follows_the_torso():
    truth, R = turning_truth()
    np.testing.assert_allclose(metrics.pelvis_rotations(truth), R, atol=1e-12)


def test_constant_joint_offset_in_the_pelvis_frame_is_removed_whole():
    truth, R = turning_truth()
    offsets = np.random.default_rng(2).normal(size=(15, 3)) * 0.05
    estimate = truth + np.einsum("fij,pj->fpi", R, offsets)
    np.testing.assert_allclose(metrics.joint_offsets(estimate, truth), offsets, atol=1e-12)
    assert metrics.point_errors(estimate, truth).mean() > 0.05
    assert metrics.point_errors(metrics.without_offsets(estimate, truth), truth).mean() < 1e-12
