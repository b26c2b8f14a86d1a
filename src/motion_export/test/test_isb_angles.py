"""Angles of the ISB in postures whose angles follow from the recommendations' words."""

from types import SimpleNamespace

import numpy as np
import pytest
from poses import angles_with

from capture_rig.rigid import rotation_matrix
from motion_export.isb_angles import isb_angles
from stick_figure.kinematics import stick_frames
from stick_figure.pose import Pose

HANGING = {"left_shoulder_x": -90.0, "right_shoulder_x": 270.0}


def angles_of(lean: np.ndarray | None = None, **degrees: float) -> dict[str, float]:
    """The angles in a posture: those of hanging arms but for the joint angles given; ``lean`` is a rotation vector."""
    angles = angles_with(**{name: np.deg2rad(value) for name, value in {**HANGING, **degrees}.items()})
    pose = Pose.from_angles(np.zeros(3), rotation_matrix(np.zeros(3) if lean is None else lean), angles)
    motion = SimpleNamespace(tracked=np.ones(2, bool), R_world_sticks=np.tile(stick_frames(pose), (2, 1, 1, 1)))
    return {name: float(values[0]) for name, values in isb_angles(motion).items()}


def test_a_person_who_stands_with_hanging_arms_has_angles_of_zero() -> None:
    angles = angles_of()
    shoulders = {name: value for name, value in angles.items() if "shoulder_p" in name or "shoulder_a" in name}
    others = {name: value for name, value in angles.items() if name not in shoulders}
    assert all(value == pytest.approx(0.0, abs=1e-6) for value in others.values()), others
    for side in ("left", "right"):  # an arm that hangs turns about one axis only: the sum of plane and rotation
        turn = shoulders[f"{side}_shoulder_plane_of_elevation"] + shoulders[f"{side}_shoulder_axial_rotation"]
        assert np.cos(np.deg2rad(turn)) == pytest.approx(1.0)


@pytest.mark.parametrize(("side", "raised_deg"), [("left", 0.0), ("right", 180.0)])
@pytest.mark.parametrize(("swing_deg", "plane_deg"), [(0.0, 0.0), (-89.9, 90.0)], ids=["sideways", "forward"])
def test_a_raised_arm_is_elevated_by_90_degrees_in_its_plane(side, raised_deg, swing_deg, plane_deg):
    angles = angles_of(**{f"{side}_shoulder_x": raised_deg, f"{side}_shoulder_z": swing_deg})
    near = 0.2 if swing_deg else 1e-6  # straight forward the plane is not defined
    assert angles[f"{side}_shoulder_elevation"] == pytest.approx(-90.0, abs=near)
    assert angles[f"{side}_shoulder_plane_of_elevation"] == pytest.approx(plane_deg, abs=near)


@pytest.mark.parametrize("side", ["left", "right"])
@pytest.mark.parametrize(
    ("joint", "left_deg", "mirrored", "isb", "expected"),
    [
        ("elbow", -70.0, 1.0, "elbow_flexion", 70.0),
        ("knee", 50.0, 1.0, "knee_flexion", 50.0),
        ("hip_y", -40.0, 1.0, "hip_flexion", 40.0),
        ("hip_x", 20.0, -1.0, "hip_adduction", -20.0),
        ("hip_z", 15.0, -1.0, "hip_internal_rotation", -15.0),
    ],
)
def test_the_same_movement_of_both_sides_has_the_same_angle(side, joint, left_deg, mirrored, isb, expected):
    degrees = left_deg * (mirrored if side == "right" else 1.0)
    assert angles_of(**{f"{side}_{joint}": degrees})[f"{side}_{isb}"] == pytest.approx(expected, abs=1e-6)


def test_signs_of_a_nod_of_a_bend_forward_and_of_a_turn_to_the_left() -> None:
    assert angles_of(np.array([0.0, np.deg2rad(30.0), 0.0]))["thorax_tilt"] == pytest.approx(-30.0)
    assert angles_of(np.array([0.0, 0.0, np.deg2rad(40.0)]))["thorax_axial_rotation"] == pytest.approx(40.0)
    assert angles_of(neck_y=25.0)["neck_flexion"] == pytest.approx(25.0)
