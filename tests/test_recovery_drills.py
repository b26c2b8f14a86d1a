"""What the recovery drills measure, on made-up tracks, and the poses they inject."""

import numpy as np
import pytest
import recovery
from drills import (
    LEFT_WITH_RIGHT,
    Outcome,
    arm_folded_away,
    good_spells,
    heading_flipped,
    is_good,
    sides_swapped,
    torso_beside,
)

from stick_figure.body import Body
from stick_figure.kinematics import forward
from virtual_studio.motions.catalogue import walk

BODY = Body.from_stature(1.75)
POSE = walk(BODY, 3.0, 10).poses[-1]
LEFT_HAND, LEFT_SHOULDER = 11, 3


def errors(*rows_m):
    """Errors (F, 15) with the same error for all points of a row."""
    return np.repeat(np.array(rows_m, float)[:, None], 15, axis=1)


def outcome(errors_m):
    return Outcome(np.zeros((len(errors_m), 15, 3)), errors_m, np.ones(len(errors_m), bool))


def test_a_track_is_bad_with_one_far_point_or_a_large_mean_or_none_at_all():
    one_far = errors(0.01)
    one_far[0, 4] = 0.25
    assert is_good(np.vstack([errors(0.01, 0.07, np.nan), one_far])).tolist() == [True, False, False, False]


def test_points_without_truth_do_not_count_against_a_track():
    partly = errors(0.01)
    partly[0, 3:] = np.nan
    assert is_good(partly).all()


def test_time_to_good_is_the_start_of_the_first_good_fifth_of_a_second():
    track = errors(*[0.5] * 10, *[0.01] * 5, 0.5, *[0.01] * 20)
    assert outcome(track).time_to_good(0, fps=50.0) == pytest.approx(16 / 50)
    assert outcome(track).time_to_good(16, fps=50.0) == 0.0
    assert outcome(track[:20]).time_to_good(0, fps=50.0) is None


def test_spells_tell_when_a_track_was_lost_and_found():
    track, seconds = errors(*[0.01] * 20, *[0.5] * 10, *[0.01] * 20, *[0.5] * 5), np.arange(55) / 50
    lost, found = good_spells(track, seconds)
    assert lost == [pytest.approx(0.4), pytest.approx(1.0)]
    assert found == [pytest.approx(0.6)]


def test_flipped_heading_keeps_the_torso_and_mirrors_everything_through_its_axis():
    points, flipped = forward(BODY, POSE), forward(BODY, heading_flipped(BODY, POSE))
    np.testing.assert_allclose(flipped[0], points[0], atol=1e-12)
    np.testing.assert_allclose((flipped + points)[:, :2], np.tile(2 * points[0, :2], (15, 1)), atol=1e-9)
    np.testing.assert_allclose(flipped[:, 2], points[:, 2], atol=1e-9)


def test_swapped_sides_are_the_same_points_under_the_other_names():
    swapped = forward(BODY, sides_swapped(BODY, POSE))
    np.testing.assert_allclose(swapped, forward(BODY, POSE)[LEFT_WITH_RIGHT], atol=1e-6)


def test_folded_arm_and_displaced_torso_are_wrong_by_what_they_say():
    points, folded = forward(BODY, POSE), forward(BODY, arm_folded_away(BODY, POSE))
    assert np.linalg.norm(folded[LEFT_HAND] - folded[LEFT_SHOULDER]) < 0.3
    np.testing.assert_allclose(np.delete(folded, [7, 11], 0), np.delete(points, [7, 11], 0), atol=1e-12)
    beside = forward(BODY, torso_beside(BODY, POSE))
    np.testing.assert_allclose(np.linalg.norm(beside - points, axis=1), 0.4, atol=1e-12)


def test_drills_at_several_moments_give_the_median_and_the_longest_time():
    runs = [{"recovered_s": t, "mean_mm": 8.0 + t, "bad": 0.1, "bad_but_sure": 0.0} for t in (0.5, 0.1, 0.2)]
    assert recovery.together(runs[:1]) is runs[0]
    found = recovery.together(runs)
    assert (found["recovered_s"], found["longest_s"]) == (0.2, 0.5)
    assert found["mean_mm"] == pytest.approx(8.267, abs=1e-3)
    never = {**runs[0], "recovered_s": None, "mean_mm": None}
    found = recovery.together([*runs, never])
    assert found["longest_s"] is None and found["recovered_s"] == pytest.approx(0.35)
