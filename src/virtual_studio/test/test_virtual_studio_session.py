"""Session folders and footage for a calibration: what is in them, repeatability, and what happens when they cannot be
written."""

import cv2
import numpy as np
import pytest
import yaml

from capture_rig.errors import InputError
from capture_rig.rig import load_rig
from capture_rig.rigid import rotation_matrix
from capture_rig.session import load_session
from capture_rig.video import Video
from rig_calibration.boards.board import board_text, read_board
from stick_figure.body import Body, load_body
from stick_figure.kinematics import forward
from stick_figure.pose import Pose
from virtual_studio.__main__ import main
from virtual_studio.boards import PosedBoard, carry, on_floor, print_of, wave
from virtual_studio.motions.catalogue import tour
from virtual_studio.recording.footage import FLOOR_BOARD, HAND_BOARD, FootagePlan, read_truth_floor, write_setup
from virtual_studio.recording.session import TORSO_COLUMNS, RenderSettings, write_session
from virtual_studio.rig import ring

BODY = Body.from_stature(1.80)
SIZE = 320, 240
RIG = ring(1, ceiling=True, size=SIZE)
FRAMES = 16
SETTINGS = dict(rig=RIG, body=BODY, motion="tour", fps=10, seconds=FRAMES / 10)


def read_grey(path):
    """All frames (F, h, w) of a grey video."""
    with Video(path) as video:
        return np.array([image[..., 0] for image in video])


@pytest.fixture(scope="module")
def session_folder(tmp_path_factory):
    return write_session(tmp_path_factory.mktemp("studio") / "session", settings=RenderSettings(seed=4), **SETTINGS)


def test_session_reads_back_as_it_was_written(session_folder):
    session = load_session(session_folder)
    assert session.fps == 10
    assert set(session.videos) == set(session.backgrounds) == set(session.masks) == {"cam01", "cam02"}
    assert session.rig.names == RIG.names
    for name in session.videos:
        assert read_grey(session.videos[name]).shape == (FRAMES, *SIZE[::-1])
        assert read_grey(session.backgrounds[name]).shape == (15, *SIZE[::-1])
        assert set(np.unique(read_grey(session.masks[name]))) == {0, 255}


def test_truth_reads_back_and_its_points_follow_from_angles_torso_and_body(session_folder):
    truth, played = load_session(session_folder).truth, tour(BODY, FRAMES / 10, 10)
    body = load_body(session_folder / "body.yaml")
    np.testing.assert_array_equal(truth.frames, np.arange(FRAMES))
    np.testing.assert_allclose(truth.points_world, [forward(BODY, pose) for pose in played.poses], atol=2e-7)
    np.testing.assert_allclose(truth.angles, played.angles, atol=1e-7)
    table = np.genfromtxt(session_folder / "truth.csv", delimiter=",", names=True)
    for frame in range(0, FRAMES, 3):
        torso = np.array([table[name][frame] for name in TORSO_COLUMNS])
        pose = Pose.from_angles(torso[:3], rotation_matrix(torso[3:]), truth.angles[frame])
        np.testing.assert_allclose(forward(body, pose), truth.points_world[frame], atol=1e-6)


def test_footage_shows_the_person_where_the_mask_is(session_folder):
    session = load_session(session_folder)
    for name in session.videos:
        footage = read_grey(session.videos[name]).astype(float)
        empty, masks = read_grey(session.backgrounds[name]).mean(0), read_grey(session.masks[name]) > 0
        difference = np.abs(footage - empty)
        for frame in (0, 8, FRAMES - 1):
            assert 500 < masks[frame].sum() < 10_000
            inside, outside = difference[frame][masks[frame]], difference[frame][~masks[frame]]
            assert np.median(inside) > 30
            assert np.median(outside) < 6


def test_same_seed_gives_the_same_bytes_of_every_frame(session_folder, tmp_path):
    again = write_session(tmp_path / "again", settings=RenderSettings(seed=4), **SETTINGS)
    for kind in ("videos", "masks", "backgrounds"):
        first, second = getattr(load_session(session_folder), kind), getattr(load_session(again), kind)
        for name in first:
            assert read_grey(first[name]).tobytes() == read_grey(second[name]).tobytes()
    assert (session_folder / "truth.csv").read_bytes() == (again / "truth.csv").read_bytes()


