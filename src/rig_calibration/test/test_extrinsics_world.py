"""Where the world lies on the board, what cameras see in common, when a carried board lies on the floor, and what
its carrier is told."""

import numpy as np
import pytest
from extrinsics_room import CARRIED_BOARD, FLOOR_BOARD, camera_at, carried_poses, circle, on_floor, see_all

from capture_rig.camera import CameraModel
from capture_rig.errors import InputError
from rig_calibration.extrinsics.carried_board import (
    ENOUGH_CELLS,
    ENOUGH_FRAMES,
    ENOUGH_SHARED,
    choose_frames,
    find_resting_frames,
    motion_progress,
    resting_around,
)
from rig_calibration.extrinsics.world import WorldChoice, board_in_world, common_volume, world_of_level_camera


def test_world_origin_is_the_boards_middle_below_its_thickness() -> None:
    corners = FLOOR_BOARD.corners_board
    T = board_in_world(corners, WorldChoice(thickness_m=0.005))
    corners_world = corners @ T[:3, :3].T + T[:3, 3]
    assert corners_world.mean(axis=0) == pytest.approx([0.0, 0.0, 0.005], abs=1e-12)
    assert corners_world[1] - corners_world[0] == pytest.approx([0.12, 0.0, 0.0]), "x runs along the rows"


@pytest.mark.parametrize("origin, corner", [("first-corner", 0), ((0.12, -0.24), 2 * 7 + 1)])
def test_world_origin_lies_where_it_is_asked_for(origin: str | tuple[float, float], corner: int) -> None:
    corners = FLOOR_BOARD.corners_board
    T = board_in_world(corners, WorldChoice(origin))  # type: ignore[arg-type]
    assert T[:3, :3] @ corners[corner] + T[:3, 3] == pytest.approx([0.0, 0.0, 0.0], abs=1e-12)


def test_heading_turns_world_x_counterclockwise_from_the_rows() -> None:
    T = board_in_world(FLOOR_BOARD.corners_board, WorldChoice(heading=np.pi / 2))
    assert T[:3, :3] @ [0.0, 1.0, 0.0] == pytest.approx([1.0, 0.0, 0.0], abs=1e-12), "the board's y is world x"


def test_level_camera_looks_along_world_x_with_z_up() -> None:
    T = world_of_level_camera(np.eye(4))
    assert T[:3, :3] @ [0.0, 0.0, 1.0] == pytest.approx([1.0, 0.0, 0.0])
    assert T[:3, :3] @ [0.0, 1.0, 0.0] == pytest.approx([0.0, 0.0, -1.0]), "the image's down is down"
    assert np.linalg.det(T[:3, :3]) == pytest.approx(1.0)


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
    assert common.enough == 3 and common.usable
    assert common.floor_m2[2] == pytest.approx(width * depth, rel=0.1)
    assert common.floor_m2[0] == pytest.approx((depth + 1.2) * depth, rel=0.1)
    size = common.box.high - common.box.low
    assert size[:2] == pytest.approx([width, depth], abs=0.25) and size[2] == pytest.approx(2.45)
    heights = np.arange(0.15, 2.4, 0.25)
    assert common.volume_m3 == pytest.approx(np.sum(2 * (2.4 - heights) * 2 * (3 - heights) * 0.25), rel=0.1)


def test_common_volume_says_when_nobody_can_stand_in_it() -> None:
    low = [
        camera_at(f"cam{i}", np.array([np.cos(a), np.sin(a), 0.2]), np.array([0.0, 0.0, 0.2]))
        for i, a in enumerate((0, 2, 4))
    ]
    common = common_volume(low)
    assert not common.usable and common.floor_m2[2] == 0.0
    assert (common.box.high > common.box.low).all()


def test_carried_board_is_found_lying_at_the_place_where_nothing_was_below_it() -> None:
    poses = dict(enumerate(carried_poses(60)))
    lying = on_floor(CARRIED_BOARD, 0.3, -0.2, 0.5)
    poses |= {frame_index: lying for frame_index in range(60, 66)}
    poses[70] = on_floor(CARRIED_BOARD, -0.5, 0.4)  # put down elsewhere, for a frame
    centres = [camera.centre_world for camera in circle(4).values()]
    assert find_resting_frames(poses, CARRIED_BOARD.corners_board, centres) == tuple(range(60, 66))


