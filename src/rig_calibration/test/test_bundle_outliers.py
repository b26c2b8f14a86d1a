"""Detections that contradict the rest are left out by name, and the rig is the same as without them."""

from dataclasses import replace

import bundle_studio as studio
import numpy as np
import pytest

from capture_rig.errors import InputError
from rig_calibration.boards.board import TargetDetection
from rig_calibration.bundle.outliers import ODD_ONE, PAIR, SINGLE
from rig_calibration.bundle.solve import RigSolution, solve_rig

CAMERAS = studio.ring(4)
SHIFT_PX = np.array([12.0, 5.0])


def scene(seed: int = 1, frames: int = 20) -> list[TargetDetection]:
    return studio.carried_and_floor(CAMERAS, np.random.default_rng(seed), frames)


def seen_by(detections: list[TargetDetection], cameras: int) -> list[int]:
    """Rows of the first frame of the carried board that so many cameras see."""
    for frame_index in range(100):
        rows = [i for i, s in enumerate(detections) if (s.target, s.frame_index) == ("moving", frame_index)]
        if len(rows) == cameras:
            return rows
    raise AssertionError("no such frame")


def solved(detections: list[TargetDetection]) -> tuple[RigSolution, set[tuple[str, str, int, str]]]:
    solution = solve_rig(CAMERAS, detections, studio.TARGETS, reference=studio.ON_FLOOR)
    left_out = {(o.detection.camera, o.detection.target, o.detection.frame_index, o.reason) for o in solution.left_out}
    centre_mm, rotation_deg = studio.worst(studio.errors(solution, studio.truth(CAMERAS)))
    assert centre_mm < 6 and rotation_deg < 0.12  # no worse than without the bad detections
    return solution, left_out


def named(detection: TargetDetection, reason: str) -> tuple[str, str, int, str]:
    return detection.camera, detection.target, detection.frame_index, reason


def test_clean_footage_loses_nothing():
    assert solved(scene())[1] == set()


def upside_down(detection: TargetDetection) -> TargetDetection:
    return replace(detection, ids=detection.ids[::-1].copy())


def shifted(detection: TargetDetection) -> TargetDetection:
    return replace(detection, pixels=detection.pixels + SHIFT_PX)


@pytest.mark.parametrize(
    ("camera", "target", "spoilt"), [(1, "moving", upside_down), (2, "floor", upside_down), (0, "moving", shifted)]
)
def test_one_view_of_several_that_is_upside_down_or_moved_is_named(camera: int, target: str, spoilt):
    detections = scene()
    on_floor = [i for i, s in enumerate(detections) if s.target == "floor"]
    row = (on_floor if target == "floor" else seen_by(detections, 3))[camera]
    detections[row] = spoilt(detections[row])
    assert solved(detections)[1] == {named(detections[row], ODD_ONE)}


def test_board_seen_upside_down_by_one_of_two_cameras_does_no_harm():
    detections = scene()
    rows = seen_by(detections, 2)
    detections[rows[0]] = upside_down(detections[rows[0]])
    left_out = {place[:3] for place in solved(detections)[1]}  # at least one of them: what is left ties nothing
    assert left_out and left_out <= {named(detections[row], "")[:3] for row in rows}


def test_both_views_go_when_the_board_moved_between_two_exposures():
    detections = scene(frames=30)
    rows = [i for i, s in enumerate(detections) if (s.target, s.frame_index) == ("moving", 19)]
    detections[rows[0]] = shifted(detections[rows[0]])
    assert solved(detections)[1] == {named(detections[row], PAIR) for row in rows}


def test_corners_in_wrong_order_are_blamed_on_their_own_view():
    detections = scene()
    row = seen_by(detections, 2)[1]
    order = np.random.default_rng(0).permutation(30)
    detections[row] = replace(detections[row], pixels=detections[row].pixels[order])
    assert solved(detections)[1] == {named(detections[row], SINGLE)}


def test_one_wrong_corner_does_not_cost_the_view():
    detections = scene()
    row = seen_by(detections, 2)[0]
    pixels = detections[row].pixels.copy()
    pixels[7] += [25, -16]
    detections[row] = replace(detections[row], pixels=pixels)
    solution, left_out = solved(detections)
    assert left_out == set() and len(solution.detections) == len(detections)


def test_every_sixth_detection_wrong_leaves_a_good_rig():
    detections, rng, wrong = scene(2, 40), np.random.default_rng(5), set()
    for row in rng.choice(len(detections), len(detections) // 6, replace=False):
        if detections[row].target == "moving":
            detections[row] = replace(detections[row], pixels=detections[row].pixels + 25 * rng.normal(size=2))
            wrong.add((detections[row].camera, detections[row].frame_index))
    solution, left_out = solved(detections)
    alone = {
        s.frame_index
        for s in detections
        if sum(o.frame_index == s.frame_index and o.target == "moving" for o in detections) == 1
    }
    assert {w for w in wrong if w[1] not in alone} <= {(camera, frame_index) for camera, _, frame_index, _ in left_out}
    assert max(solution.rms_px.values()) < 0.35


def test_camera_whose_every_view_contradicts_is_an_error_with_the_reason():
    rng = np.random.default_rng(0)
    detections = studio.detections_of(CAMERAS, {0: studio.T_WORLD_FLOOR}, "floor", rng, max_tilt_deg=85)
    detections += [replace(s, frame_index=1, target="second") for s in detections]
    for row, s in enumerate(detections):
        if s.camera == "cam04":
            order = np.random.default_rng(row).permutation(len(s))
            detections[row] = replace(s, pixels=s.pixels[order])
    with pytest.raises(InputError, match=r"cam04: no picture.*Left out for cam04: its corners"):
        solve_rig(CAMERAS, detections, {"floor": studio.TARGETS["floor"], "second": studio.TARGETS["floor"]})