def test_folder_of_someone_else_is_refused_and_left_alone(tmp_path):
    (tmp_path / "notes.txt").write_text("mine")
    (tmp_path / "session.yaml").write_text("fps: 60\n")
    with pytest.raises(InputError, match="not an empty folder"):
        write_session(tmp_path, **SETTINGS)
    assert (tmp_path / "notes.txt").read_text() == "mine"
    with pytest.raises(InputError, match=r"notes\.txt"):
        write_session(tmp_path / "notes.txt", **SETTINGS)


def test_interrupted_writing_leaves_the_older_session_and_no_rest(tmp_path):
    folder = tmp_path / "session"
    short = SETTINGS | {"rig": ring(1, ceiling=False, size=SIZE), "seconds": 0.2, "motion": "t_pose_only"}
    write_session(folder, **short)
    before = (folder / "truth.csv").read_bytes()

    def stop(done, total):
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        write_session(folder, **(short | {"seconds": 0.5}), progress=stop)
    assert (folder / "truth.csv").read_bytes() == before
    write_session(folder, **(short | {"seconds": 0.3}))
    assert len(load_session(folder).truth.frames) == 3
    assert [path.name for path in tmp_path.iterdir()] == ["session"]


def test_an_unknown_motion_is_refused_before_anything_is_written(tmp_path):
    with pytest.raises(InputError, match="dance"):
        write_session(tmp_path / "session", **(SETTINGS | {"motion": "dance"}))
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("option", ["--build=3", "--noise=-1"])
def test_sizes_that_no_person_has_and_impossible_noise_are_refused(tmp_path, capsys, option):
    with pytest.raises(SystemExit):
        main([str(tmp_path / "session"), option])
    assert option.partition("=")[0] in capsys.readouterr().err


def test_command_line_writes_a_session_and_says_what_or_what_is_wrong_in_one_line(tmp_path, capsys):
    folder = tmp_path / "session"
    arguments = ["--cameras", "1", "--no-ceiling", "--seconds", "0.2", "--fps", "10", "--stature", "1.6"]
    arguments += ["--size", "320x200"]
    assert main([str(folder), *arguments]) == 0
    assert "1 cameras x 2 frames" in capsys.readouterr().out
    rig, usual = load_session(folder).rig, ring(1, ceiling=False)
    assert rig.names == ("cam01",) and (rig.cameras[0].width, rig.cameras[0].height) == (320, 200)
    point, (x, y) = np.array([[0.3, -0.2, 1.0]]), usual.cameras[0].project(np.array([[0.3, -0.2, 1.0]]))[0]
    across = (x + 0.5) / 2 - 0.5, (y + 0.5) / 2 - 0.5 - 20.0  # half the pixels, 20 rows cut off at the top
    np.testing.assert_allclose(rig.cameras[0].project(point)[0], across, atol=1e-3)
    assert load_body(folder / "body.yaml").stature == pytest.approx(1.6)
    assert yaml.safe_load((folder / "session.yaml").read_text())["recipe"]["motion"] == "tour"
    (tmp_path / "other").write_text("in the way")
    assert main([str(tmp_path / "other"), *arguments]) == 2
    error = capsys.readouterr().err
    assert "virtual_studio:" in error and len(error.splitlines()) == 1


# --- footage for a calibration ----------------------------------------------------------------------------------------

SIX = ring(5, ceiling=True)
HAND, FLOOR = print_of(HAND_BOARD), print_of(FLOOR_BOARD)
SMALL = FootagePlan(fps=1.0, moving_s=2.0, brief=True)


def corners_px(camera, board, T_world_board):
    """(n, 2) where a board's corners are in the picture; None unless all are, seen from in front."""
    towards = camera.centre_world - T_world_board[:3, 3]
    pixels = camera.project(PosedBoard(board, T_world_board[None]).corners_world)
    inside = (pixels > 0).all() and (pixels < [camera.width - 1, camera.height - 1]).all()
    return pixels if inside and T_world_board[:3, 2] @ towards > 0 else None


