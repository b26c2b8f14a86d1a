"""Forward and inverse kinematics and Jacobians against an oracle written from thesis Tables 5.2 and 5.3."""

import numpy as np
import pytest
from poses import MIRRORED_POINTS, angles_with
from scipy.spatial.transform import Rotation

from capture_rig.errors import InputError
from stick_figure.body import Body
from stick_figure.kinematics import forward, inverse, rates_of_angles
from stick_figure.pose import Pose
from stick_figure.skeleton import ANGLE_HIGH, ANGLE_LOW, ANGLE_NAMES, POINT_NAMES, mirror_angles

BODY = Body(
    np.array([0.27, 0.12, 0.15, 0.16, 0.21, 0.2, 0.22, 0.23, 0.2, 0.19]), 0.18, 0.7, 0.55
)  # left and right differ on purpose


def random_pose(rng, margin=0.0):
    angles = rng.uniform(ANGLE_LOW + margin, ANGLE_HIGH - margin)
    return Pose.from_angles(rng.normal(size=3), Rotation.random(random_state=rng).as_matrix(), angles), angles


def oracle_points(body, t0, R0, angles):
    """Thesis Table 5.2 as products of plain matrices, hips with their third angle."""

    def R(axis, name):
        return Rotation.from_euler(axis, angles[ANGLE_NAMES.index(name)]).as_matrix()

    half = body.half_lengths
    h, w, d_s, d_H = half[0], body.half_shoulder_width, body.shoulder_height_ratio, body.hip_width_ratio
    p = {"torso": np.zeros(3), "neck": np.array([0, 0, h])}
    p["head"] = p["neck"] + R("x", "neck_x") @ R("y", "neck_y") @ [0, 0, 2 * half[1]]
    for side, sign, k in (("left", 1, 0), ("right", -1, 1)):
        shoulder = p[f"{side}_shoulder"] = np.array([0, sign * w, d_s * h])
        upper = R("x", f"{side}_shoulder_x") @ R("z", f"{side}_shoulder_z") @ R("y", f"{side}_shoulder_y")
        elbow = p[f"{side}_elbow"] = shoulder + upper @ [0, 2 * half[2 + k], 0]
        p[f"{side}_hand"] = elbow + upper @ R("z", f"{side}_elbow") @ [0, 2 * half[6 + k], 0]
        hip = p[f"{side}_hip"] = np.array([0, sign * d_H * w, -h])
        thigh = R("x", f"{side}_hip_x") @ R("y", f"{side}_hip_y") @ R("z", f"{side}_hip_z")
        knee = p[f"{side}_knee"] = hip + thigh @ [0, 0, -2 * half[4 + k]]
        p[f"{side}_foot"] = knee + thigh @ R("y", f"{side}_knee") @ [0, 0, -2 * half[8 + k]]
    return np.array([R0 @ p[name] + t0 for name in POINT_NAMES])


def test_forward_equals_table_of_rotation_products_for_random_poses():
    rng = np.random.default_rng(1)
    for _ in range(500):
        pose, angles = random_pose(rng)
        expected = oracle_points(BODY, pose.position_world, pose.R_world_torso, angles)
        np.testing.assert_allclose(forward(BODY, pose), expected, atol=1e-13)


def test_inverse_returns_points_and_angles_of_random_poses():
    rng = np.random.default_rng(3)
    worst_point = worst_angle = 0.0
    for _ in range(2_000):
        pose, angles = random_pose(rng, margin=1e-3)
        points = forward(BODY, pose)
        found = inverse(BODY, points)
        worst_point = max(worst_point, np.abs(forward(BODY, found) - points).max())
        worst_angle = max(worst_angle, np.abs(found.angles() - angles).max())
    assert worst_point < 1e-13 and worst_angle < 1e-10  # m, rad


def test_inverse_keeps_limb_directions_when_the_body_has_other_lengths():
    pose, angles = random_pose(np.random.default_rng(4), margin=1e-2)
    points = oracle_points(BODY, pose.position_world, pose.R_world_torso, angles)
    longer = Body(BODY.half_lengths * np.r_[1.0, np.full(9, 1.1)], 0.18, 0.7, 0.55)
    np.testing.assert_allclose(inverse(longer, points).angles(), angles, atol=1e-10)


@pytest.mark.parametrize(
    ("straight", "twist", "value"),
    [
        ("left_elbow", "left_shoulder_y", 0.4),
        ("right_elbow", "right_shoulder_y", -0.5),
        ("left_knee", "left_hip_z", 0.3),
        ("right_knee", "right_hip_z", -0.2),
    ],
)
def test_inverse_of_straight_limb_keeps_previous_twist(straight, twist, value):
    limbs = {"hip_y": -2.0, "elbow": -0.5, "knee": 0.5}  # thighs above the horizontal
    bent = angles_with(**{f"{side}_{name}": angle for side in ("left", "right") for name, angle in limbs.items()})
    angles = angles_with(bent, **{straight: 0.0, twist: value})
    pose = Pose.from_angles(np.zeros(3), np.eye(3), angles)
    found = inverse(BODY, forward(BODY, pose), previous=pose).angles(angles)
    np.testing.assert_allclose(found, angles, atol=1e-9)
    assert inverse(BODY, forward(BODY, pose)).angles()[ANGLE_NAMES.index(twist)] == pytest.approx(0.0, abs=1e-9)


def test_inverse_refuses_bad_points_and_names_them():
    points = forward(BODY, random_pose(np.random.default_rng(5))[0])
    broken = points.copy()
    broken[8] = np.nan
    with pytest.raises(InputError, match="right_elbow"):
        inverse(BODY, broken)
    broken = points.copy()
    broken[9] = broken[5]
    with pytest.raises(InputError, match=r"left_hip and left_knee.*same place"):
        inverse(BODY, broken)
    with pytest.raises(InputError, match="14, 3"):
        inverse(BODY, points[:14])


def test_angle_rates_match_differences_of_angles_away_from_gimbal_lock():
    rng = np.random.default_rng(9)
    for _ in range(50):
        angles = rng.uniform(ANGLE_LOW, ANGLE_HIGH)
        middle = [1, 4, 5, 12, 13]
        angles[middle] = rng.uniform(-1.2, 1.2, 5)
        pose = Pose.from_angles(np.zeros(3), np.eye(3), angles)
        velocity, step = rng.normal(size=24), 1e-6
        ahead, behind = pose.retract(velocity * step).angles(angles), pose.retract(-velocity * step).angles(angles)
        difference = (ahead - behind + np.pi) % (2 * np.pi) - np.pi
        # a full circle's end may be crossed, and limits are passed by a step at most
        np.testing.assert_allclose(rates_of_angles(pose.hinges, velocity, angles), difference / (2 * step), atol=2e-5)


def test_mirror_map_reflects_the_points():
    body = Body.from_stature(1.7)

    rng = np.random.default_rng(10)
    for _ in range(100):
        angles = rng.uniform(ANGLE_LOW, ANGLE_HIGH)
        points = forward(body, Pose.from_angles(np.zeros(3), np.eye(3), angles))
        mirrored = forward(body, Pose.from_angles(np.zeros(3), np.eye(3), mirror_angles(angles)))
        np.testing.assert_allclose(mirrored[MIRRORED_POINTS] * [1, -1, 1], points, atol=1e-14)
        assert (mirror_angles(angles) >= ANGLE_LOW - 1e-12).all()
        assert (mirror_angles(angles) <= ANGLE_HIGH + 1e-12).all()
