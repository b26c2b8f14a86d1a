import cv2
import numpy as np
import pytest

from capture_rig.errors import InputError
from sagoma_tools.calibration.footage import open_footage_of_cameras


def still(path, grey=100):
    path.parent.mkdir(parents=True, exist_ok=True)
    cv2.imwrite(str(path), np.full((24, 32), grey, np.uint8))


def video(path, greys):
    path.parent.mkdir(parents=True, exist_ok=True)
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter_fourcc(*"mp4v"), 30, (64, 48), True)
    for grey in greys:
        writer.write(np.full((48, 64, 3), grey, np.uint8))
    writer.release()


def frames(footage):
    return {name: [frame_index for frame_index, _ in camera] for name, camera in footage.items()}


def test_folder_of_videos_gives_a_camera_each_with_frame_numbers_as_indices(tmp_path):
    video(tmp_path / "cam01.mp4", [10, 90, 170])
    video(tmp_path / "cam02_floor.mp4", [50, 60])
    footage = open_footage_of_cameras([str(tmp_path)])
    assert frames(footage) == {"cam01": [0, 1, 2], "cam02": [0, 1]}
    images = [image for _, image in footage["cam01"]]
    assert images[0].shape == (48, 64) and [round(image.mean(), -1) for image in images] == [10, 90, 170]
    assert footage["cam01"].count == 3 and footage["cam01"].is_video


def test_numbered_stills_carry_their_numbers_as_indices_so_that_a_missing_one_shifts_nothing(tmp_path):
    for side, numbers in (("left", (1, 2, 3, 10)), ("right", (1, 3, 10))):
        for number in numbers:
            still(tmp_path / f"{side}{number:02d}.png", 10 * number)
    footage = open_footage_of_cameras([str(tmp_path)])
    assert frames(footage) == {"left": [1, 2, 3, 10], "right": [1, 3, 10]}
    assert [image[0, 0] for _, image in footage["right"]] == [10, 30, 100]


def test_one_still_a_camera_is_the_same_moment_for_all(tmp_path):
    for name in ("cam01.png", "cam02.png", "cam10.jpg"):
        still(tmp_path / name)
    assert frames(open_footage_of_cameras([str(tmp_path)])) == {"cam01": [0], "cam02": [0], "cam10": [0]}


def test_sub_folders_are_cameras_and_stills_are_in_natural_order(tmp_path):
    for number in (2, 10, 1):
        still(tmp_path / "cam01" / f"img{number}.png", number)
    footage = open_footage_of_cameras([str(tmp_path)])
    assert [image[0, 0] for _, image in footage["cam01"]] == [1, 2, 10]


def test_numbers_that_no_other_camera_shares_are_no_indices(tmp_path):
    for name, start in (("a", 1000), ("b", 5000)):
        for k in range(3):
            still(tmp_path / name / f"{start + 7 * k}.png")
    assert frames(open_footage_of_cameras([str(tmp_path)])) == {"a": [0, 1, 2], "b": [0, 1, 2]}


def test_named_pattern_is_one_camera(tmp_path):
    for number in (1, 2):
        still(tmp_path / f"x_{number}.png")
    footage = open_footage_of_cameras([f"front={tmp_path}/x_*.png"])
    assert frames(footage) == {"front": [1, 2]} and footage["front"].where == str(tmp_path)


def test_damaged_still_is_left_out_and_the_others_keep_their_indices(tmp_path):
    for number in (1, 2, 3):
        still(tmp_path / f"view{number}.png")
    (tmp_path / "view2.png").write_bytes(b"no picture")
    assert frames(open_footage_of_cameras([f"cam={tmp_path}/view*.png"])) == {"cam": [1, 3]}


def test_same_camera_twice_is_refused_with_both_sources(tmp_path):
    still(tmp_path / "a" / "cam01.png")
    still(tmp_path / "b" / "cam01.png")
    with pytest.raises(InputError, match="cam01' is given twice") as refusal:
        open_footage_of_cameras([str(tmp_path / "a"), str(tmp_path / "b")])
    assert "NAME=PATH" in refusal.value.remedy


def test_video_and_background_of_one_camera_in_a_folder_are_refused(tmp_path):
    video(tmp_path / "cam01.mp4", [10])
    still(tmp_path / "cam01_background.png")
    with pytest.raises(InputError, match="several pieces of footage"):
        open_footage_of_cameras([str(tmp_path)])


@pytest.mark.parametrize(
    ("source", "says"),
    [
        ("{}/nothing.mp4", "does not exist"),
        ("{}", "holds no video"),
        ("cam={}/*.png", "holds no video"),
        ("={}/a.png", "begins with"),
        ("{}/notes.txt", "neither a video nor a still"),
    ],
)
def test_source_without_footage_is_refused(tmp_path, source, says):
    (tmp_path / "notes.txt").write_text("none")
    with pytest.raises(InputError, match=says):
        open_footage_of_cameras([source.format(tmp_path)])


def test_no_source_is_refused():
    with pytest.raises(InputError, match="no footage"):
        open_footage_of_cameras([])
