"""Session folders: what a good one gives, and what each defect says."""

from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest
import yaml
from footage_clips import write_clip

from capture_rig.camera import CameraModel
from capture_rig.errors import InputError
from capture_rig.rig import Rig, Volume, save_rig
from capture_rig.session import footage_stamp_ns, load_session

WIDTH, HEIGHT = 64, 48


def write_video(path: Path, fps: float = 60.0) -> None:
    write_clip(path, [np.full((HEIGHT, WIDTH), 40 * number, np.uint8) for number in range(3)], fps)


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


@pytest.mark.parametrize(
    ("header_fps", "says"),
    [
        (1000.0, ["cam02.mp4: has no frame rate that a camera has: its header says 1000 fps"]),
        (25.0, ["different frame rates", "'cam01': 60.0", "'cam02': 25.0"]),
    ],
    ids=["no camera's", "another"],
)
def test_stated_rate_serves_where_the_headers_have_none_or_differ(folder: Path, header_fps: float, says) -> None:
    write_video(folder / "cam02.mp4", header_fps)
    text = refusal(folder)
    assert all(word in text for word in [*says, "'fps' in session.yaml"])
    (folder / "session.yaml").write_text("fps: 50\n")
    assert load_session(folder).fps == 50


@pytest.mark.parametrize(
    ("name", "content", "says"),
    [
        ("rig.yaml", None, "rig.yaml: cannot be read"),
        ("cam02.mp4", None, "there is no video for cam02"),
        ("cam03.mp4", b"", "a video for cam03, which rig.yaml does not list"),
        ("cam02.mp4", b"no video", "cam02.mp4: cannot be opened as a video"),
        ("session.yaml", b"fps: [60\n", "session.yaml: is not valid YAML"),
        ("session.yaml", b"- fps\n", "session.yaml: is not a mapping"),
        *(
            (
                "session.yaml",
                f"fps: {fps}\n".encode(),
                f"session.yaml: fps = {yaml.safe_load(fps)!r} is not a frame rate",
            )
            for fps in ("0", "-60", "sixty", "true", ".nan", ".inf", "[60]")
        ),
        ("stamps.csv", b"frame,cam01\n0,0\n", "column 'cam02' is missing"),
        ("stamps.csv", b"frame,cam01,cam02\n0,0.1,0.2\n1,0,0.3\n", "do not rise"),
        ("stamps.csv", b"frame,cam01,cam02\n0,0,\n", "do not rise"),
    ],
)
def test_file_that_is_missing_damaged_or_a_stranger_is_named(
    folder: Path, name: str, content: bytes | None, says: str
) -> None:
    if content is None:
        (folder / name).unlink()
    else:
        (folder / name).write_bytes(content)
    assert says in refusal(folder)


def test_folder_that_does_not_exist_is_named_and_a_session_file_may_say_nothing_of_the_rate(folder: Path) -> None:
    assert "is not a folder" in refusal(folder / "nowhere")
    for content in ("", "source: test\n"):
        (folder / "session.yaml").write_text(content)
        assert load_session(folder).fps == 60


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
