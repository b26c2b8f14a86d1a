"""Session folders and their reference data: what good ones give, and what each defect says."""

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
from capture_rig.session import (
    ANGLE_COUNT,
    POSE_NETWORK,
    RENDERED,
    WRIST_FRACTION,
    Truth,
    footage_stamp_ns,
    load_session,
    load_truth,
)

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


def test_other_videos_than_cameras_are_no_hindrance(folder: Path) -> None:
    for name in ("cam01_mask.mp4", "overlay.mp4"):
        write_video(folder / name)
    session = load_session(folder)
    assert session.masks == {"cam01": folder / "cam01_mask.mp4"}
    assert set(session.videos) == {"cam01", "cam02"}


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


# --- reference data ---------------------------------------------------------------------------------------------------

ANGLES = [f"angle{k}_rad" for k in range(ANGLE_COUNT)]


def columns_of(table: tuple[tuple[str, ...], ...]) -> list[str]:
    return [f"{part}_{axis}" for part in sorted({part for parts in table for part in parts}) for axis in "xyz"]


def write(path: Path, columns: list[str], rows: list[list[object]]) -> Path:
    lines = [["frame", *columns], *rows]
    path.write_text("\n".join(",".join(map(str, line)) for line in lines) + "\n")
    return path


def numbers(columns: list[str], frame: int = 0) -> list[object]:
    return [frame, *(np.random.default_rng(frame).normal(size=len(columns)).round(5).tolist())]


@pytest.fixture
def table(tmp_path: Path) -> Callable[..., tuple[list[str], list[object], Truth]]:
    """table(kind, cells): columns, the row and what is read of a table of one row with some cells replaced."""

    def make(kind, *more: str, **cells: str) -> tuple[list[str], list[object], Truth]:
        columns = [*columns_of(kind), *more]
        row = numbers(columns)
        for name, text in cells.items():
            row[1 + columns.index(name)] = text
        return columns, row, load_truth(write(tmp_path / "truth.csv", columns, [row]))

    return make


def test_rendered_truth_gives_frames_and_points_in_order(tmp_path: Path) -> None:
    columns = columns_of(RENDERED)
    rows = [numbers(columns, frame) for frame in (0, 1, 5)]
    truth = load_truth(write(tmp_path / "truth.csv", columns, rows))
    assert truth.frames.tolist() == [0, 1, 5]
    assert truth.points_world.shape == (3, 15, 3)
    head = 1 + columns.index("head_top_x")
    assert truth.points_world[2, 1].tolist() == rows[2][head : head + 3]
    points = truth.points_world[0]  # the torso's centre is half way from the neck to the middle of the hips
    assert points[0] == pytest.approx((points[2] + (points[5] + points[6]) / 2) / 2)
    right_foot = 1 + columns.index("r_ankle_x")
    assert truth.points_world[1, 14].tolist() == rows[1][right_foot : right_foot + 3]
    assert truth.angles is None


def test_empty_cells_are_unknown_points(table) -> None:
    points = table(RENDERED, l_knee_y="")[2].points_world[0]
    assert np.isnan(points[9, 1]) and np.isfinite(np.delete(points, 9, axis=0)).all()


def test_eighteen_angle_columns_are_read_as_angles(table) -> None:
    _, row, truth = table(RENDERED, *ANGLES, "torso_rx_rad")
    assert truth.angles is not None and truth.angles.tolist() == [row[-1 - ANGLE_COUNT : -1]]


def test_pose_network_reference_ends_at_the_wrist(table) -> None:
    columns, row, truth = table(POSE_NETWORK)
    wrist = 1 + columns.index("LWrist_x")
    assert truth.points_world[0, 11].tolist() == row[wrist : wrist + 3]
    assert truth.wrist_fraction == WRIST_FRACTION


def test_stick_figure_of_a_wrist_reference_ends_at_the_finger_tips(table) -> None:
    _, _, truth = table(POSE_NETWORK)
    reference, stick_figure = truth.points_world[0], truth.stick_figure_points()[0]
    for elbow, hand in ((7, 11), (8, 12)):
        wrist_m, tip_m = (np.linalg.norm(points[hand] - points[elbow]) for points in (reference, stick_figure))
        assert wrist_m / tip_m == pytest.approx(0.146 / 0.254)  # forearm, and forearm with hand, of stature
    assert truth.comparable(stick_figure) == pytest.approx(reference)


def test_shared_sessions_have_the_torso_centroid_where_the_renderer_put_it(shared_data: Callable[..., Path]) -> None:
    truth = load_truth(shared_data("sessions", "walk_ring5top", "truth.csv"))
    # the rig's pelvis joint is not exactly between the hip joints, so the two torso centres differ by millimetres
    assert truth.points_world[0, 2] == pytest.approx([-0.00477, 1.48977, 1.50445])
    assert len(truth.frames) == 240


def test_missing_column_is_named(tmp_path: Path) -> None:
    columns = [column for column in columns_of(RENDERED) if column != "l_knee_y"]
    with pytest.raises(InputError, match=r"truth\.csv: column 'l_knee_y' is missing.*every reference point"):
        load_truth(write(tmp_path / "truth.csv", columns, [numbers(columns)]))


@pytest.mark.parametrize("text", ["", "frame,a\n0,high\n", "frame,a\n0,1\n1\n", "frame,a\n", "a,b\n1,2\n", "\x00\xff"])
def test_text_that_is_no_table_of_numbers_is_refused(tmp_path: Path, text: str) -> None:
    (tmp_path / "truth.csv").write_text(text, encoding="latin-1")
    with pytest.raises(InputError, match=r"truth\.csv: ") as caught:
        load_truth(tmp_path / "truth.csv")
    assert caught.value.remedy


@pytest.mark.parametrize("frame", ["0.5", ""])
def test_frame_that_is_no_whole_number_is_refused(tmp_path: Path, frame: str) -> None:
    columns = columns_of(RENDERED)
    with pytest.raises(InputError, match=r"column 'frame' holds something else than whole numbers"):
        load_truth(write(tmp_path / "truth.csv", columns, [[frame, *numbers(columns)[1:]]]))


def test_rows_of_chosen_frames_are_kept_with_their_angles() -> None:
    frames = np.array([2, 4, 6, 9])
    points = np.arange(4.0)[:, None, None] * np.ones((15, 3))
    truth = Truth(frames, points, np.arange(4.0)[:, None] * np.ones(18), 1.0, Path("truth.csv"))
    chosen = truth.of_frames(np.array([1, 4, 9, 10]))
    assert chosen.frames.tolist() == [4, 9]
    assert chosen.points_world[:, 0, 0].tolist() == [1.0, 3.0] and chosen.angles[:, 0].tolist() == [1.0, 3.0]
