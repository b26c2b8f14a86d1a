"""Angles of the ISB in postures whose angles follow from the recommendations' words."""

import numpy as np
import pytest

from capture_rig.rigid import rotation_matrix
from motion_export.isb_angles import isb_angles
from motion_export.motion import Motion, Samples
from stick_figure.body import Body
from stick_figure.kinematics import forward
from stick_figure.pose import Pose
from stick_figure.skeleton import ANGLE_NAMES, T_POSE_ANGLES

BODY = Body.from_stature(1.8)
HANGING = {"left_shoulder_x": -90.0, "right_shoulder_x": 270.0}


def angles_of(lean: np.ndarray | None = None, **degrees: float) -> dict[str, float]:
    """The angles in a posture: those of hanging arms but for the joint angles given; ``lean`` is a rotation vector."""
    angles = T_POSE_ANGLES.copy()
    for name, value in {**HANGING, **degrees}.items():
        angles[ANGLE_NAMES.index(name)] = np.deg2rad(value)
    pose = Pose.from_angles(np.zeros(3), rotation_matrix(np.zeros(3) if lean is None else lean), angles)
    pair = (2, 1, 1)
    samples = Samples(
        np.array([0, 16_666_667]),
        np.tile(forward(BODY, pose), pair),
        np.tile(np.eye(3), (2, 15, 1, 1)),
        np.tile(angles, (2, 1)),
        np.zeros((2, 3)),
        np.tile(pose.R_world_torso, pair),
        np.array(["tracking"] * 2),
    )
    return {name: float(values[0]) for name, values in isb_angles(Motion.of_samples(samples, "posture")).items()}


def test_a_person_who_stands_with_hanging_arms_has_angles_of_zero() -> None:
    angles = angles_of()
    shoulders = {name: value for name, value in angles.items() if "shoulder_p" in name or "shoulder_a" in name}
    others = {name: value for name, value in angles.items() if name not in shoulders}
    assert all(value == pytest.approx(0.0, abs=1e-6) for value in others.values()), others
    for side in ("left", "right"):  # an arm that hangs turns about one axis only: the sum of plane and rotation
        turn = shoulders[f"{side}_shoulder_plane_of_elevation"] + shoulders[f"{side}_shoulder_axial_rotation"]
        assert np.cos(np.deg2rad(turn)) == pytest.approx(1.0)


@pytest.mark.parametrize("side", ["left", "right"])
def test_an_arm_raised_sideways_is_elevated_by_90_degrees_in_the_frontal_plane(side: str) -> None:
    angles = angles_of(**({"left_shoulder_x": 0.0} if side == "left" else {"right_shoulder_x": 180.0}))
    assert angles[f"{side}_shoulder_elevation"] == pytest.approx(-90.0)
    assert angles[f"{side}_shoulder_plane_of_elevation"] == pytest.approx(0.0, abs=1e-6)


@pytest.mark.parametrize("side", ["left", "right"])
def test_an_arm_raised_forward_is_elevated_in_the_sagittal_plane(side: str) -> None:
    turn = {"left_shoulder_x": 0.0, "left_shoulder_z": -89.9}
    if side == "right":
        turn = {"right_shoulder_x": 180.0, "right_shoulder_z": -89.9}
    angles = angles_of(**turn)
    assert angles[f"{side}_shoulder_elevation"] == pytest.approx(-90.0, abs=0.2)
    assert angles[f"{side}_shoulder_plane_of_elevation"] == pytest.approx(90.0, abs=0.2)


@pytest.mark.parametrize(
    ("name", "degrees", "isb", "expected"),
    [
        ("left_elbow", -70.0, "left_elbow_flexion", 70.0),
        ("right_elbow", -70.0, "right_elbow_flexion", 70.0),
        ("left_knee", 50.0, "left_knee_flexion", 50.0),
        ("right_knee", 50.0, "right_knee_flexion", 50.0),
        ("left_hip_y", -40.0, "left_hip_flexion", 40.0),
        ("right_hip_y", -40.0, "right_hip_flexion", 40.0),
        ("left_hip_x", 20.0, "left_hip_adduction", -20.0),
        ("right_hip_x", -20.0, "right_hip_adduction", -20.0),
        ("left_hip_z", 15.0, "left_hip_internal_rotation", -15.0),
        ("right_hip_z", 15.0, "right_hip_internal_rotation", 15.0),
        ("neck_y", 25.0, "neck_flexion", 25.0),
    ],
)
def test_one_joint_turned(name: str, degrees: float, isb: str, expected: float) -> None:
    assert angles_of(**{name: degrees})[isb] == pytest.approx(expected, abs=1e-6)


def test_a_trunk_that_bends_forward_tilts_negatively_and_one_that_turns_left_rotates_positively() -> None:
    assert angles_of(np.array([0.0, np.deg2rad(30.0), 0.0]))["thorax_tilt"] == pytest.approx(-30.0)
    assert angles_of(np.array([0.0, 0.0, np.deg2rad(40.0)]))["thorax_axial_rotation"] == pytest.approx(40.0)