def test_board_that_never_lies_on_the_floor_is_refused_with_the_ways_out() -> None:
    poses = dict(enumerate(carried_poses(60)))
    centres = [camera.centre_world for camera in circle(4).values()]
    with pytest.raises(InputError, match="--floor-at"):
        find_resting_frames(poses, CARRIED_BOARD.corners_board, centres)


def test_frames_around_a_named_one_count_while_the_board_rests() -> None:
    lying = on_floor(CARRIED_BOARD)
    poses = [*carried_poses(4), lying, lying, lying, *carried_poses(3, seed=5)]
    detections = see_all(circle(4), CARRIED_BOARD, poses, "moving", noise_px=0.1)
    assert resting_around(detections, 5) == (4, 5, 6)
    with pytest.raises(InputError, match="no camera shows the board in frame 77"):
        resting_around(detections, 77)


def test_chosen_frames_are_shared_spread_and_independent_of_order() -> None:
    cameras = circle(4)
    detections = see_all(cameras, CARRIED_BOARD, carried_poses(200), "moving")
    chosen = choose_frames(detections, most=30)
    assert chosen == choose_frames(detections[::-1], most=30) and len(chosen) == 30
    seen_by = {m: {s.camera for s in detections if s.frame_index == m} for m in chosen}
    assert min(map(len, seen_by.values())) >= 2
    pairs = {(a, b) for names in seen_by.values() for a in names for b in names if a < b}
    available = {
        (a.camera, b.camera)
        for a in detections
        for b in detections
        if a.frame_index == b.frame_index and a.camera < b.camera
    }
    assert pairs == available, "every pair of cameras that shares a view shares a chosen one"


def test_frames_of_a_board_at_rest_are_preferred_to_those_of_one_that_is_swung() -> None:
    cameras = circle(3)
    slow = [on_floor(CARRIED_BOARD, 0.0, 0.002 * step) for step in range(20)]
    fast = [on_floor(CARRIED_BOARD, 0.0, 0.5 - 0.05 * step) for step in range(20)]
    chosen = choose_frames(see_all(cameras, CARRIED_BOARD, slow + fast, "moving"), most=10)
    assert sum(frame_index < 20 for frame_index in chosen) >= 7


# --- while the board is carried ---------------------------------------------------------------------------------------

CAMERAS = circle(3)
DETECTIONS = see_all(CAMERAS, CARRIED_BOARD, carried_poses(400), "moving")


def pair_only(one: str, other: str, count: int) -> list:
    """Detections of the first so many frames that both see, and nobody else's."""
    seen = {m: {s.camera for s in DETECTIONS if s.frame_index == m} for m in range(400)}
    shared_frames = [m for m, names in seen.items() if {one, other} <= names][:count]
    return [s for s in DETECTIONS if s.frame_index in shared_frames and s.camera in (one, other)]


def test_cameras_without_a_common_view_are_named_with_where_to_go() -> None:
    progress = motion_progress(tuple(CAMERAS), pair_only("cam01", "cam02", ENOUGH_SHARED))
    assert progress.groups == (("cam01", "cam02"), ("cam03",))
    assert progress.advice == "cam01 and cam03 share no view: carry the board where both see it"


def test_pair_that_shares_too_little_is_told_how_much_is_missing() -> None:
    seen = {(s.camera, s.frame_index): s for s in pair_only("cam01", "cam02", 30) + pair_only("cam02", "cam03", 3)}
    progress = motion_progress(tuple(CAMERAS), list(seen.values()))
    assert progress.advice == f"cam02 and cam03 share 3 of {ENOUGH_SHARED} frames: carry the board where both see it"


def test_nothing_is_missing_when_all_cameras_share_many_frames_all_over_their_images() -> None:
    progress = motion_progress(tuple(CAMERAS), DETECTIONS)
    assert progress.shared_frames >= ENOUGH_FRAMES and min(progress.cells.values()) >= ENOUGH_CELLS
    assert len(progress.groups) == 1 and progress.advice == ""


def test_few_frames_are_not_enough_even_when_every_pair_shares_some() -> None:
    pairs = [("cam01", "cam02"), ("cam02", "cam03"), ("cam01", "cam03")]
    some = {(s.camera, s.frame_index): s for pair in pairs for s in pair_only(*pair, ENOUGH_SHARED)}
    progress = motion_progress(tuple(CAMERAS), list(some.values()))
    assert progress.advice.startswith("carry on: ") and f"of {ENOUGH_FRAMES} frames" in progress.advice
