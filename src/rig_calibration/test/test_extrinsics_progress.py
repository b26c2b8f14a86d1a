"""What a person with the board is told while it is carried."""

from __future__ import annotations

from extrinsics_room import CARRIED_BOARD, carried_poses, circle, see_all

from rig_calibration.extrinsics.carried_board import ENOUGH_CELLS, ENOUGH_FRAMES, ENOUGH_SHARED, motion_progress

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
