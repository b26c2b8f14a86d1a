"""First poses: from a file, from a reference, and from a T-pose in the hull."""

import numpy as np
import pytest
import yaml

from capture_rig.errors import InputError
from icp_tracker.initial_pose import load_initial_pose, pose_from_reference, save_initial_pose
from icp_tracker.t_pose import TPoseSettings, TPoseSource, body_of, measure_t_pose, pose_of
from stick_figure.body import Body
from stick_figure.kinematics import forward
from stick_figure.pose import Pose
from stick_figure.skeleton import ANGLE_NAMES, T_POSE_ANGLES


def degrees_between(R, S):
    return np.degrees(np.arccos(np.clip((np.trace(R.T @ S) - 1) / 2, -1, 1)))


def bent(pose, **angles):
    values = pose.angles()
    for name, value in angles.items():
        values[ANGLE_NAMES.index(name)] = value
    return Pose.from_angles(pose.position_world, pose.R_world_torso, values)


# --- file ------------------------------------------------------------------------------------------------------------


def test_saved_pose_and_body_are_read_back(tmp_path, body, synthetic):
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


def test_missing_pose_file_is_named(tmp_path):
    with pytest.raises(InputError, match=r"absent\.yaml"):
        load_initial_pose(tmp_path / "absent.yaml")


# --- reference of a session ------------------------------------------------------------------------------------------


@pytest.fixture
def reference(body, synthetic):
    poses = synthetic.smooth_motion(40, seed=2)
    return np.arange(100, 140), np.array([forward(body, pose) for pose in poses]), poses


def test_pose_of_a_reference_frame_has_its_points(body, reference):
    frames, points, poses = reference
    known = pose_from_reference(frames, points, 117, "truth.csv")
    assert np.abs(known.body.lengths - body.lengths).max() < 1e-9
    assert np.abs(forward(known.body, known.pose) - points[17]).max() < 1e-6
    assert np.abs(known.pose.minus(poses[17])).max() < 1e-5


def test_unknown_point_is_taken_from_a_near_frame(body, reference):
    frames, points, _ = reference
    holes = points.copy()
    holes[16:19, 11] = np.nan
    known = pose_from_reference(frames, holes, 117, "truth.csv")
    error = np.linalg.norm(forward(known.body, known.pose) - points[17], axis=1)
    assert error[11] < 0.08  # the hand moves at about 2 m/s
    assert np.delete(error, 11).max() < 1e-6


def test_point_unknown_for_long_is_refused_by_name(reference):
    frames, points, _ = reference
    holes = points.copy()
    holes[:30, 11] = np.nan
    with pytest.raises(InputError, match=r"truth\.csv.*left_hand.*117"):
        pose_from_reference(frames, holes, 117, "truth.csv")


def test_frame_outside_the_reference_is_refused_with_its_range(reference):
    frames, points, _ = reference
    with pytest.raises(InputError, match=r"no frame 5\..*100 to 139"):
        pose_from_reference(frames, points, 5, "truth.csv")


# --- T-pose ----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("heading", [0.0, 1.0, 2.5, -2.0])
@pytest.mark.parametrize("stature", [1.55, 1.90])
def test_t_pose_gives_heading_place_and_size(synthetic, stature, heading):
    body = Body.from_stature(stature)
    truth = synthetic.t_pose((0.3, -0.8, 0.53 * stature + body.half_lengths[0]), heading)
    measured = measure_t_pose(synthetic.flesh(body, truth))
    assert measured.reason == ""
    found = pose_of(measured, body_of([measured]))
    assert degrees_between(found.R_world_torso, truth.R_world_torso) < 5
    assert np.linalg.norm(found.position_world - truth.position_world) < 0.06
    assert measured.stature == pytest.approx(np.ptp(synthetic.flesh(body, truth)[:, 2]), abs=0.02)
    assert body_of([measured]).lengths.sum() == pytest.approx(body.lengths.sum(), rel=0.08)
    error = np.linalg.norm(forward(body_of([measured]), found) - forward(body, truth), axis=1)
    assert error.mean() < 0.06


@pytest.mark.parametrize(
    ("angles", "reason"),
    [
        ({"left_shoulder_x": -1.3, "right_shoulder_x": np.pi + 1.3}, "arms not stretched"),
        ({"left_shoulder_x": -0.5, "right_shoulder_x": np.pi + 0.5}, "arms not level"),
        ({"left_shoulder_x": 0.5, "right_shoulder_x": np.pi - 0.5}, "arms not level"),
        ({"left_shoulder_x": -1.5}, "arms not"),
        ({"left_elbow": -2.0}, "arms"),
        ({"left_elbow": -1.57, "right_elbow": -1.57}, "arms not stretched"),
    ],
)
def test_other_poses_are_refused_with_a_reason(body, synthetic, angles, reason):
    pose = bent(synthetic.t_pose((0, 0, 0.53 * 1.75 + body.half_lengths[0])), **angles)
    measured = measure_t_pose(synthetic.flesh(body, pose))
    assert reason in measured.reason


def test_no_hull_and_small_hull_are_refused(body, synthetic):
    voxels = synthetic.flesh(body, synthetic.t_pose())
    assert measure_t_pose(None).reason == "no hull"
    assert measure_t_pose(np.empty((0, 3))).reason == "no hull"
    assert "too small" in measure_t_pose(voxels[:50]).reason
    assert "too small: 0." in measure_t_pose(0.5 * voxels).reason
    assert "too large: 3." in measure_t_pose(2.0 * voxels).reason


def test_person_without_feet_cannot_tell_front_from_back(body, synthetic):
    voxels = synthetic.flesh(body, synthetic.t_pose())
    toes = (voxels[:, 2] < voxels[:, 2].min() + 0.08) & (np.abs(voxels[:, 0]) > 0.05)
    assert "front and back look alike" in measure_t_pose(voxels[~toes]).reason


def test_t_pose_must_be_held(body, synthetic):
    source = TPoseSource(TPoseSettings(hold_sets=3))
    voxels, none = synthetic.flesh(body, synthetic.t_pose()), np.empty((0, 3))
    reasons = [source.look(none, cloud).reason for cloud in (voxels, voxels, None, voxels, voxels)]
    assert reasons == [
        "T-pose seen, hold it (1 of 3)", "T-pose seen, hold it (2 of 3)", "no hull",
        "T-pose seen, hold it (1 of 3)", "T-pose seen, hold it (2 of 3)",
    ]  # fmt: skip
    found = source.look(none, voxels)
    assert found.reason == "" and found.pose is not None


def test_given_body_is_kept(body, synthetic):
    source = TPoseSource(TPoseSettings(hold_sets=1), body)
    assert source.look(np.empty((0, 3)), synthetic.flesh(body, synthetic.t_pose())).body is body