def is_shown(camera, board, T_world_board, most_deg):
    """Whether all of a board is in the picture, its normal at most so far from the line of sight."""
    sight = camera.centre_world - T_world_board[:3, :3] @ board.middle_board - T_world_board[:3, 3]
    cosine = T_world_board[:3, 2] @ sight / np.linalg.norm(sight)
    return corners_px(camera, board, T_world_board) is not None and cosine > np.cos(np.deg2rad(most_deg))


@pytest.mark.parametrize("camera", [SIX.cameras[0], SIX.cameras[-1]], ids=["ring", "ceiling"])
def test_waved_board_reaches_all_sides_of_the_picture_and_is_tilted_to_all_sides(camera):
    waved = wave(camera, HAND, 1)
    poses = [waved.path(t) for t in waved.rests_s]
    views = [pixels for T in poses if (pixels := corners_px(camera, HAND, T)) is not None]
    assert len(views) >= 25
    every = np.concatenate(views)
    assert every.min(axis=0).max() < 45 and (every.max(axis=0) > [camera.width - 45, camera.height - 45]).all()
    tilts_deg = np.rad2deg(np.arcsin([(camera.R_camera_world @ T[:3, 2])[:2] for T in poses]))
    assert tilts_deg.max(axis=0).min() > 35.0 and tilts_deg.min(axis=0).max() < -35.0
    depths = [(camera.T_camera_world @ T @ [*HAND.middle_board, 1.0])[2] for T in poses]
    assert min(depths) < 0.6 and 1.2 < max(depths) < 1.6


def test_carried_board_is_shared_by_neighbours_and_by_the_camera_above():
    path = carry(FLOOR, 24.0, 1)
    moments = [path(t) for t in np.arange(0.0, 24.0, 0.2)]
    seen = np.array([[is_shown(c, FLOOR, T, 65.0) for c in SIX.cameras] for T in moments])
    assert (seen.sum(axis=0) >= 15).all()
    shared = seen.T.astype(int) @ seen
    assert all(shared[i, (i + 1) % 5] >= 5 for i in range(5))
    assert shared[5, :5].sum() >= 10
    heights = [T[2, 3] for T in moments]
    assert min(heights) > 0.3 and max(heights) < 2.2


@pytest.fixture(scope="module")
def footage(tmp_path_factory):
    return write_setup(tmp_path_factory.mktemp("setup") / "a", ring(1, ceiling=False), SMALL, motion=None)


def test_folder_holds_footage_boards_and_the_truth_apart(footage):
    files = "board.yaml floor floor_board.yaml intrinsics moving setup.yaml truth_floor.yaml truth_rig.yaml"
    assert sorted(path.name for path in footage.iterdir()) == files.split()
    for part, count in (("intrinsics", 19), ("moving", 2)):
        with Video(footage / part / "cam01.mp4") as video:
            assert abs(video.frame_count - count) <= 2
    assert cv2.imread(str(footage / "floor" / "cam01.png"), cv2.IMREAD_UNCHANGED).shape == (480, 640)
    assert load_rig(footage / "truth_rig.yaml").names == ("cam01",)
    assert read_board(str(footage / "board.yaml")) == HAND_BOARD
    assert read_board(str(footage / "floor_board.yaml")) == read_board(board_text(FLOOR_BOARD)) == FLOOR_BOARD


def test_truth_says_where_the_middle_of_the_floor_board_lies_that_every_camera_sees(footage):
    corners = PosedBoard(FLOOR, on_floor(FLOOR)[None]).corners_world
    T = read_truth_floor(footage)
    np.testing.assert_allclose(T[:3, 3], corners.mean(axis=0), atol=1e-9)
    row = corners[6] - corners[0]
    np.testing.assert_allclose(T[:3, 0], row / np.linalg.norm(row), atol=1e-9)
    np.testing.assert_allclose(T[:3, 2], [0, 0, 1], atol=1e-9)
    for camera in SIX.cameras:
        assert is_shown(camera, FLOOR, on_floor(FLOOR), 75.0)


def test_command_refuses_a_text_that_is_no_board(tmp_path, capsys):
    assert main(["setup", str(tmp_path / "x"), "--board", "a nice board"]) == 2
    assert "describes no board" in capsys.readouterr().err and not (tmp_path / "x").exists()
