"""A camera's pose from a board on the floor; where the world lies on it; when a carried board lies on the floor, and
what its carrier is told."""

import re
from dataclasses import replace

import extrinsics_room as made
import numpy as np
import pytest
from bundle_studio import camera_at, ring

from capture_rig.camera import CameraModel
from capture_rig.errors import InputError
from rig_calibration.boards.board import Checkerboard, TargetDetection
from rig_calibration.extrinsics import board_frames
from rig_calibration.extrinsics.board_frames import average_still_board
from rig_calibration.extrinsics.world import WorldChoice, board_in_world, common_volume

BOARD = Checkerboard(9, 6, (0.1, 0.1))
MIDDLE_BOARD = np.array([0.4, -0.25, 0.0])


def at_angle(angle_deg: float, distance_m: float = 3.0) -> CameraModel:
    """A camera that sees the board's middle at an angle from the board's normal, which is the world's z."""
    angle = np.deg2rad(angle_deg)
    away = np.array([0.3 * np.sin(angle), -0.954 * np.sin(angle), np.cos(angle)])
    return camera_at("cam01", MIDDLE_BOARD + distance_m * away, MIDDLE_BOARD)


def seen(
    camera: CameraModel, frame_index: int, noise_px: float = made.NOISE_PX, board: Checkerboard = BOARD
) -> TargetDetection:
    """What the camera sees of the board in a frame, with noise of that frame's own."""
    (detection,) = made.see_all({"cam01": camera}, board, [np.eye(4)], "", noise_px, seed=frame_index)
    return replace(detection, frame_index=frame_index)


def test_averaged_corners_are_better_than_one_frame_and_leave_hands_and_moved_frames_out() -> None:
    camera, moved = at_angle(50.0), at_angle(55.0)
    truth = seen(camera, 0, noise_px=0.0).pixels
    frames = [seen(camera, frame) for frame in range(12)]
    frames[4].pixels[7] += [9.0, -4.0]  # one corner on a finger
    frames[6] = replace(frames[6], ids=frames[6].ids[9:], pixels=frames[6].pixels[9:])  # an arm
    frames += [seen(moved, frame) for frame in (12, 13)]
    still = average_still_board(frames[::-1], BOARD)
    errors = still.pixels - truth
    assert np.sqrt((errors**2).mean()) < 1.2 * made.NOISE_PX / np.sqrt(12)
    assert np.abs(errors[7]).max() < 4 * made.NOISE_PX / np.sqrt(11)
    assert still.target == "floor" and made.NOISE_PX / np.sqrt(12) < still.sigma_px < made.NOISE_PX / 2


def test_frames_that_count_a_symmetric_board_from_either_end_are_averaged_in_one_order() -> None:
    board = Checkerboard(8, 6, (0.1, 0.1))
    camera = at_angle(50.0)
    frames = [seen(camera, frame, board=board) for frame in range(4)]
    frames[2] = replace(frames[2], ids=frames[2].ids[::-1].copy())
    still = average_still_board(frames, board)
    assert np.abs(still.pixels - seen(camera, 0, 0.0, board).pixels).max() < 4 * made.NOISE_PX / 2


# --- the world, and a carried board -----------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("choice", "point_board", "point_world"),
    [
        (WorldChoice(thickness_m=0.005), [0.36, -0.18, 0.0], [0.0, 0.0, 0.005]),
        (WorldChoice(thickness_m=0.005), [0.48, -0.18, 0.0], [0.12, 0.0, 0.005]),
        (WorldChoice((0.12, -0.24)), [0.12, -0.24, 0.0], [0.0, 0.0, 0.0]),
        (WorldChoice((0.0, 0.0), heading=np.pi / 2), [0.0, 1.0, 0.0], [1.0, 0.0, 0.0]),
    ],
    ids=["the board's middle", "x along the rows", "any place", "heading counterclockwise"],
)
def test_world_lies_on_the_floor_board_as_it_is_asked_for(choice, point_board, point_world) -> None:
    T = board_in_world(made.FLOOR_BOARD.corners_board, choice)
    assert T[:3, :3] @ point_board + T[:3, 3] == pytest.approx(point_world, abs=1e-12)


def ceiling_camera(name: str, x: float, y: float) -> CameraModel:
    """Looks straight down from 3 m, with a square view of 90 degrees: at height z it sees |x|, |y| < 3 - z."""
    T = np.diag([1.0, -1.0, -1.0, 1.0])
    T[:3, 3] = [-x, y, 3.0]
    K = np.array([[200.0, 0.0, 199.5], [0.0, 200.0, 199.5], [0.0, 0.0, 1.0]])
    return CameraModel(name, 400, 400, K, "plumb_bob", np.zeros(5), T)


