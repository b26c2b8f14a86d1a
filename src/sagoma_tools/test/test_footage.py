"""Footage: which files are which camera's, the codecs that people have, and what is said of bad files."""

import json
import re
import shutil

import cv2
import numpy as np
import pytest
from footage_clips import cut_off, transcoded, with_late_frames, write_clip

from capture_rig.errors import InputError
from capture_rig.video import Video
from sagoma_tools.calibration.footage import open_footage_of_cameras
from sagoma_tools.cli import main

FPS, FRAMES = 20.0, 12


# --- which files are which camera's footage


def make_footage(folder, files):
    """Stills of one grey level, films of a list of them, other files of a text."""
    for name, content in files.items():
        path = folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        if isinstance(content, str):
            path.write_text(content)
        elif isinstance(content, int):
            cv2.imwrite(str(path), np.full((24, 32), content, np.uint8))
        else:
            write_clip(path, [np.full((48, 64), grey, np.uint8) for grey in content], 30.0)


@pytest.mark.parametrize(
    ("files", "source", "expected"),
    [
        ({"cam01.mp4": [10, 90], "cam02_floor.mp4": [50]}, "{}", {"cam01": {0: 10, 1: 90}, "cam02": {0: 50}}),
        ({"left01.png": 10, "left10.png": 90, "right10.png": 40}, "{}", {"left": {1: 10, 10: 90}, "right": {10: 40}}),
        ({"cam01.png": 10, "cam10.jpg": 30}, "{}", {"cam01": {0: 10}, "cam10": {0: 30}}),
        ({"cam01/img2.png": 20, "cam01/img10.png": 90}, "{}", {"cam01": {2: 20, 10: 90}}),
        ({"a/1000.png": 10, "a/1007.png": 20, "b/5000.png": 30}, "{}", {"a": {0: 10, 1: 20}, "b": {0: 30}}),
        ({"x_1.png": 10, "x_2.png": "no picture", "x_3.png": 30}, "front={}/x_*.png", {"front": {1: 10, 3: 30}}),
    ],
    ids=["films", "numbers, one missing", "a still each", "natural order", "numbers not shared", "one still damaged"],
)
def test_frames_of_a_camera_have_the_index_of_their_moment(tmp_path, files, source, expected):
    make_footage(tmp_path, files)
    footage = open_footage_of_cameras([source.format(tmp_path)])
    found = {name: {index: round(image.mean(), -1) for index, image in camera} for name, camera in footage.items()}
    assert found == expected and list(found) == list(expected)
    assert all(list(frames) == sorted(frames) for frames in found.values())
    assert {camera.is_video for camera in footage.values()} == {"cam01.mp4" in files}


@pytest.mark.parametrize(
    ("files", "sources", "says"),
    [
        ({}, [], "no footage"),
        ({}, ["{}/nothing.mp4"], "does not exist"),
        ({"notes.txt": "none"}, ["{}"], "holds no video"),
        ({"notes.txt": "none"}, ["cam={}/*.png"], "holds no video"),
        ({}, ["={}/a.png"], "begins with"),
        ({"notes.txt": "none"}, ["{}/notes.txt"], "neither a video nor a still"),
        ({"a/cam01.png": 10, "b/cam01.png": 10}, ["{}/a", "{}/b"], "cam01' is given twice.*NAME=PATH"),
        ({"cam01.mp4": [10], "cam01_background.png": 10}, ["{}"], "several pieces of footage"),
    ],
)
def test_footage_that_is_none_or_given_twice_is_refused(tmp_path, files, sources, says):
    make_footage(tmp_path, files)
    with pytest.raises(InputError, match=says):
        open_footage_of_cameras([source.format(tmp_path) for source in sources])


# --- codecs and damage


def evaluated(capsys, session):
    """The figures, and what was said on standard error."""
    assert main(["evaluate", str(session), "--start", "session", "--json", "--set", "hull_server.backend=cpu"]) == 0
    printed = capsys.readouterr()
    return json.loads(printed.out.splitlines()[-1]), printed.err


def test_video_that_was_cut_off_ends_the_tracking_there_and_is_named(tour, tmp_path, capsys):
    copied = transcoded(tour, tmp_path / "copied", "MJPG", FPS)
    cut_off(copied / "cam03.avi", 0.6)
    with Video(copied / "cam03.avi") as video:
        left = sum(1 for _ in video)
    figures, said = evaluated(capsys, copied)
    assert 4 < left < FRAMES and figures["tracked"] == left
    assert f"cam03.avi: ends after {left} frames, its header promises {FRAMES}" in said
    assert f"cam03.avi ended after {left} frames, before the others" in said


def test_video_damaged_so_that_nobody_is_found_is_named(tour, tmp_path, capsys):
    copied = transcoded(tour, tmp_path / "copied", "MJPG", FPS)
    cut_off(copied / "cam03.avi", 0.15)
    assert main(["evaluate", str(copied), "--json", "--set", "hull_server.backend=cpu"]) == 2
    *of_videos, nobody = capsys.readouterr().err.splitlines()
    said = rf"cam03.avi: ends after [1-4] frames, its header promises {FRAMES}"
    assert any(re.search(said, line) for line in of_videos) and "no body was found" in nobody


def test_variable_frame_rate_is_said_when_tracking(tour, tmp_path, capsys):
    copied = shutil.copytree(tour, tmp_path / "copied", ignore=shutil.ignore_patterns("session.yaml"))
    with_late_frames(copied / "cam02.mp4", FRAMES - 4, 4)
    assert main(["evaluate", str(copied), "--json"]) == 2
    assert "different frame rates" in (said := capsys.readouterr().err) and "sagoma evaluate then names" in said
    (copied / "session.yaml").write_text(f"fps: {FPS}\n")
    figures, said = evaluated(capsys, copied)
    assert figures["frames"] == FRAMES
    assert "cam02.mp4: has a variable frame rate: its frames are 50 to 100 ms apart" in said
