"""Session folders: what a good one gives, and what each defect says."""

from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest
import yaml

from capture_rig.camera import CameraModel
from capture_rig.errors import InputError
from capture_rig.rig import Rig, Volume, save_rig
from capture_rig.session import footage_stamp_ns, load_session

WIDTH, HEIGHT = 64, 48


def write_video(path: Path, fps: float = 60.0, frames: int = 3) -> None:
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter_fourcc(*"mp4v"), fps, (WIDTH, HEIGHT))
    assert writer.isOpened()
    for value in range(frames):
        writer.write(np.full((HEIGHT, WIDTH, 3), 40 * value, np.uint8))
    writer.release()


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A session of two cameras at 60 fps, the second with a background still."""
    K = np.array([[50.0, 0, 32], [0, 50, 24], [0, 0, 1]])
    cameras = tuple(CameraModel(n, WIDTH, HEIGHT, K, "plumb_bob", np.zeros(5), np.eye(4)) for n in ("cam01", "cam02"))
    save_rig(Rig(cameras, Volume(np.zeros(3), np.ones(3))), tmp_path / "rig.yaml")
    for camera in cameras:
        write_video(tmp_path / f"{camera.name}.mp4")
    cv2.imwrite(str(tmp_path / "cam02_background.png"), np.zeros((HEIGHT, WIDTH), np.uint8))
    return tmp_path


def refusal(folder: Path) -> str:
    with pytest.raises(InputError) as caught:
        load_session(folder)
    assert str(folder) in str(caught.value)
    assert caught.value.remedy
    return str(caught.value)


def test_session_gives_rig_videos_and_frame_rate(folder: Path) -> None:
    session = load_session(str(folder))
    assert session.rig.names == ("cam01", "cam02")
    assert session.fps == 60
    assert session.videos == {"cam01": folder / "cam01.mp4", "cam02": folder / "cam02.mp4"}
    assert session.backgrounds == {"cam02": folder / "cam02_background.png"}
    assert session.masks == {}
    assert session.truth is None


def test_background_video_goes_before_a_still(folder: Path) -> None:
    write_video(folder / "cam02_background.mp4")
    assert load_session(folder).backgrounds["cam02"].suffix == ".mp4"


def test_other_videos_than_cameras_are_no_hindrance(folder: Path) -> None:
    for name in ("cam01_mask.mp4", "overlay.mp4"):
        write_video(folder / name)
    session = load_session(folder)
    assert session.masks == {"cam01": folder / "cam01_mask.mp4"}
    assert set(session.videos) == {"cam01", "cam02"}


def test_shared_sessions_are_complete(shared_data: Callable[..., Path]) -> None:
    session = load_session(shared_data("sessions", "zombie_he3"))
    assert len(session.rig.cameras) == len(session.videos) == len(session.backgrounds) == len(session.masks) == 3
    assert session.fps == 60
    assert session.truth is not None and session.truth.points_world.shape == (620, 15, 3)


def test_videos_with_suffixes_in_upper_case_are_found(folder: Path) -> None:
    for name in ("cam01", "cam02"):
        (folder / f"{name}.mp4").rename(folder / f"{name}.MP4")
    (folder / "cam02_background.png").rename(folder / "cam02_background.PNG")
    session = load_session(folder)
    assert session.videos["cam02"].name == "cam02.MP4"
    assert session.backgrounds["cam02"].name == "cam02_background.PNG"
    write_video(folder / "cam03.MP4".lower())
    (folder / "cam03.mp4").rename(folder / "cam03.AVI")
    assert "a video for cam03" in refusal(folder)


def test_rate_that_no_camera_has_is_refused_with_file_value_and_remedy(folder: Path) -> None:
    write_video(folder / "cam02.mp4", 1000.0)
    text = refusal(folder)
    assert "cam02.mp4: has no frame rate that a camera has: its header says 1000 fps" in text
    assert "'fps' in session.yaml" in text


@pytest.mark.parametrize("header_fps", [1000.0, 25.0])
def test_stated_rate_serves_where_the_headers_have_none_or_differ(folder: Path, header_fps: float) -> None:
    write_video(folder / "cam02.mp4", header_fps)
    (folder / "session.yaml").write_text("fps: 50\n")
    assert load_session(folder).fps == 50


def test_folder_that_does_not_exist_is_named(tmp_path: Path) -> None:
    assert "is not a folder" in refusal(tmp_path / "nowhere")


@pytest.mark.parametrize(
    ("damage", "says"),
    [
        (lambda folder: (folder / "rig.yaml").unlink(), "rig.yaml: cannot be read"),
        (lambda folder: (folder / "cam02.mp4").unlink(), "there is no video for cam02"),
        (lambda folder: write_video(folder / "cam03.mp4"), "a video for cam03, which rig.yaml does not list"),
        (lambda folder: (folder / "cam02.mp4").write_bytes(b"no video"), "cam02.mp4: cannot be opened as a video"),
    ],
)
def test_file_that_is_missing_damaged_or_a_stranger_is_named(
    folder: Path, damage: Callable[[Path], object], says: str
) -> None:
    damage(folder)
    assert says in refusal(folder)


def test_videos_of_different_rates_are_refused_with_the_rates(folder: Path) -> None:
    write_video(folder / "cam02.mp4", fps=25)
    text = refusal(folder)
    assert "different frame rates" in text and "'cam01': 60.0" in text and "'cam02': 25.0" in text
    assert "'fps' in session.yaml" in text


@pytest.mark.parametrize("content", ["", "source: test\n"])
def test_session_file_without_a_rate_leaves_that_of_the_videos(folder: Path, content: str) -> None:
    (folder / "session.yaml").write_text(content)
    assert load_session(folder).fps == 60


@pytest.mark.parametrize("fps", [0, -60, "sixty", True, float("nan"), float("inf"), [60]])
def test_stated_rate_that_is_none_is_refused(folder: Path, fps: object) -> None:
    (folder / "session.yaml").write_text(yaml.safe_dump({"fps": fps}))
    assert f"session.yaml: fps = {fps!r} is not a frame rate" in refusal(folder)


@pytest.mark.parametrize(("content", "problem"), [("fps: [60\n", "is not valid YAML"), ("- fps\n", "is not a mapping")])
def test_damaged_session_file_is_refused(folder: Path, content: str, problem: str) -> None:
    (folder / "session.yaml").write_text(content)
    assert f"session.yaml: {problem}" in refusal(folder)


def test_footage_stamps_are_whole_nanoseconds_that_do_not_drift() -> None:
    epoch = 1_700_000_000_123_456_789
    assert footage_stamp_ns(epoch, 0, 60.0) == epoch
    assert footage_stamp_ns(epoch, 1, 60.0) == epoch + 16_666_667
    assert footage_stamp_ns(epoch, 60 * 3600, 60.0) == epoch + 3600 * 1_000_000_000


def test_stamps_of_cameras_that_are_not_in_step_are_those_of_the_file(folder: Path) -> None:
    epoch = 1_000_000_000_000_000_000
    assert load_session(folder).stamps_ns(epoch, 3) == dict.fromkeys(("cam01", "cam02"), epoch + 50_000_000)
    (folder / "stamps.csv").write_text("frame,cam02,cam01\n0,0.004,0\n1,0.021,0.0166\n")
    session = load_session(folder)
    assert session.stamps_ns(epoch, 1) == {"cam01": epoch + 16_600_000, "cam02": epoch + 21_000_000}


@pytest.mark.parametrize(
    ("content", "problem"),
    [
        ("frame,cam01\n0,0\n", "column 'cam02' is missing"),
        ("frame,cam01,cam02\n0,0.1,0.2\n1,0,0.3\n", "do not rise"),
        ("frame,cam01,cam02\n0,0,\n", "do not rise"),
    ],
)
def test_stamps_that_are_incomplete_or_go_back_are_refused(folder: Path, content: str, problem: str) -> None:
    (folder / "stamps.csv").write_text(content)
    assert problem in refusal(folder)
