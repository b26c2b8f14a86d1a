"""Views that are wrong: left out and named, and what cannot be calibrated at all is refused."""

from dataclasses import replace

import numpy as np
import pytest
from intrinsics_views import errors_in_sds, found, lens, shown, with_pixels

from capture_rig.errors import InputError
from rig_calibration.boards.board import Checkerboard


def assert_lens(result, camera):
    assert np.abs(errors_in_sds(result, camera)).max() < 3.5


def test_view_with_shifted_corners_is_left_out_and_named():
    camera = lens()
    detections = shown(camera, 20, 0.2, seed=1)
    moved = detections[7].pixels.copy()
    moved[:27] += [6.0, -4.0]  # half of the board, as if it had moved while the rows were read
    detections[7] = with_pixels(detections[7], moved)
    result = found(detections)
    assert [entry.detection.frame_index for entry in result.left_out if entry.whole] == [7]
    assert "where the other views' lens puts them" in result.left_out[0].reason
    assert_lens(result, camera)


def test_single_wrong_corners_are_left_out_and_the_view_stays():
    camera = lens()
    detections = shown(camera, 20, 0.2, seed=2)
    pixels = detections[3].pixels.copy()
    pixels[[10, 40]] += 8.0
    detections[3] = with_pixels(detections[3], pixels)
    result = found(detections)
    assert [(entry.detection.frame_index, entry.corners) for entry in result.left_out] == [(3, (10, 40))]
    assert len(result.views) == 20 and len(result.views[3].ids) == 52
    assert_lens(result, camera)


def test_board_upside_down_in_some_views_does_no_harm():
    camera = lens()
    detections = shown(camera, 20, 0.2, seed=3)
    for i in (2, 5, 11):  # corners named as if the board had been turned by half a turn
        detections[i] = replace(detections[i], ids=detections[i].ids[::-1].copy())
    result = found(detections)
    assert not result.left_out and result.verdict.grade != "redo"
    assert_lens(result, camera)


def test_few_views_of_another_board_are_left_out():
    camera = lens()
    other = shown(camera, 4, 0.2, seed=5, board=Checkerboard(9, 6, (0.025, 0.030)))
    detections = shown(camera, 16, 0.2, seed=6) + [replace(s, frame_index=16 + s.frame_index) for s in other]
    result = found(detections)
    assert {entry.detection.frame_index for entry in result.left_out if entry.whole} == {16, 17, 18, 19}
    assert_lens(result, camera)


def test_boards_mixed_half_and_half_are_no_calibration():
    camera = lens()
    other = shown(camera, 8, 0.2, seed=5, board=Checkerboard(9, 6, (0.025, 0.032)))
    detections = shown(camera, 8, 0.2, seed=6) + [replace(s, frame_index=8 + s.frame_index) for s in other]
    try:
        verdict = found(detections).verdict
    except InputError as refused:
        assert "contradict each other" in str(refused)
    else:
        assert verdict.grade != "good" and verdict.findings


def test_images_of_several_sizes_are_refused():
    detections = shown(lens(), 8, 0.2, seed=7)
    detections[5] = replace(detections[5], image_size=(1280, 960))
    with pytest.raises(InputError, match=r"cam01: the images have several sizes: 640 x 480 .* 1280 x 960 .*frame 5"):
        found(detections)


@pytest.mark.parametrize("count", [0, 2])
def test_too_few_views_are_refused(count):
    with pytest.raises(InputError, match=f"{count} views of the board can be used, 3 are the least.*20 or more"):
        found(shown(lens(), count, 0.2, seed=8))


def test_views_that_show_one_row_only_are_left_out():
    detections = shown(lens(), 12, 0.2, seed=10)
    detections[4] = replace(detections[4], ids=np.arange(9), pixels=detections[4].pixels[:9])
    detections[6] = replace(detections[6], ids=np.arange(5), pixels=detections[6].pixels[:5])
    reasons = {entry.detection.frame_index: entry.reason for entry in found(detections).left_out}
    assert reasons == {4: "shows corners on one line only", 6: "shows 5 corners only"}
