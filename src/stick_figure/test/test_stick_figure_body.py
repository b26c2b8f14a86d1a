"""Body sizes: anthropometry, measuring, YAML and its errors; joint centres that follow the pose."""

import numpy as np
import pytest
import yaml
from poses import MIRRORED_POINTS, angles_with, random_pose

from capture_rig.errors import InputError
from stick_figure.body import Body, load_body, save_body
from stick_figure.kinematics import forward
from stick_figure.pose import T_POSE_ANGLES, Pose
from stick_figure.skeleton import ANGLE_NAMES, POINT_NAMES, STICK_NAMES, mirror_angles
from stick_figure.trunk_bend import with_joint_centres


def test_average_body_has_published_heights_when_standing():
    body = Body.from_stature(1.80)
    points = forward(body, Pose.from_angles(np.zeros(3), np.eye(3), T_POSE_ANGLES))
    heights = (points[:, 2] - points[13, 2]) / 1.80 + 0.039  # ankle height over stature
    np.testing.assert_allclose(heights[[1, 2, 3, 5, 9]], [1.0, 0.870, 0.818, 0.530, 0.285], atol=1e-12)
    assert body.stature == pytest.approx(1.80)
    span = points[11, 1] - points[12, 1]
    assert 0.95 < span / 1.80 < 1.2  # arm span is about the stature
    assert 0.19 < points[5, 1] - points[6, 1] < 0.27  # hip centres


@pytest.mark.parametrize("stature", [0.3, 175.0, float("nan"), -1.7, "tall"])
def test_impossible_stature_is_refused(stature):
    with pytest.raises(InputError):
        Body.from_stature(stature)


def test_measured_body_equals_the_one_that_made_the_points():
    rng, body = np.random.default_rng(1), Body.from_stature(1.68)
    points = np.array([forward(body, random_pose(rng)) for _ in range(20)])
    points[3:6, 8] = np.nan
    points[0] = np.nan
    measured = Body.from_points(points)
    np.testing.assert_allclose(measured.half_lengths, body.half_lengths, atol=1e-12)
    for ratio in ("half_shoulder_width", "shoulder_height_ratio", "hip_width_ratio"):
        assert getattr(measured, ratio) == pytest.approx(getattr(body, ratio), abs=1e-12)


def test_measuring_names_the_limb_that_is_never_seen():
    points = np.random.default_rng(2).normal(size=(5, 15, 3))
    points[:, [13, 14]] = np.nan
    with pytest.raises(InputError, match="calf"):
        Body.from_points(points)
    with pytest.raises(InputError, match="shape"):
        Body.from_points(points[:, :14])


def test_body_file_round_trip_keeps_every_number(tmp_path):
    body = Body(np.linspace(0.1, 0.3, 10), 0.17, 0.83, 0.61)
    save_body(body, tmp_path / "body.yaml", source="measured")
    assert tuple(yaml.safe_load((tmp_path / "body.yaml").read_text())["lengths"]) == STICK_NAMES
    loaded = load_body(tmp_path / "body.yaml")
    np.testing.assert_array_equal(loaded.half_lengths, body.half_lengths)
    assert (loaded.half_shoulder_width, loaded.shoulder_height_ratio, loaded.hip_width_ratio) == (0.17, 0.83, 0.61)


SPOILT = {
    "missing": (lambda d: d.pop("shoulder_width"), ["shoulder_width", "missing"]),
    "missing length": (lambda d: d["lengths"].pop("head"), ["lengths", "head"]),
    "negative": (lambda d: d["lengths"].update(torso=-0.5), ["lengths.torso", "-0.5"]),
    "word": (lambda d: d["lengths"].update(torso="long"), ["lengths.torso", "long"]),
    "bool": (lambda d: d.update(hip_width_ratio=True), ["hip_width_ratio", "True"]),
    "millimetres": (lambda d: d["lengths"].update(torso=540.0), ["lengths.torso", "540", "metres"]),
    "nan": (lambda d: d.update(shoulder_width=float("nan")), ["shoulder_width", "nan"]),
    "unknown": (lambda d: d.update(beard=1), ["beard", "not known"]),
    "units": (lambda d: d.update(units="mm"), ["units", "mm", "metres"]),
    "list": (lambda d: d.update(lengths=[1, 2]), ["lengths", "[1, 2]"]),
}


@pytest.mark.parametrize(("spoil", "words"), SPOILT.values(), ids=SPOILT)
def test_bad_body_file_names_file_key_and_value(tmp_path, spoil, words):
    path = tmp_path / "body.yaml"
    save_body(Body.from_stature(1.75), path)
    document = yaml.safe_load(path.read_text())
    spoil(document)
    path.write_text(yaml.safe_dump(document))
    with pytest.raises(InputError) as error:
        load_body(path)
    assert all(word in str(error.value) for word in ["body.yaml", *words])


@pytest.mark.parametrize(
    ("lengths", "half_shoulder_width", "says"),
    [
        ([0.2] * 4 + [0.0] + [0.2] * 5, 0.2, "left_thigh"),
        ([0.2] * 10, float("inf"), "half_shoulder_width"),
        ([0.2] * 9, 0.2, "10 stick lengths"),
    ],
)
def test_body_of_impossible_lengths_is_refused(lengths, half_shoulder_width, says):
    with pytest.raises(InputError, match=says):
        Body(np.array(lengths), half_shoulder_width)


def test_thickness_of_an_older_body_file_is_left_aside(tmp_path):
    body, path = Body.from_stature(1.75), tmp_path / "thick.yaml"
    save_body(body, path)
    path.write_text(path.read_text() + "thickness: {upper_arm: 1.1}\n")
    np.testing.assert_array_equal(load_body(path).half_lengths, body.half_lengths)


# --- joint centres ----------------------------------------------------------------------------------------------------

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
