"""Joint limits: nothing inside the ranges, and residuals whose derivatives are those of the angles themselves."""

import numpy as np
import pytest
from poses import angles_with, pose_with

from stick_figure import joint_limits
from stick_figure.kernels import HINGE_SLOT
from stick_figure.pose import T_POSE_ANGLES
from stick_figure.skeleton import ANGLE_HIGH, ANGLE_LOW, ANGLE_NAMES, HINGE_ANGLES

MARGIN, STEP = 0.15, 1e-6

BENT = T_POSE_ANGLES.copy()
BENT[HINGE_ANGLES] = -0.9, -0.9, 0.8, 0.8


def limits_of(pose, margin=MARGIN):
    """Number of angles out of range, and the residuals' information and gradient for unit weight."""
    information, gradient = np.zeros((24, 24)), np.zeros(24)
    count = joint_limits.add_joint_limits(pose.R_joints, pose.hinges, margin, 1.0, information, gradient)
    return count, information, gradient


def bent(**angles):
    """Elbows and knees bent, other angles by name."""
    return pose_with(BENT, **angles)


def test_no_pose_within_the_ranges_meets_a_limit():
    rng, inside = np.random.default_rng(0), 1e-6
    for _ in range(500):
        angles = rng.uniform(ANGLE_LOW + inside, ANGLE_HIGH - inside)
        angles[HINGE_ANGLES] = np.clip(
            angles[HINGE_ANGLES], -joint_limits.LARGEST_FLEXION, joint_limits.LARGEST_FLEXION
        )
        assert limits_of(pose_with(angles))[0] == 0


@pytest.mark.parametrize(
    ("name", "value", "excess"),
    [
        ("left_shoulder_y", 3 * np.pi / 4 + 0.4, 0.4),
        ("left_shoulder_y", -np.pi / 2 - 0.3, -0.3),
        ("right_shoulder_y", np.pi / 2 + 0.3, 0.3),
        ("left_hip_x", np.pi / 2 + 0.2, 0.2),
        ("right_hip_x", -np.pi / 2 - 0.2, -0.2),
        ("left_hip_y", np.pi / 2 + 0.25, 0.25),
        ("right_hip_z", np.pi / 3 + 0.5, 0.5),
        ("left_hip_z", -np.pi / 3 - 0.5, -0.5),
        ("neck_x", np.pi / 2 + 0.2, 0.2),
        ("left_elbow", -2.9, -0.3),
        ("right_knee", 2.8, 0.2),
    ],
)
def test_residual_is_the_part_beyond_the_range_and_its_row_the_angles_derivative(name, value, excess):
    """Against finite differences of the angle itself along every tangent slot."""
    gentle = {"left_hip_y": -0.3, "right_hip_y": -0.3, "left_shoulder_z": 0.2, "right_shoulder_z": 0.2, "neck_y": 0.3}
    pose = bent(**(gentle | {name: value}))
    count, information, gradient = limits_of(pose)
    assert count == 1
    variances, axes = np.linalg.eigh(information)
    row = axes[:, -1] * np.sqrt(variances[-1])
    residual = -gradient @ row / (row @ row)
    assert abs(residual) == pytest.approx(abs(excess), abs=1e-6)
    row *= np.sign(residual * excess)
    slot, reference = ANGLE_NAMES.index(name), angles_with(BENT, **(gentle | {name: value}))
    ahead, behind = (
        np.array([pose.retract(sign * STEP * e).angles(reference)[slot] for e in np.eye(24)]) for sign in (1, -1)
    )
    np.testing.assert_allclose(row, (ahead - behind) / (2 * STEP), atol=1e-5)


@pytest.mark.parametrize(
    ("hinge", "before", "after", "stops_at"),
    [
        (0, -0.2, 0.3, 0.0),  # an elbow that is stretched too far
        (3, 0.2, -0.3, 0.0),  # a knee
        (3, -0.1, -0.3, -0.1),  # one that was past straight goes no farther,
        (3, -0.1, 0.3, None),  # but back
        (1, -0.2, -0.3, None),
    ],
)
def test_hinges_stop_where_they_come_straight(hinge, before, after, stops_at):
    first, hinges, velocity = np.zeros(4), np.zeros(4), np.ones(24)
    first[hinge], hinges[hinge] = before, after
    joint_limits.stop_at_straight(first, hinges, velocity)
    expected = np.ones(24)
    if stops_at is not None:
        expected[HINGE_SLOT[hinge]] = 0.0
    assert hinges[hinge] == (after if stops_at is None else stops_at)
    np.testing.assert_array_equal(velocity, expected)