def test_common_volume_of_cameras_looking_down_is_the_pyramids_cut() -> None:
    """Three pyramids 0.6 m apart: at height z all see x from -(3 - z) + 0.6 to (3 - z) - 0.6."""
    common = common_volume([ceiling_camera(f"cam{i}", x, 0.0) for i, x in enumerate((-0.6, 0.0, 0.6))])
    half = 3.0 - 1.65  # the highest level up to which a standing person is asked for
    width, depth = 2 * (half - 0.6), 2 * half
    assert common.enough == 3
    assert common.floor_m2[2] == pytest.approx(width * depth, rel=0.1)
    assert common.floor_m2[0] == pytest.approx((depth + 1.2) * depth, rel=0.1)
    size = common.box.high - common.box.low
    assert size[:2] == pytest.approx([width, depth], abs=0.25) and size[2] == pytest.approx(2.45)


def test_common_volume_says_when_nobody_can_stand_in_it() -> None:
    low = [
        camera_at(f"cam{i}", np.array([np.cos(a), np.sin(a), 0.2]), np.array([0.0, 0.0, 0.2]))
        for i, a in enumerate((0, 2, 4))
    ]
    common = common_volume(low)
    assert common.floor_m2[2] == 0.0
    assert (common.box.high > common.box.low).all()


def test_carried_board_lies_on_the_floor_where_nothing_was_below_it() -> None:
    poses = dict(enumerate(made.carried_poses(60, seed=4)))
    lying = made.on_floor(made.CARRIED_BOARD, 0.3, -0.2, 0.5)
    poses |= {frame_index: lying for frame_index in range(60, 66)}
    poses[70] = made.on_floor(made.CARRIED_BOARD, -0.5, 0.4)  # put down elsewhere, for a frame
    centres = [camera.centre_world for camera in ring(4).values()]
    assert board_frames.lying_frames(poses, made.CARRIED_BOARD.corners_board, centres) == (*range(60, 66), 70)


def test_board_that_never_lies_on_the_floor_is_refused_with_the_ways_out() -> None:
    poses = dict(enumerate(made.carried_poses(60)))
    centres = [camera.centre_world for camera in ring(4).values()]
    with pytest.raises(InputError, match="--floor-at"):
        board_frames.lying_frames(poses, made.CARRIED_BOARD.corners_board, centres)


def test_frames_around_a_named_one_count_while_the_board_rests() -> None:
    lying = made.on_floor(made.CARRIED_BOARD)
    poses = [*made.carried_poses(4), lying, lying, lying, *made.carried_poses(3, seed=5)]
    detections = made.see_all(ring(4), made.CARRIED_BOARD, poses, "moving", noise_px=0.1)
    assert board_frames.resting_around(detections, 5) == (4, 5, 6)
    with pytest.raises(InputError, match="no camera shows the board in frame 77"):
        board_frames.resting_around(detections, 77)


# --- while the board is carried ---------------------------------------------------------------------------------------

CAMERAS = ring(3)
DETECTIONS = made.see_all(CAMERAS, made.CARRIED_BOARD, made.carried_poses(400), "moving")


def pair_only(one: str, other: str, count: int) -> list:
    """Detections of the first so many frames that both see, and nobody else's."""
    frames = sorted(
        {s.frame_index for s in DETECTIONS if s.camera == one}.intersection(
            s.frame_index for s in DETECTIONS if s.camera == other
        )
    )[:count]
    return [s for s in DETECTIONS if s.frame_index in frames and s.camera in (one, other)]


@pytest.mark.parametrize(
    ("seen", "advice"),
    [
        (pair_only("cam01", "cam02", 12), "cam01 and cam03 share no view: carry the board where both see it"),
        (
            pair_only("cam01", "cam02", 30) + pair_only("cam02", "cam03", 3),
            "cam02 and cam03 share 3 of 12 frames: carry the board where both see it",
        ),
        (pair_only("cam01", "cam02", 15) + pair_only("cam02", "cam03", 15), "carry on: "),
        (DETECTIONS, "$"),
    ],
    ids=["no common view", "too little in common", "few frames", "enough"],
)
def test_what_is_missing_is_said(seen: list, advice: str) -> None:
    once = {(s.camera, s.frame_index): s for s in seen}
    assert re.match(advice, board_frames.motion_advice(tuple(CAMERAS), list(once.values()))[1])
