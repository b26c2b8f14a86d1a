"""From motion files to the stick figure: names, units, axes, and a figure that stands where the file's person does."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import yaml

from capture_rig.errors import InputError
from stick_figure.body import Body
from stick_figure.kinematics import forward
from stick_figure.pose import Pose
from stick_figure.skeleton import POINT_NAMES
from virtual_studio.__main__ import main
from virtual_studio.motions.bvh import NAMINGS, plain
from virtual_studio.motions.recorded import RecordedMotion
from virtual_studio.people import VolumetricBody

# offsets in centimetres, y up, facing z, left is +x: the usual axes of character animation
TREE = {
    "Hips": ("", (0, 0, 0)),
    "Spine": ("Hips", (0, 20, 0)),
    "Neck": ("Spine", (0, 35, 0)),
    "Head": ("Neck", (0, 8, 0)),
    "HeadTop_End": ("Head", (0, 17, 0)),
} | {
    f"{side}{name}": (side + parent if parent not in ("Hips", "Spine") else parent, (sign * x, y, z))
    for side, sign in (("Left", 1), ("Right", -1))
    for name, parent, (x, y, z) in (
        ("Shoulder", "Spine", (3, 30, 0)),
        ("Arm", "Shoulder", (15, 0, 0)),
        ("ForeArm", "Arm", (29.2, 0, 0)),
        ("Hand", "ForeArm", (25, 0, 0)),
        ("UpLeg", "Hips", (9, -2, 0)),
        ("Leg", "UpLeg", (0, -43, 0)),
        ("Foot", "Leg", (0, -42, 0)),
    )
}
HEIGHT = 90.0


def person(path: Path, turns: dict[str, str], frames: int = 3, prefix: str = "", step: float = 0.0) -> Path:
    """A BVH file of a person; turns: 'Z X Y' angles in degrees by joint; step: how far it goes forward a frame."""
    order: list[str] = []

    def joint(name: str) -> list[str]:
        order.append(name)
        kind = "JOINT" if TREE[name][0] else "ROOT"
        move = "6 Xposition Yposition Zposition " if kind == "ROOT" else "3 "
        lines = [f"{kind} {prefix}{name}", "{", "OFFSET {} {} {}".format(*TREE[name][1])]
        lines += [f"CHANNELS {move}Zrotation Xrotation Yrotation"]
        for child in [child for child, (parent, _) in TREE.items() if parent == name]:
            lines += joint(child)
        return [*lines, "}"]

    text = ["HIERARCHY", *joint("Hips"), "MOTION", f"Frames: {frames}", "Frame Time: 0.01"]
    for k in range(frames):
        rotations = " ".join(turns.get(name, "0 0 0") for name in order)
        text.append(f"0 {HEIGHT} {k * step} {rotations}")
    path.write_text("\n".join(text) + "\n")
    return path


LEG_M, FILE_HZ = 0.85, 100.0


def figure(path: Path) -> tuple[Body, list[Pose]]:
    """The file's figure and its poses, at the file's own rate."""
    recorded = RecordedMotion(path)
    return Body.from_points(recorded.reference_points(LEG_M)[0]), recorded.figure(LEG_M, FILE_HZ)


def at(points: np.ndarray, name: str) -> np.ndarray:
    return points[POINT_NAMES.index(name)]


def test_a_t_pose_stands_upright_facing_x_with_its_left_at_y(tmp_path: Path) -> None:
    body, poses = figure(person(tmp_path / "t.bvh", {}))
    points = forward(body, poses[0])
    np.testing.assert_allclose(at(points, "neck"), [0, 0, 1.45], atol=1e-3)
    np.testing.assert_allclose(at(points, "head"), [0, 0, 1.70], atol=1e-3)
    np.testing.assert_allclose(at(points, "left_shoulder"), [0, 0.18, 1.40], atol=1e-3)
    np.testing.assert_allclose(at(points, "right_elbow"), [0, -0.472, 1.40], atol=1e-3)
    np.testing.assert_allclose(at(points, "left_hip"), [0, 0.09, 0.88], atol=1e-3)
    np.testing.assert_allclose(at(points, "right_foot"), [0, -0.09, 0.03], atol=1e-3)
    np.testing.assert_allclose(at(points, "left_hand"), [0, 0.722, 1.40], atol=1e-3)  # the file's wrist
    np.testing.assert_allclose(poses[0].R_world_torso, np.eye(3), atol=1e-9)


def test_turned_joints_turn_the_figure(tmp_path: Path) -> None:
    turns = {"LeftArm": "-90 0 0", "LeftForeArm": "0 0 -90", "RightUpLeg": "0 -90 0", "RightLeg": "0 90 0"}
    body, poses = figure(person(tmp_path / "t.bvh", turns))
    points = forward(body, poses[0])
    np.testing.assert_allclose(at(points, "left_elbow"), [0, 0.18, 1.40 - 0.292], atol=1e-3)  # the arm hangs
    forearm = at(points, "left_hand") - at(points, "left_elbow")
    np.testing.assert_allclose(forearm / np.linalg.norm(forearm), [1, 0, 0], atol=1e-6)  # and points forward
    np.testing.assert_allclose(at(points, "right_knee"), [0.43, -0.09, 0.88], atol=1e-3)  # sitting on one leg
    np.testing.assert_allclose(at(points, "right_foot"), [0.43, -0.09, 0.46], atol=1e-3)
    knee = poses[0].angles()[15]
    assert knee == pytest.approx(np.pi / 2, abs=1e-3)


def test_another_rate_keeps_the_speed(tmp_path: Path) -> None:
    path = person(tmp_path / "t.bvh", {}, frames=11, step=2.0)  # 2 cm a frame at 100 Hz
    poses = RecordedMotion(path).figure(LEG_M, 40.0)
    assert len(poses) == 5  # 0 to 0.1 s
    np.testing.assert_allclose(np.diff([pose.position_world[0] for pose in poses]), 2.0 / 40.0, atol=1e-6)


@pytest.mark.parametrize("prefix", ["mixamorig:", "mixamorig_", "Character1:", "MIXAMORIG9:"])
def test_names_are_known_whatever_the_exporter_put_before_them(tmp_path: Path, prefix: str) -> None:
    body, poses = figure(person(tmp_path / "t.bvh", {}, prefix=prefix))
    assert forward(body, poses[0])[2, 2] == pytest.approx(1.45, abs=1e-3)


def test_every_naming_is_written_plainly_and_mirrored() -> None:
    for naming in NAMINGS.values():
        for names in naming.values():
            assert all(plain(name) == name for name in names)
        left = [naming[role] for role in naming if role.startswith("left")]
        right = [naming[role] for role in naming if role.startswith("right")]
        assert len(left) == len(right) == 6
        assert not set(left) & set(right)


@pytest.mark.parametrize(
    ("old", "new", "up", "seconds", "said"),
    [
        ("", "", "z", 6.0, "probably y"),
        ("", "", "w", 6.0, "x, y or z"),
        ("JOINT Neck", "JOINT Kneck", "y", 6.0, r"no known way.*Kneck.*Mixamo"),
        ("", "", "y", 1.0, "before the recorded motion begins"),
        (f"0 {HEIGHT} 20.0", f"0 {HEIGHT} 500.0", "y", 6.0, r"the room is 2\.8 m wide"),
    ],
)
def test_what_cannot_be_played_is_refused_with_the_remedy(
    tmp_path: Path, old: str, new: str, up: str, seconds: float, said: str
) -> None:
    path = person(tmp_path / "t.bvh", {}, frames=21, step=1.0)
    path.write_text(path.read_text().replace(old, new))
    with pytest.raises(InputError, match=said):
        RecordedMotion(path, up)(Body.from_stature(1.75), seconds, 20.0)


def test_a_recorded_motion_begins_in_the_t_pose_and_stands_on_the_floor_in_the_middle(tmp_path: Path) -> None:
    path = person(tmp_path / "sit.bvh", {"LeftArm": "-90 0 0", "RightUpLeg": "0 -60 0"}, frames=101, step=1.0)
    body = Body.from_stature(1.6)
    motion = RecordedMotion(path)(body, 6.0, 30.0)
    assert len(motion.poses) == 30 + 30 + 31  # T-pose, blend, and the second that the file holds
    points = np.array([forward(body, pose) for pose in motion.poses])
    np.testing.assert_allclose(np.diff(points[:30], axis=0), 0.0, atol=1e-12)
    level = points[0, [11, 7, 3, 4, 8, 12], 2]
    np.testing.assert_allclose(level, level[0], atol=1e-9)  # both arms on one height
    assert points[0, 11, 1] > points[0, 12, 1]
    ankle = VolumetricBody(body).ankle_height
    np.testing.assert_allclose(points[:, 13:, 2].min(1), ankle, atol=2e-3)  # on one foot at least
    np.testing.assert_allclose(points[60:, 0, 0].min() + points[60:, 0, 0].max(), 0.0, atol=1e-6)
    legs_ratio = body.lengths[[4, 8]].sum() / 0.85
    assert points[-1, 0, 0] - points[60, 0, 0] == pytest.approx(legs_ratio, rel=1e-3)  # a metre, in this person's legs
    fastest = np.linalg.norm(np.diff(points, axis=0), axis=2).max() * 30.0
    assert fastest < 5.0  # m/s: nothing jumps
    assert len(RecordedMotion(path)(body, 2.5, 20.0).poses) == 50  # it may end sooner


def test_the_studio_renders_a_motion_file(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = person(tmp_path / "wave.bvh", {"LeftForeArm": "0 0 -60"}, frames=11)
    arguments = ["--motion", str(path), "--cameras", "1", "--no-ceiling", "--fps", "5", "--seconds", "3", "--no-shadow"]
    assert main([str(tmp_path / "session"), *arguments]) == 0
    assert "1 cameras x 11 frames" in capsys.readouterr().out
    session = yaml.safe_load((tmp_path / "session" / "session.yaml").read_text())
    assert session["recipe"]["motion"] == "wave.bvh"
    assert main([str(tmp_path / "other"), "--motion", str(tmp_path / "none.bvh")]) == 2
    assert "No such file" in capsys.readouterr().err
