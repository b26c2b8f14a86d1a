"""Sightings that contradict the rest are left out by name, and the rig is the same as without them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from bundle_studio import T_WORLD_FLOOR, TARGETS, carried_and_floor, errors, ring, sightings_of, truth, worst

from capture_rig.errors import InputError
from rig_calibration.boards.sighting import Sighting
from rig_calibration.bundle.outliers import ODD_ONE, PAIR, SINGLE, TURNED
from rig_calibration.bundle.solution import RigSolution
from rig_calibration.bundle.solve import solve_rig

CAMERAS = ring(4)
SHIFT_PX = np.array([12.0, 5.0])


def scene(seed: int = 1, moments: int = 20) -> list[Sighting]:
    return carried_and_floor(CAMERAS, np.random.default_rng(seed), moments)


def seen_by(sightings: list[Sighting], cameras: int) -> list[int]:
    """Rows of the first moment of the carried board that so many cameras see."""
    for moment in range(100):
        rows = [i for i, s in enumerate(sightings) if (s.target, s.moment) == ("moving", moment)]
        if len(rows) == cameras:
            return rows
    raise AssertionError("no such moment")


def solved(sightings: list[Sighting]) -> tuple[RigSolution, set[tuple[str, str, int, str]]]:
    solution = solve_rig(CAMERAS, sightings, TARGETS, reference="floor")
    left_out = {(o.sighting.camera, o.sighting.target, o.sighting.moment, o.reason) for o in solution.left_out}
    centre_mm, rotation_deg = worst(errors(solution, truth(CAMERAS)))
    assert centre_mm < 6 and rotation_deg < 0.12  # no worse than without the bad sightings
    return solution, left_out


def named(sighting: Sighting, reason: str) -> tuple[str, str, int, str]:
    return sighting.camera, sighting.target, sighting.moment, reason


def test_clean_footage_loses_nothing():
    assert solved(scene())[1] == set()


def test_board_seen_upside_down_by_one_of_three_cameras_is_named():
    sightings = scene()
    row = seen_by(sightings, 3)[1]
    sightings[row] = replace(sightings[row], ids=sightings[row].ids[::-1].copy())
    assert solved(sightings)[1] == {named(sightings[row], TURNED)}


def test_floor_board_numbered_from_the_other_end_in_one_view_is_named():
    sightings = scene()
    row = next(i for i, s in enumerate(sightings) if s.target == "floor" and s.camera == "cam03")
    sightings[row] = replace(sightings[row], ids=sightings[row].ids[::-1].copy())
    assert solved(sightings)[1] == {named(sightings[row], TURNED)}


def test_both_views_go_when_one_of_two_is_upside_down():
    sightings = scene()
    rows = seen_by(sightings, 2)
    sightings[rows[0]] = replace(sightings[rows[0]], ids=sightings[rows[0]].ids[::-1].copy())
    assert solved(sightings)[1] == {named(sightings[row], TURNED) for row in rows}


def test_board_that_moved_before_one_of_three_exposures_is_named():
    sightings = scene()
    row = seen_by(sightings, 3)[0]
    sightings[row] = replace(sightings[row], pixels=sightings[row].pixels + SHIFT_PX)
    assert solved(sightings)[1] == {named(sightings[row], ODD_ONE)}


def test_both_views_go_when_the_board_moved_between_two_exposures():
    sightings = scene(moments=30)
    rows = [i for i, s in enumerate(sightings) if (s.target, s.moment) == ("moving", 19)]
    sightings[rows[0]] = replace(sightings[rows[0]], pixels=sightings[rows[0]].pixels + SHIFT_PX)
    assert solved(sightings)[1] == {named(sightings[row], PAIR) for row in rows}


def test_corners_in_wrong_order_are_blamed_on_their_own_view():
    sightings = scene()
    row = seen_by(sightings, 2)[1]
    order = np.random.default_rng(0).permutation(30)
    sightings[row] = replace(sightings[row], pixels=sightings[row].pixels[order])
    assert solved(sightings)[1] == {named(sightings[row], SINGLE)}


def test_one_wrong_corner_does_not_cost_the_view():
    sightings = scene()
    row = seen_by(sightings, 2)[0]
    pixels = sightings[row].pixels.copy()
    pixels[7] += [25, -16]
    sightings[row] = replace(sightings[row], pixels=pixels)
    solution, left_out = solved(sightings)
    assert left_out == set() and len(solution.sightings) == len(sightings)


def test_every_sixth_sighting_wrong_leaves_a_good_rig():
    sightings, rng, wrong = scene(2, 40), np.random.default_rng(5), set()
    for row in rng.choice(len(sightings), len(sightings) // 6, replace=False):
        if sightings[row].target == "moving":
            sightings[row] = replace(sightings[row], pixels=sightings[row].pixels + 25 * rng.normal(size=2))
            wrong.add((sightings[row].camera, sightings[row].moment))
    solution, left_out = solved(sightings)
    alone = {s.moment for s in sightings if sum(o.moment == s.moment and o.target == "moving" for o in sightings) == 1}
    assert {w for w in wrong if w[1] not in alone} <= {(camera, moment) for camera, _, moment, _ in left_out}
    assert solution.rms_all_px < 0.35


def test_camera_whose_every_view_contradicts_is_an_error_with_the_reason():
    rng = np.random.default_rng(0)
    sightings = sightings_of(CAMERAS, {0: T_WORLD_FLOOR}, "floor", rng, max_tilt_deg=85)
    sightings += [replace(s, moment=1, target="second") for s in sightings]
    for row, s in enumerate(sightings):
        if s.camera == "cam04":
            order = np.random.default_rng(row).permutation(len(s))
            sightings[row] = replace(s, pixels=s.pixels[order])
    with pytest.raises(InputError, match=r"cam04: no picture.*Left out for cam04: its corners"):
        solve_rig(CAMERAS, sightings, {"floor": TARGETS["floor"], "second": TARGETS["floor"]})
