"""Joint motion: quaternions against SciPy, and back to pose and velocity."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from capture_rig.rigid import quaternion_of
from stick_figure.pose import JointMotion, Pose
from stick_figure.skeleton import T_POSE_ANGLES


def pose_of(rng, turned_rad):
    angles = T_POSE_ANGLES + turned_rad * rng.uniform(-1.0, 1.0, 18)
    return Pose.from_angles(rng.normal(size=3), Rotation.random(random_state=rng).as_matrix(), angles)


@pytest.mark.parametrize("turned_rad", [0.0, 1e-9, 0.5])
def test_quaternions_are_scipy_s_and_pose_and_velocity_come_back(turned_rad):
    rng = np.random.default_rng(6)
    pose, velocity = pose_of(rng, turned_rad), rng.normal(size=24)
    motion = JointMotion.of(pose, velocity)
    rotations = np.concatenate([pose.R_world_torso[None], pose.R_joints])
    expected = Rotation.from_matrix(rotations).as_quat()
    same = np.abs((motion.quaternions[:6] * expected).sum(axis=1))  # q and -q are one rotation
    np.testing.assert_allclose(same, 1.0, atol=1e-14)
    assert (motion.quaternions[:, 3] >= 0.0).all()
    for array, back in zip(pose.arrays, motion.pose.arrays, strict=True):
        np.testing.assert_allclose(back, array, atol=1e-14)
    np.testing.assert_array_equal(motion.velocity, velocity)


def test_quaternion_of_no_turn_and_of_half_a_turn():
    np.testing.assert_array_equal(quaternion_of(np.eye(3)), [0.0, 0.0, 0.0, 1.0])
    x, y, z, w = quaternion_of(np.diag([-1.0, -1.0, 1.0]))
    np.testing.assert_allclose((x, y, abs(z), w), (0.0, 0.0, 1.0, 0.0), atol=1e-15)


def test_a_quaternion_of_any_length_is_a_rotation():
    rng = np.random.default_rng(7)
    pose = pose_of(rng, 0.5)
    motion = JointMotion.of(pose, np.zeros(24))
    longer = JointMotion(motion.position_world, -3.0 * motion.quaternions, motion.linear_world, motion.angular)
    np.testing.assert_allclose(longer.pose.R_joints, pose.R_joints, atol=1e-14)
