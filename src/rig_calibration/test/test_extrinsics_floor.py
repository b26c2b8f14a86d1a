"""A camera's pose from a board on the floor, against poses that OpenCV's projection was given."""

from dataclasses import replace

import numpy as np
import pytest
from extrinsics_room import NOISE_PX, camera_at, see

from capture_rig.camera import CameraModel
from capture_rig.errors import InputError
from capture_rig.rigid import inverse
from rig_calibration.boards.board import Checkerboard, TargetDetection
from rig_calibration.extrinsics.floor import average_still_board, floor_view

BOARD = Checkerboard(9, 6, (0.1, 0.1))
MIDDLE_BOARD = np.array([0.4, -0.25, 0.0])


def at_angle(angle_deg: float, distance_m: float = 3.0) -> CameraModel:
    """A camera that sees the board's middle at an angle from the board's normal, which is the world's z."""
    angle = np.deg2rad(angle_deg)
    away = np.array([0.3 * np.sin(angle), -0.954 * np.sin(angle), np.cos(angle)])
    return camera_at("cam01", MIDDLE_BOARD + distance_m * away, MIDDLE_BOARD)


def seen(
    camera: CameraModel, frame_index: int, noise_px: float = NOISE_PX, board: Checkerboard = BOARD
) -> TargetDetection:
    """What the camera sees of the board in a frame, with noise of that frame's own."""
    detection = see(camera, board, np.eye(4), "", frame_index, noise_px)
    assert detection is not None
    return detection


@pytest.mark.parametrize("angle_deg", [10.0, 45.0, 70.0, 80.0])
def test_camera_is_placed_at_any_angle(angle_deg: float) -> None:
    camera = at_angle(angle_deg)
    views = [floor_view(seen(camera, seed), BOARD.corners_board, camera) for seed in range(10)]
    errors_m = [np.linalg.norm(inverse(view.T_camera_board)[:3, 3] - camera.centre_world) for view in views]
    assert max(errors_m) < (0.06 if angle_deg < 30 else 0.015)  # a board seen from above tells little of the tilt
    assert np.rad2deg(views[0].angle) == pytest.approx(angle_deg, abs=0.5)
    assert np.mean([view.rms_px for view in views]) == pytest.approx(NOISE_PX, rel=0.1)


def test_second_solution_is_kept_when_the_board_is_small_and_far() -> None:
    small = Checkerboard(4, 3, (0.05, 0.05))
    camera = camera_at("cam01", np.array([0.0, -2.0, 5.0]), MIDDLE_BOARD)
    view = floor_view(seen(camera, 1, board=small), small.corners_board, camera)
    assert view.other is not None
    normals = view.T_camera_board[:3, 2], view.other[:3, 2]
    assert np.rad2deg(np.arccos(normals[0] @ normals[1])) > 5.0


def test_second_solution_is_ruled_out_when_the_board_is_large() -> None:
    camera = at_angle(60.0)
    assert floor_view(seen(camera, 1), BOARD.corners_board, camera).other is None


def test_board_in_a_mirror_is_refused_with_a_remedy() -> None:
    camera = at_angle(40.0)
    detection = seen(camera, 2)
    mirrored = replace(detection, ids=detection.ids.reshape(6, 9)[:, ::-1].ravel())
    with pytest.raises(InputError, match=r"cam01: .*mirror.*print upwards"):
        floor_view(mirrored, BOARD.corners_board, camera)


def test_three_corners_are_refused() -> None:
    camera = at_angle(40.0)
    detection = seen(camera, 2)
    three = replace(detection, ids=detection.ids[:3], pixels=detection.pixels[:3])
    with pytest.raises(InputError, match="only 3 corners"):
        floor_view(three, BOARD.corners_board, camera)


def test_averaged_corners_are_better_than_one_frame_and_leave_hands_and_moved_frames_out() -> None:
    camera, moved = at_angle(50.0), at_angle(55.0)
    truth = seen(camera, 0, noise_px=0.0).pixels
    frames = [seen(camera, frame) for frame in range(12)]
    frames[4].pixels[7] += [9.0, -4.0]  # one corner on a finger
    frames[6] = replace(frames[6], ids=frames[6].ids[9:], pixels=frames[6].pixels[9:])  # an arm
    frames += [seen(moved, frame) for frame in (12, 13)]
    still = average_still_board(frames[::-1], BOARD, target="floor")
    errors = still.detection.pixels - truth
    assert still.frames == tuple(range(12)) and still.moved_frames == (12, 13)
    assert np.sqrt((errors**2).mean()) < 1.2 * NOISE_PX / np.sqrt(12)
    assert np.abs(errors[7]).max() < 4 * NOISE_PX / np.sqrt(11)
    assert still.detection.target == "floor" and NOISE_PX / np.sqrt(12) < still.detection.sigma_px < NOISE_PX / 2


def test_frames_that_count_a_symmetric_board_from_either_end_are_averaged_in_one_order() -> None:
    board = Checkerboard(8, 6, (0.1, 0.1))
    camera = at_angle(50.0)
    frames = [seen(camera, frame, board=board) for frame in range(4)]
    frames[2] = replace(frames[2], ids=frames[2].ids[::-1].copy())
    still = average_still_board(frames, board, target="floor")
    assert len(still.frames) == 4
    assert np.abs(still.detection.pixels - seen(camera, 0, 0.0, board).pixels).max() < 4 * NOISE_PX / 2
