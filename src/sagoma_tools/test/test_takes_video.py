"""Videos of takes: everybody drawn where the cameras saw them."""

import numpy as np
import pytest
import take_bags
from take_bags import CAMERAS

from capture_rig.errors import InputError
from capture_rig.rig import save_rig
from capture_rig.video import Video
from sagoma_tools.overlays import LEFT_BGR
from sagoma_tools.takes.exporting import BODY_GREY, ROOM_GREY, write_video
from sagoma_tools.takes.folder import TakesFolder
from sagoma_tools.takes.measure import finish_take
from virtual_studio.rig import ring

FRAMES = 8


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
    path = take_bags.write_take(folder / "walk", FRAMES, masks=halves)
    save_rig(rig, path / "rig.yaml")
    finish_take(path)
    return TakesFolder(folder).find("walk")


def pictures(path):
    shown = []
    with Video(path) as video:
        while (image := video.read()) is not None:
            shown.append(image)
    return shown


def test_a_person_is_drawn_over_the_silhouettes_of_every_camera(take, tmp_path):
    assert write_video(take, tmp_path / "walk.avi") == FRAMES
    shown = pictures(tmp_path / "walk.avi")
    assert len(shown) == FRAMES and not (tmp_path / ".walk.part.avi").exists()
    first = shown[3].astype(int)
    left, right = np.array_split(first, 2, axis=1)
    for half in (left, right):
        assert (np.abs(half - LEFT_BGR).max(-1) < 90).sum() > 50
    quarter = left.shape[1] // 8
    middle = left[left.shape[0] // 2 + 100]
    assert abs(middle[quarter].mean() - BODY_GREY) < 25 and abs(middle[-quarter].mean() - ROOM_GREY) < 25


def test_some_cameras_at_another_rate(take, tmp_path):
    frames = write_video(take, tmp_path / "one.avi", [CAMERAS[1]], fps=10.0)
    shown = pictures(tmp_path / "one.avi")
    assert frames == len(shown) == 2 and shown[0].shape[1] < 1000


def test_what_cannot_be_drawn_is_said_before_anything_is_written(take, tmp_path):
    bare = take_bags.write_take(tmp_path / "bare", 3)
    for arguments, says in (
        ((take, tmp_path / "v.avi", ["cam09"]), "no silhouettes of cam09"),
        ((take, tmp_path / "v.gif"), "cannot be written"),
        ((take, tmp_path / "v.avi", [], 0.0), "frames a second"),
        ((take, take.path / "rig.yaml"), "exists already"),
        ((TakesFolder(tmp_path).find("bare"), tmp_path / "v.avi"), r"no rig\.yaml"),
    ):
        with pytest.raises(InputError, match=says):
            write_video(*arguments)
    assert {path.name for path in tmp_path.iterdir()} == {bare.name}
