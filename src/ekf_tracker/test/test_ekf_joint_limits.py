"""Joint limits in the filter: nothing inside the ranges, and no pose that stays outside them."""

from dataclasses import replace

import numpy as np
import pytest
from ekf_person import ALL, BENT_ANGLES, IDEAL, Person, isotropic, run, stamp
from poses import pose_with
from scipy.spatial.transform import Rotation

from ekf_tracker.filter import ArticulatedEkf
from stick_figure.joint_limits import add_joint_limits
from stick_figure.kinematics import forward

MARGIN = 0.15
NO_LIMITS = replace(IDEAL, limit_sd_rad=0.0)
TIGHT = replace(IDEAL, limit_sd_rad=0.05)


def bent(**angles):
    """Elbows and knees bent, other angles by name."""
    return pose_with(BENT_ANGLES, **angles)


def excess_rad(pose):
    """Length of the residual at a pose: by how much it is out of range."""
    information, gradient = np.zeros((24, 24)), np.zeros(24)
    add_joint_limits(pose.R_joints, pose.hinges, MARGIN, 1.0, information, gradient)
    return float(np.sqrt(gradient @ np.linalg.pinv(information) @ gradient))


def follow(body, pose, settings, frames=40, sd=0.02):
    """The filter's last state after so many sets of a body that stands in this pose."""
    ekf, rng = ArticulatedEkf(body, settings), np.random.default_rng(1)
    for k in range(frames):
        points = forward(body, pose) + sd * rng.standard_normal((15, 3))
        state = ekf.step(stamp(k), points, isotropic(sd), ALL)
    return state


def test_a_person_within_the_ranges_is_estimated_to_the_same_bytes_as_without_limits(body):
    person = Person(body, speed=0.5)
    limited, _ = run(ArticulatedEkf(body, IDEAL), person, 120, noise=0.002)
    free, _ = run(ArticulatedEkf(body, NO_LIMITS), person, 120, noise=0.002)
    for a, b in zip(limited, free, strict=True):
        np.testing.assert_array_equal(a.points_world, b.points_world)


@pytest.mark.parametrize(
    "angles",
    [{"left_shoulder_y": 3 * np.pi / 4 + 0.6}, {"right_hip_z": np.pi / 3 + 0.6}, {"left_hip_x": np.pi / 2 + 0.5}],
)
def test_impossible_points_are_answered_with_a_pose_near_the_limit(body, angles):
    """Points of a limb 0.5 to 0.6 rad out of range: without limits the filter believes them."""
    pose = bent(**angles)
    assert excess_rad(follow(body, pose, NO_LIMITS).pose) > 0.4
    assert excess_rad(follow(body, pose, TIGHT).pose) < 0.25


def test_knee_that_seems_to_bend_forward_stays_near_straight_and_the_thigh_unturned(body):
    """Noise bends a straight knee 0.3 rad the wrong way: its other description, a thigh turned by pi, is impossible."""
    pose = replace(bent(), hinges=np.array([-0.9, -0.9, -0.3, 0.8]))
    limited, free = follow(body, pose, TIGHT), follow(body, pose, NO_LIMITS)
    assert excess_rad(limited.pose) < 0.1
    assert limited.pose.hinges[2] > -MARGIN - 0.1
    assert free.pose.hinges[2] > 0.2 and excess_rad(free.pose) > 1.0


def test_elbow_on_the_wrong_side_is_turned_round_where_the_shoulder_allows_it(body):
    """Upper arm started turned by pi: limits must not keep the arm there."""
    truth = bent(left_shoulder_y=2.2)
    turned = truth.R_joints.copy()
    turned[1] = turned[1] @ Rotation.from_rotvec([0.0, np.pi, 0.0]).as_matrix()
    wrong = replace(truth, R_joints=turned, hinges=truth.hinges * [0.0, 1.0, 1.0, 1.0])
    ekf = ArticulatedEkf(body, IDEAL)
    for k in range(60):
        bend = min(k / 30.0, 1.0)
        pose = replace(truth, hinges=truth.hinges * [bend, 1.0, 1.0, 1.0])
        points = forward(body, wrong if k == 0 else pose)
        state = ekf.step(stamp(k), points, isotropic(0.01), ALL)
    assert 1e3 * np.linalg.norm(state.points_world - forward(body, truth), axis=1).max() < 20.0
    assert state.pose.hinges[0] == pytest.approx(-0.9, abs=0.1)


def test_limits_leave_the_covariance_to_the_measured_points(body):
    pose = bent(left_shoulder_y=3 * np.pi / 4 + 0.6)
    limited, free = follow(body, pose, TIGHT), follow(body, pose, NO_LIMITS)
    sd = [np.sqrt(np.diag(s.covariance)[[8, 12, 10]]) for s in (limited, free)]
    np.testing.assert_allclose(sd[0], sd[1], rtol=0.5)
