"""What is filmed for a calibration: where boards are held, what lies in the folder, and that it is always the same."""

import cv2
import numpy as np
import pytest

from capture_rig.rig import load_rig
from capture_rig.video import Video
from rig_calibration.boards.board import board_text, read_board
from virtual_studio.__main__ import main
from virtual_studio.boards import PosedBoard, carry, on_floor, print_of, wave
from virtual_studio.recording.footage import FLOOR_BOARD, HAND_BOARD, FootagePlan, read_truth_floor, write_setup
from virtual_studio.rig import ring

RIG = ring(5, ceiling=True)
HAND, FLOOR = print_of(HAND_BOARD), print_of(FLOOR_BOARD)
SMALL = FootagePlan(fps=1.0, moving_s=2.0, brief=True)


def corners_px(camera, board, T_world_board):
    """(n, 2) where a board's corners are in the picture; None unless all are, seen from in front."""
    towards = camera.centre_world - T_world_board[:3, 3]
    pixels = camera.project(PosedBoard(board, T_world_board[None]).corners_world)
    inside = (pixels > 0).all() and (pixels < [camera.width - 1, camera.height - 1]).all()
    return pixels if inside and T_world_board[:3, 2] @ towards > 0 else None


def angle_seen_deg(camera, board, T_world_board):
    """Between the board's normal and the line of sight."""
    middle = T_world_board[:3, :3] @ board.middle_board + T_world_board[:3, 3]
    sight = camera.centre_world - middle
    return np.rad2deg(np.arccos(T_world_board[:3, 2] @ sight / np.linalg.norm(sight)))


@pytest.mark.parametrize("camera", [RIG.cameras[0], RIG.cameras[-1]], ids=["ring", "ceiling"])
def test_waved_board_reaches_all_sides_of_the_picture_and_is_tilted_to_all_sides(camera):
    waved = wave(camera, HAND, 1)
    poses = [waved.path(t) for t in waved.rests_s]
    views = [pixels for T in poses if (pixels := corners_px(camera, HAND, T)) is not None]
    assert len(views) >= 25
    every = np.concatenate(views)
    assert every.min(axis=0).max() < 45 and (every.max(axis=0) > [camera.width - 45, camera.height - 45]).all()
    normals = np.array([(camera.R_camera_world @ T[:3, 2])[:2] for T in poses])
    assert (normals.max(axis=0) > np.sin(np.deg2rad(35))).all() and (
        normals.min(axis=0) < -np.sin(np.deg2rad(35))
    ).all()
    depths = [(camera.T_camera_world @ T @ [*HAND.middle_board, 1.0])[2] for T in poses]
    assert min(depths) < 0.6 and 1.2 < max(depths) < 1.6


def test_waved_board_leaves_the_picture_for_some_time_and_moves_between_rests():
    camera = RIG.cameras[1]
    waved = wave(camera, HAND, 2)
    outside = [corners_px(camera, HAND, waved.path(t)) is None for t in (0.0, waved.duration_s)]
    assert outside == [True, True]

    def speed_px(t):
        before, after = (camera.project((waved.path(x) @ [*HAND.middle_board, 1.0])[:3]) for x in (t - 0.01, t + 0.01))
        return np.linalg.norm(after - before) / 0.02

    resting = [speed_px(t) for t in waved.rests_s]
    travelling = [speed_px(t) for t in waved.rests_s[1:] - 0.5]
    assert max(resting) < 25.0 and np.median(travelling) > 100.0


def test_carried_board_is_shared_by_neighbours_and_by_the_camera_above():
    path = carry(FLOOR, 24.0, 1)
    moments = [path(t) for t in np.arange(0.0, 24.0, 0.2)]
    seen = np.array(
        [
            [corners_px(c, FLOOR, T) is not None and angle_seen_deg(c, FLOOR, T) < 65.0 for c in RIG.cameras]
            for T in moments
        ]
    )
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
    assert sorted(path.name for path in footage.iterdir()) == [
        "board.yaml",
        "floor",
        "floor_board.yaml",
        "intrinsics",
        "moving",
        "setup.yaml",
        "truth_floor.yaml",
        "truth_rig.yaml",
    ]
    for part, count in (("intrinsics", 19), ("moving", 2)):
        with Video(footage / part / "cam01.mp4") as video:
            assert abs(video.frame_count - count) <= 2
    assert cv2.imread(str(footage / "floor" / "cam01.png"), cv2.IMREAD_UNCHANGED).shape == (480, 640)
    assert load_rig(footage / "truth_rig.yaml").names == ("cam01",)


def test_boards_files_are_read_as_the_boards_that_were_filmed(footage):
    assert read_board(str(footage / "board.yaml")) == HAND_BOARD
    assert read_board(str(footage / "floor_board.yaml")) == read_board(board_text(FLOOR_BOARD)) == FLOOR_BOARD


def test_truth_says_where_the_middle_of_the_floor_board_lies_that_every_camera_sees(footage):
    corners = PosedBoard(FLOOR, on_floor(FLOOR)[None]).corners_world
    T = read_truth_floor(footage)
    np.testing.assert_allclose(T[:3, 3], corners.mean(axis=0), atol=1e-9)
    row = corners[6] - corners[0]
    np.testing.assert_allclose(T[:3, 0], row / np.linalg.norm(row), atol=1e-9)
    np.testing.assert_allclose(T[:3, 2], [0, 0, 1], atol=1e-9)
    for camera in RIG.cameras:
        assert corners_px(camera, FLOOR, on_floor(FLOOR)) is not None
        assert angle_seen_deg(camera, FLOOR, on_floor(FLOOR)) < 75.0


def test_command_refuses_a_text_that_is_no_board(tmp_path, capsys):
    assert main(["setup", str(tmp_path / "x"), "--board", "a nice board"]) == 2
    assert "describes no board" in capsys.readouterr().err and not (tmp_path / "x").exists()
