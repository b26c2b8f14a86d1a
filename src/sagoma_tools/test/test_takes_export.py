"""What is made of a take: files of other programs, and videos of everybody drawn where the cameras saw them."""

import csv

import numpy as np
import pytest
from take_bags import CAMERAS, TYPES, write_take

from capture_rig.errors import InputError
from capture_rig.rig import save_rig
from capture_rig.video import Video
from sagoma_tools.cli import main
from sagoma_tools.overlays import LEFT_BGR
from sagoma_tools.recording.recorded_motion import recorded_motions
from sagoma_tools.recording.writer import BagWriter
from sagoma_tools.takes.exporting import BODY_GREY, ROOM_GREY, write_video
from sagoma_tools.takes.folder import TakesFolder
from sagoma_tools.takes.measure import finish_take
from virtual_studio.rig import ring

FRAMES = 8


def test_every_format_is_written_beside_the_take_and_none_is_overwritten(tmp_path, take_at, capsys):
    take = take_at(tmp_path / "first", 20)
    assert main(["export", str(take)]) == 0
    names = {path.name for path in (take / "export").iterdir()}
    assert names == {f"first.{kind}" for kind in ("bvh", "glb", "c3d", "trc", "osim", "mot", "csv")}
    assert "b0001: 20 frames at 50 Hz, no gaps" in capsys.readouterr().out
    (take / "export" / "first.trc").write_text("mine")
    arguments = ["export", str(take), "--format", "trc", "bvh"]
    assert main(arguments) == 2
    assert "--overwrite" in capsys.readouterr().err
    assert (take / "export" / "first.trc").read_text() == "mine"
    assert main([*arguments, "--overwrite"]) == 0
    assert (take / "export" / "first.trc").read_text() != "mine"


def test_numbers_of_the_bag_arrive(tmp_path):
    take = write_take(tmp_path / "first", 20, missing=range(7, 9))
    assert main(["export", str(take), "--format", "csv", "--output", str(tmp_path / "out")]) == 0
    with (tmp_path / "out" / "first.csv").open(encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    assert [row["state"] for row in rows].count("") == 2 and rows[7]["state"] == ""
    assert float(rows[19]["torso_y_m"]) - float(rows[0]["torso_y_m"]) == pytest.approx(0.19, abs=1e-6)


def test_several_persons_get_a_file_each(tmp_path):
    take = write_take(tmp_path / "two", 5, prefixes=("/mocap", "/mocap/bodies/b0002"))
    motions = recorded_motions(take)
    assert sorted(motions) == ["b0001", "b0002"]
    assert motions["b0002"].points_world[0, 0, 0] - motions["b0001"].points_world[0, 0, 0] == pytest.approx(1.0)
    assert main(["export", str(take), "--format", "bvh", "--output", str(tmp_path)]) == 0
    assert (tmp_path / "two_b0001.bvh").exists() and (tmp_path / "two_b0002.bvh").exists()


def test_a_bag_without_a_person_is_refused(tmp_path, capsys):
    with BagWriter(tmp_path / "empty") as bag:
        bag.add_topic("/mocap/reference_points", TYPES["reference_points"])
    assert main(["export", str(tmp_path / "empty")]) == 2
    assert "holds no tracked person" in capsys.readouterr().err


@pytest.fixture(scope="module")
def take(tmp_path_factory):
    """A take of two cameras, one of which shows a silhouette of its left half."""
    folder = tmp_path_factory.mktemp("takes")
    rig = ring(2, False)
    halves = {}
    for camera in rig.cameras:
        canvas = camera.undistorted_view().camera
        halves[camera.name] = np.zeros((canvas.height, canvas.width), np.uint8)
    halves[CAMERAS[0]][:, : halves[CAMERAS[0]].shape[1] // 2] = 255
    path = write_take(folder / "walk", FRAMES, masks=halves)
    save_rig(rig, path / "rig.yaml")
    finish_take(path)
    return TakesFolder(folder).find("walk")


def pictures(path):
    with Video(path) as video:
        return list(video)


def test_a_person_is_drawn_over_the_silhouettes_of_every_camera(take, tmp_path):
    assert write_video(take, tmp_path / "walk.avi") == FRAMES
    shown = pictures(tmp_path / "walk.avi")
    assert len(shown) == FRAMES and not (tmp_path / ".walk.part.avi").exists()
    left, right = np.array_split(shown[3].astype(int), 2, axis=1)
    for half in (left, right):
        assert (np.abs(half - LEFT_BGR).max(-1) < 90).sum() > 50
    quarter = left.shape[1] // 8
    middle = left[left.shape[0] // 2 + 100]
    assert abs(middle[quarter].mean() - BODY_GREY) < 25 and abs(middle[-quarter].mean() - ROOM_GREY) < 25


def test_what_cannot_be_drawn_is_said_before_anything_is_written(take, tmp_path):
    bare = write_take(tmp_path / "bare", 3)
    for arguments, says in (
        ((take, tmp_path / "v.gif"), "cannot be written"),
        ((take, take.path / "rig.yaml"), "exists already"),
        ((TakesFolder(tmp_path).find("bare"), tmp_path / "v.avi"), r"no rig\.yaml"),
    ):
        with pytest.raises(InputError, match=says):
            write_video(*arguments)
    assert {path.name for path in tmp_path.iterdir()} == {bare.name}
