"""Joint centres: displacements of shoulders, hips and neck that follow the pose of the figure."""

import numpy as np
import pytest
from poses import MIRRORED_POINTS, angles_with

from capture_rig.rigid import rotation_matrix
from stick_figure import trunk_bend
from stick_figure.body import Body
from stick_figure.kinematics import forward
from stick_figure.pose import T_POSE_ANGLES, Pose
from stick_figure.skeleton import ANGLE_NAMES, POINT_NAMES, mirror_angles
from stick_figure.trunk_bend import with_joint_centres

BODY = Body.from_stature(1.75)
SIDES, ENDS = ("left", "right"), ("elbow", "hand", "knee", "foot")
FIXED = [POINT_NAMES.index(f"{side}_{joint}") for side in SIDES for joint in ENDS]
UPRIGHT = np.eye(3)


def moved_m(angles: np.ndarray, body: Body = BODY, R: np.ndarray = UPRIGHT, at=(0.3, -0.2, 1.0)) -> np.ndarray:
    """Displacements (15, 3) of the reference points, torso frame."""
    pose = Pose.from_angles(np.array(at), R, angles)
    points = forward(body, pose)
    return (with_joint_centres(body, pose, points) - points) @ R


def some_pose(seed: int) -> np.ndarray:
    random = np.random.default_rng(seed)
    return T_POSE_ANGLES + random.uniform(-0.5, 0.5, 18)


@pytest.mark.parametrize("seed", range(3))
def test_the_mirrored_pose_has_the_mirrored_centres(seed: int) -> None:
    angles = some_pose(seed)
    mirrored = moved_m(mirror_angles(angles))[MIRRORED_POINTS] * [1.0, -1.0, 1.0]
    assert mirrored == pytest.approx(moved_m(angles), abs=1e-9)
    assert np.linalg.norm(moved_m(angles)[[2, 3, 4, 5, 6]], axis=1).min() > 1e-4


def test_the_trunks_bend_is_mirrored_too() -> None:
    bent, other = BODY.bent(np.array([0.1, 0.05, 0, 0, 0, 0, 0.2])), BODY.bent(np.array([-0.1, -0.05, 0, 0, 0, 0, 0.2]))
    angles = some_pose(5)
    mirrored = moved_m(mirror_angles(angles), other)[MIRRORED_POINTS] * [1.0, -1.0, 1.0]
    assert mirrored == pytest.approx(moved_m(angles, bent), abs=1e-9)
    assert np.abs(moved_m(angles, bent) - moved_m(angles)).max() > 1e-3


def test_a_shoulder_rises_with_its_arm() -> None:
    level = T_POSE_ANGLES[ANGLE_NAMES.index("left_shoulder_x")]
    raised = [moved_m(angles_with(left_shoulder_x=level + angle)) for angle in (-1.4, 0.0, 1.4)]
    heights = [moved[POINT_NAMES.index("left_shoulder"), 2] for moved in raised]
    assert 0.01 < heights[1] - heights[0] < 0.05
    assert 0.01 < heights[2] - heights[1] < 0.05


def test_limbs_ends_stay_and_the_torso_is_between_neck_and_hips() -> None:
    moved = moved_m(some_pose(7))
    assert not moved[FIXED].any()
    assert moved[0] == pytest.approx(0.5 * moved[2] + 0.25 * (moved[5] + moved[6]))


def test_centres_turn_with_the_body_and_grow_with_it() -> None:
    angles = some_pose(9)
    turned = moved_m(angles, R=rotation_matrix(np.array([0.4, -0.9, 1.3])), at=(2.0, 1.0, 0.5))
    assert turned == pytest.approx(moved_m(angles), abs=1e-9)
    assert moved_m(angles, Body.from_stature(1.4)) == pytest.approx(0.8 * moved_m(angles), abs=1e-9)


def test_a_table_of_other_columns_is_refused(tmp_path, monkeypatch) -> None:
    other = tmp_path / "joint_centres.csv"
    other.write_text(trunk_bend.TABLE.read_text().replace("pelvis_yaw", "pelvis_tilt"))
    monkeypatch.setattr(trunk_bend, "TABLE", other)
    trunk_bend.joint_centres.cache_clear()
    with pytest.raises(ValueError, match="columns"):
        trunk_bend.joint_centres()
    trunk_bend.joint_centres.cache_clear()
