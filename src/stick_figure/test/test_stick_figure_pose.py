"""The pose manifold: retract and minus, Euler angles at limits and singularities, canonical hinges, kernels."""

import numpy as np
import pytest
from poses import angles_with, random_pose
from scipy.spatial.transform import Rotation

from stick_figure.body import Body
from stick_figure.kinematics import forward
from stick_figure.pose import T_POSE_ANGLES, JointMotion, Pose
from stick_figure.skeleton import ANGLE_HIGH, ANGLE_LOW, TANGENT_NAMES

BODY = Body.from_stature(1.75)


def pose_of(angles):
    return Pose.from_angles(np.zeros(3), np.eye(3), angles)


def test_retract_of_minus_leads_from_any_pose_to_any_other():
    rng = np.random.default_rng(1)
    for _ in range(300):
        start, end = random_pose(rng), random_pose(rng)
        reached = start.retract(end.minus(start))
        for found, expected in zip(reached.arrays, end.arrays, strict=True):
            np.testing.assert_allclose(found, expected, atol=1e-12)


def test_ball_joint_increment_turns_the_limb_in_the_torso_frame():
    pose = Pose.from_angles(np.zeros(3), Rotation.from_euler("z", 0.7).as_matrix(), angles_with(left_elbow=-0.6))
    tangent = np.zeros(24)
    tangent[TANGENT_NAMES.index("left_shoulder_z")] = 0.3
    expected = pose.R_world_torso @ Rotation.from_euler("z", 0.3).as_matrix() @ pose.R_world_torso.T
    before, after = forward(BODY, pose), forward(BODY, pose.retract(tangent))
    np.testing.assert_allclose(after[11] - after[3], expected @ (before[11] - before[3]), atol=1e-14)
    np.testing.assert_allclose(after[[0, 1, 4, 12]], before[[0, 1, 4, 12]], atol=1e-15)


@pytest.mark.parametrize("limits", ["low", "high"])
@pytest.mark.parametrize("slot", range(18))
def test_angles_invert_from_angles_at_each_limit(slot, limits):
    rng = np.random.default_rng(slot)
    angles = rng.uniform(ANGLE_LOW + 0.1, ANGLE_HIGH - 0.1)
    angles[slot] = (ANGLE_LOW if limits == "low" else ANGLE_HIGH)[slot]
    found = pose_of(angles).angles(previous=angles)
    np.testing.assert_allclose(found, angles, atol=2e-8)
    assert (found >= ANGLE_LOW).all() and (found <= ANGLE_HIGH).all()


def test_angles_at_gimbal_lock_keep_the_previous_first_angle():
    angles = angles_with(left_shoulder_x=0.4, left_shoulder_z=np.pi / 2, left_shoulder_y=0.7, left_elbow=-1.0)
    pose = pose_of(angles)
    np.testing.assert_allclose(pose.angles(previous=angles), angles, atol=1e-8)
    other = pose.angles()
    np.testing.assert_allclose(forward(BODY, pose_of(other)), forward(BODY, pose), atol=1e-8)
    assert other[2] == 0.0  # the T-pose's value where nothing is known


def test_angles_at_the_cut_of_a_full_circle_follow_the_previous_side():
    for slot, low in ((2, -np.pi), (3, 0.0)):
        for end in (low, low + 2 * np.pi):
            at_the_cut, near = T_POSE_ANGLES.copy(), T_POSE_ANGLES.copy()
            at_the_cut[slot], near[slot] = end, end + (0.2 if end == low else -0.2)
            assert pose_of(at_the_cut).angles(previous=near)[slot] == pytest.approx(end)


def test_canonical_bends_hinges_the_right_way_and_keeps_all_points():
    rng = np.random.default_rng(9)
    pose = random_pose(rng)
    wrong = Pose(pose.position_world, pose.R_world_torso, pose.R_joints, np.array([0.5, 1.2, -0.4, -0.9]))
    right = wrong.canonical()
    np.testing.assert_allclose(right.hinges, [-0.5, -1.2, 0.4, 0.9])
    np.testing.assert_allclose(forward(BODY, right), forward(BODY, wrong), atol=1e-14)
    assert np.linalg.det(right.R_joints) == pytest.approx(1.0)


def test_canonical_leaves_hinges_within_the_margin():
    wrong = Pose(np.zeros(3), np.eye(3), pose_of(T_POSE_ANGLES).R_joints, np.array([0.1, 0.14, -0.1, -0.14]))
    np.testing.assert_array_equal(wrong.canonical().hinges, wrong.hinges)
    np.testing.assert_allclose(wrong.canonical(margin=0.0).hinges, -wrong.hinges)


def test_pose_refuses_wrong_shapes_and_copies_its_arrays():
    position = np.zeros(3)
    pose = Pose.from_angles(position, np.eye(3), T_POSE_ANGLES)
    position[0] = 5.0
    assert pose.position_world[0] == 0.0
    with pytest.raises(ValueError, match="R_world_torso"):
        Pose(position, np.eye(4), pose.R_joints, pose.hinges)
    with pytest.raises(ValueError, match="18"):
        Pose.from_angles(position, np.eye(3), np.zeros(16))


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_arm_that_circles_turns_on_and_on_without_a_jump(sign):
    previous = T_POSE_ANGLES
    for turned in np.linspace(0.0, sign * 4.0 * np.pi, 400):
        angles = angles_with(left_shoulder_x=turned, left_shoulder_z=0.3, left_elbow=-0.8)
        found = pose_of(angles).angles(previous)
        assert np.abs(found - previous).max() < (0.05 if turned else 1.0)
        previous = found
    np.testing.assert_allclose(previous, angles, atol=1e-9)


@pytest.mark.parametrize("straight", [0.3, -0.3])
def test_straight_elbow_keeps_its_twist_where_noise_bends_it_the_other_way(straight):
    angles = T_POSE_ANGLES.copy()
    angles[[2, 4, 6, 8]] = 0.4, 0.3, 0.2, straight
    # the filter describes an elbow that passed straight by the arm turned about itself
    pose = pose_of(angles).canonical()
    found = pose.angles(angles_with(angles, left_elbow=-0.05))
    np.testing.assert_allclose(found[[2, 4, 6, 8]], angles[[2, 4, 6, 8]], atol=1e-9)
    np.testing.assert_allclose(pose_of(found).canonical().R_joints, pose.R_joints, atol=1e-9)


# --- joint motion: quaternions ----------------------------------------------------------------------------------------


@pytest.mark.parametrize("turned_rad", [0.0, 1e-9, 0.5])
def test_quaternions_are_scipy_s_and_pose_and_velocity_come_back(turned_rad):
    rng = np.random.default_rng(6)
    R, angles = Rotation.random(random_state=rng).as_matrix(), T_POSE_ANGLES + turned_rad * rng.uniform(-1.0, 1.0, 18)
    pose, velocity = Pose.from_angles(rng.normal(size=3), R, angles), rng.normal(size=24)
    motion = JointMotion.of(pose, velocity)
    rotations = np.concatenate([pose.R_world_torso[None], pose.R_joints])
    expected = Rotation.from_matrix(rotations).as_quat()
    same = np.abs((motion.quaternions[:6] * expected).sum(axis=1))  # q and -q are one rotation
    np.testing.assert_allclose(same, 1.0, atol=1e-14)
    assert (motion.quaternions[:, 3] >= 0.0).all()
    for array, back in zip(pose.arrays, motion.pose.arrays, strict=True):
        np.testing.assert_allclose(back, array, atol=1e-14)
    np.testing.assert_array_equal(motion.velocity, velocity)
