"""Sizes of targets compared with one another, and targets whose turns a picture does not show."""

from dataclasses import replace

import bundle_studio as studio
import numpy as np
import pytest

from rig_calibration.boards.board import Checkerboard
from rig_calibration.bundle.initial_poses import comparable_targets
from rig_calibration.bundle.problem import target_shape
from rig_calibration.bundle.solve import solve_rig

CAMERAS = studio.ring(4)


@pytest.mark.parametrize("factor", [1.0, 1.05, 1.25])
def test_size_of_the_floor_board_is_measured_by_that_of_the_board_seen_most(factor: float):
    detections = studio.carried_and_floor(CAMERAS, np.random.default_rng(1), 20)
    given = {**studio.TARGETS, "floor": studio.TARGETS["floor"] * factor}
    solution = solve_rig(CAMERAS, detections, given, reference=studio.ON_FLOOR)
    ratio, sd = solution.scale_of["floor"]
    assert ratio * factor == pytest.approx(1.0, abs=3 * sd * factor) and sd * factor < 0.002
    assert solution.scale_base == "moving" and solution.left_out == ()
    assert (
        studio.worst(studio.errors(solution, studio.truth(CAMERAS)))[0] < 6
    )  # the size of the board seen most is the one believed


def test_target_seen_only_where_no_other_links_the_cameras_is_not_compared():
    detections = studio.carried_and_floor(CAMERAS, np.random.default_rng(1), 20)
    apart = [s for s in detections if s.target == "floor" or s.camera in ("cam01", "cam02")]
    assert comparable_targets(apart, ["floor", "moving"], "moving").tolist() == [True, False]
    apart = [s for s in apart if s.target == "moving" or s.camera in ("cam03", "cam04", "cam02")]
    assert not comparable_targets(apart, ["floor", "moving"], "moving").any()


def test_hidden_half_turns_are_settled_by_what_cameras_agree_on():
    rng = np.random.default_rng(3)
    detections = studio.carried_and_floor(CAMERAS, np.random.default_rng(1), 20)
    upset = [s.target == "moving" and rng.random() < 0.5 for s in detections]
    mixed = [replace(s, ids=s.ids[::-1].copy()) if u else s for s, u in zip(detections, upset, strict=True)]
    expected = solve_rig(CAMERAS, detections, studio.TARGETS, reference=studio.ON_FLOOR)
    found = solve_rig(CAMERAS, mixed, studio.TARGETS, reference=studio.ON_FLOOR, symmetry_orders={"moving": 2})
    assert found.undecided == () and found.left_out == ()
    for name in CAMERAS:
        np.testing.assert_allclose(found.T_camera_reference[name], expected.T_camera_reference[name], atol=1e-7)


def test_quarter_turns_of_a_square_board_are_settled():
    board = Checkerboard(6, 6, (0.07, 0.07))

    symmetries = target_shape("", board.corners_board, 4).symmetries
    rng = np.random.default_rng(2)
    detections = studio.detections_of(CAMERAS, studio.carried(rng, 30), "moving", rng, points=board.corners_board)
    mixed = [replace(s, ids=symmetries[rng.integers(4)].permutation[s.ids]) for s in detections]
    found = solve_rig(CAMERAS, mixed, {"moving": board.corners_board}, symmetry_orders={"moving": 4})
    assert studio.worst(studio.errors(found, studio.truth(CAMERAS, "cam01"), "cam01"))[0] < 10


def test_half_turn_that_a_single_floor_board_cannot_tell_is_said_to_be_undecided():
    floor = studio.detections_of(CAMERAS, {0: studio.T_WORLD_FLOOR}, "floor", np.random.default_rng(0), max_tilt_deg=85)
    told = solve_rig(CAMERAS, floor, {"floor": studio.TARGETS["floor"]}, reference=studio.ON_FLOOR)
    hidden = solve_rig(
        CAMERAS, floor, {"floor": studio.TARGETS["floor"]}, reference=studio.ON_FLOOR, symmetry_orders={"floor": 2}
    )
    assert told.undecided == () and hidden.undecided == tuple(CAMERAS)
    assert studio.worst(studio.errors(hidden, studio.truth(CAMERAS)))[0] < 20  # the numbering is left as it came
