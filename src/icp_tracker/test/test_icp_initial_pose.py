"""First poses from a file and from a reference."""

import numpy as np
import pytest
import synthetic_people as synthetic
import yaml
from pose_file import save_initial_pose

from capture_rig.errors import InputError
from icp_tracker.initialization.initial_pose import load_initial_pose, pose_from_reference
from stick_figure.kinematics import forward
from stick_figure.skeleton import ANGLE_NAMES, T_POSE_ANGLES

# --- file ------------------------------------------------------------------------------------------------------------


def test_saved_pose_and_body_are_read_back(tmp_path, body):
    pose = synthetic.smooth_motion(3, seed=1)[2]
    save_initial_pose(pose, tmp_path / "start.yaml", body)
    loaded, loaded_body = load_initial_pose(tmp_path / "start.yaml")
    assert np.abs(forward(loaded_body, loaded) - forward(body, pose)).max() < 1e-12
    assert np.abs(loaded_body.lengths - body.lengths).max() < 1e-15


def test_pose_file_needs_only_a_position(tmp_path):
    path = tmp_path / "start.yaml"
    path.write_text("torso_position: [1, 2, 3]\nheading: 1.5\nangles: {left_elbow: -0.5}\n")
    pose, body = load_initial_pose(path)
    assert body is None
    assert np.allclose(pose.position_world, [1, 2, 3])
    assert np.allclose(pose.R_world_torso[:, 0], [np.cos(1.5), np.sin(1.5), 0])
    expected = np.array(T_POSE_ANGLES)
    expected[ANGLE_NAMES.index("left_elbow")] = -0.5
    assert np.allclose(pose.angles(), expected)


@pytest.mark.parametrize(
    ("document", "words"),
    [
        ({"heading": 0.0}, ["torso_position"]),
        ({"torso_position": [0, 0]}, ["torso_position", "[0, 0]"]),
        ({"torso_position": [0, 0, float("nan")]}, ["torso_position", "nan"]),
        ({"torso_position": [0, 0, 1], "head": 2}, ["'head'", "heading"]),
        ({"torso_position": [0, 0, 1], "heading": "north"}, ["heading", "north"]),
        ({"torso_position": [0, 0, 1], "heading": 0.0, "torso_rotation": [0, 0, 0]}, ["heading", "torso_rotation"]),
        ({"torso_position": [0, 0, 1], "angles": {"left_elbw": 1.0}}, ["left_elbw", "left_elbow"]),
        ({"torso_position": [0, 0, 1], "angles": [1, 2]}, ["angles", "[1, 2]"]),
        ({"torso_position": [0, 0, 1], "body": "nobody.yaml"}, ["nobody.yaml"]),
        (["torso_position"], ["mapping"]),
    ],
)
def test_bad_pose_file_names_file_and_key(tmp_path, document, words):
    path = tmp_path / "start.yaml"
    path.write_text(yaml.safe_dump(document))
    with pytest.raises(InputError) as error:
        load_initial_pose(path)
    for word in [*words, str(tmp_path)]:
        assert word in str(error.value)


# --- reference of a session ------------------------------------------------------------------------------------------


@pytest.fixture
def reference(body):
    poses = synthetic.smooth_motion(40, seed=2)
    return np.arange(100, 140), np.array([forward(body, pose) for pose in poses]), poses


def test_pose_of_a_reference_frame_has_its_points(body, reference):
    frames, points, poses = reference
    known = pose_from_reference(frames, points, 117, "truth.csv")
    assert np.abs(known.body.lengths - body.lengths).max() < 1e-9
    assert np.abs(forward(known.body, known.pose) - points[17]).max() < 1e-6
    assert np.abs(known.pose.minus(poses[17])).max() < 1e-5


def test_unknown_point_is_refused_by_name(reference):
    frames, points, _ = reference
    holes = points.copy()
    holes[17, 11] = np.nan
    with pytest.raises(InputError, match=r"truth\.csv.*left_hand.*117"):
        pose_from_reference(frames, holes, 117, "truth.csv")


def test_frame_outside_the_reference_is_refused_with_its_range(reference):
    frames, points, _ = reference
    with pytest.raises(InputError, match=r"no frame 5\..*100 to 139"):
        pose_from_reference(frames, points, 5, "truth.csv")
