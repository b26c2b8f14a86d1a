"""Which views are kept, what is said about the others, and when it is enough."""

from dataclasses import replace

import cv2
import numpy as np
import pytest
from intrinsics_views import BOARD, found, lens, shown

from capture_rig.errors import InputError
from rig_calibration.intrinsics.lens_model import LensModel
from rig_calibration.intrinsics.selection import ViewCollector, coverage_of, view_of


def jittered(detection, frame_index, blur_px=0.0):
    """The same view a frame later."""
    shake = np.random.default_rng(0).normal(0, 0.2, detection.pixels.shape)
    return replace(detection, pixels=detection.pixels + shake, frame_index=frame_index, blur_px=blur_px)


def test_views_alike_are_taken_once_and_the_sharper_one_stays():
    view = replace(shown(lens(), 1, 0.1, seed=1)[0], blur_px=0.5)
    collector = ViewCollector(BOARD, "cam01")
    assert collector.try_add(view) == ""
    assert "like one that is there already" in collector.try_add(jittered(view, 1, blur_px=0.5))
    assert len(collector) == 1
    assert collector.try_add(jittered(view, 2, blur_px=0.1)) == ""
    assert [detection.frame_index for detection in collector.detections] == [2]
    chosen = ViewCollector(BOARD, "cam01", every=True)  # by hand: taken whatever they show
    assert chosen.try_add(view) == "" == chosen.try_add(jittered(view, 1))


@pytest.mark.parametrize(
    "count, blur_px, said",
    [(54, 3.0, "too blurred: by 3.0 px"), (5, 0.5, "shows 5 corners only"), (9, 0.5, "its pose cannot be told")],
)
def test_boards_that_tell_too_little_are_refused_with_the_reason(count, blur_px, said):
    collector = ViewCollector(BOARD, "cam01")
    view = shown(lens(), 1, 0.1, seed=1)[0]
    view = replace(view, ids=view.ids[:count], pixels=view.pixels[:count], blur_px=blur_px)
    assert said in collector.try_add(view) and len(collector) == 0


def test_images_of_several_sizes_are_refused():
    collector, (view,) = ViewCollector(BOARD, "cam01"), shown(lens(), 1, 0.1, seed=1)
    collector.try_add(view)
    with pytest.raises(InputError, match=r"cam01: the images have several sizes: .*640.* frame 0, .*1280.* frame 5"):
        collector.try_add(replace(view, image_size=(1280, 960), frame_index=5))


def test_collecting_ends_when_everything_is_covered_by_enough_views_to_know_the_lens():
    camera, collector = lens(), ViewCollector(BOARD, "cam01")
    for view in shown(camera, 120, 0.1, seed=3):
        assert not collector.enough and collector.advice()
        collector.try_add(replace(view, blur_px=0.5))
        if collector.enough:
            break
    assert collector.enough and collector.advice() == "" and 12 <= len(collector) < 80
    result = found(collector.detections)
    assert result.sd["fx"] / result.values["fx"] < 0.001 and result.sd["cx"] < 1.0
    assert result.values["fx"] == pytest.approx(camera.K[0, 0], rel=0.003)


def test_untilted_boards_are_never_enough_and_the_advice_is_to_tilt():
    collector = ViewCollector(BOARD, "cam01")
    for view in shown(lens(), 10, 0.1, seed=4, tilt_deg=3.0, sizes=(0.2, 0.8)):
        collector.try_add(view)
    assert not collector.enough
    assert "tilt the board by 30 to 45 degrees, its" in collector.advice()


def test_advice_names_the_part_of_the_image_that_lacks_most():
    detections = [s for s in shown(lens(), 100, 0.1, seed=5, sizes=(0.2, 0.4)) if s.pixels[:, 0].min() > 330]
    start = LensModel("plumb_bob").camera("cam01", 467.0, (640, 480))
    coverage = coverage_of([view_of(detection, BOARD, start) for detection in detections])
    assert 0.3 < coverage.cells.mean() < 0.6
    assert "left" in coverage.advice()


@pytest.mark.parametrize("side, axis, sign", [("top", 0, 1), ("bottom", 0, -1), ("left", 1, -1), ("right", 1, 1)])
def test_tilt_is_named_by_the_side_that_comes_nearer(side, axis, sign):
    """Independent of the code: the named side of the board has the smallest depth."""
    tilt = np.zeros(3)
    tilt[axis] = sign * np.deg2rad(30)
    R = cv2.Rodrigues(tilt)[0] @ np.diag([1.0, -1.0, -1.0])
    camera, corners = lens(), BOARD.corners_board - BOARD.corners_board.mean(axis=0)
    points = corners @ R.T + [0, 0, 0.5]
    nearest = points[np.argmin(points[:, 2])]
    assert {"top": nearest[1] < 0, "bottom": nearest[1] > 0, "left": nearest[0] < 0, "right": nearest[0] > 0}[side]
    detection = replace(shown(camera, 1, 0.1, seed=1)[0], pixels=camera.project(points), ids=np.arange(54))
    start = LensModel("plumb_bob").camera("cam01", 467.0, (640, 480))
    tilts = coverage_of([view_of(detection, BOARD, start)]).tilt_deg
    assert max(tilts, key=tilts.get) == side and tilts[side] == pytest.approx(30, abs=4)
