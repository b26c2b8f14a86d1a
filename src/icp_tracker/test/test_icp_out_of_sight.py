"""Limbs beyond what the cameras show: doubtful at once, left alone, and not measured."""

from types import SimpleNamespace

import numpy as np
import pytest
from test_icp_contour_rays import grazing_rays
from test_icp_track_monitor import FOLDED, FPS, LEFT_HAND, STANCE, data_of, inside_of, posed

from capture_rig.visibility import CELL_M, UnseenCells
from icp_tracker.articulated_fit import ArticulatedSettings
from icp_tracker.monitor.evidence import LEFT_ARM, SLACK_M, TRUNK, evidence_of
from icp_tracker.monitor.out_of_sight import is_cut, limbs_of_points, points_out_of_sight, with_hidden_parts
from icp_tracker.monitor.pose_library import LIMBS
from icp_tracker.monitor.track_monitor import CHECKS, RecoverySettings, TrackMonitor
from icp_tracker.monitor.track_quality import unchecked_quality
from mocap_packets.fit import DOUBTFUL, GOOD, PART_NAMES, TrackQuality
from stick_figure.body import Body
from stick_figure.kinematics import forward
from stick_figure.least_squares.contour_factor import match_rays
from stick_figure.least_squares.placed_figure import Figure, State, place

NOTHING_SHOWN, ALL_SHOWN = np.zeros(5, bool), np.ones(5, bool)
LEFT_ELBOW = 7


@pytest.fixture(scope="module")
def person():
    body, pose = Body.from_stature(1.75), posed(STANCE)
    rays, inside = grazing_rays(body, pose, np.random.default_rng(8), 50), inside_of(body, pose)
    return SimpleNamespace(body=body, pose=pose, rays=rays, inside=inside)


def beyond(y):
    """A room of four metres of which nothing is seen from y (m) on."""
    cells = np.zeros((80, 80, 50), bool)
    cells[:, round((y + 2.0) / CELL_M) :] = True
    return UnseenCells(np.array([-2.0, -2.0, 0.0]), cells)


def wall_through_the_left_forearm(person):
    points = forward(person.body, person.pose)
    return beyond(0.5 * (points[LEFT_ELBOW, 1] + points[LEFT_HAND, 1]))


def without_left_arm(person, data):
    """The set's rays without those of the left arm."""
    figure, limb = Figure.of(person.body), LIMBS[0]
    match = match_rays(data.contour_rays, place(State.of(person.pose), figure), SLACK_M)
    kept = ~np.isin(figure.surface.stick[match.capsule], [limb.upper, limb.lower])
    return data.contour_rays.chosen(kept, data.contour_rays.information[kept])


def test_a_hand_beyond_the_wall_is_out_of_sight_and_nothing_else(person):
    points, wall = forward(person.body, person.pose), wall_through_the_left_forearm(person)
    hidden = points_out_of_sight(points, None, wall, NOTHING_SHOWN)
    assert list(np.flatnonzero(hidden)) == [LEFT_HAND]
    assert list(np.flatnonzero(limbs_of_points(hidden))) == [0] and not is_cut(hidden)
    quality = with_hidden_parts(TrackQuality(GOOD, "", (GOOD,) * 5, 0.9), hidden)
    assert quality.parts == tuple(DOUBTFUL if part == LEFT_ARM else GOOD for part in range(5))
    assert quality.reason == "left arm: beyond what the cameras show"


def test_a_limb_that_has_its_rays_is_in_sight_wherever_the_wall_is(person):
    points, wall = forward(person.body, person.pose), wall_through_the_left_forearm(person)
    hidden = points_out_of_sight(points, None, wall, ALL_SHOWN)
    assert not hidden.any()


def test_a_limb_counts_where_it_was_expected_too(person):
    wall, folded = wall_through_the_left_forearm(person), forward(person.body, posed(FOLDED, person.pose))
    assert not points_out_of_sight(folded, None, wall, NOTHING_SHOWN)[LEFT_HAND]
    assert points_out_of_sight(folded, forward(person.body, person.pose), wall, NOTHING_SHOWN)[LEFT_HAND]


def test_a_body_half_beyond_the_wall_is_cut(person):
    middle = forward(person.body, person.pose)[0, 1]
    hidden = points_out_of_sight(forward(person.body, person.pose), None, beyond(middle - 0.1), NOTHING_SHOWN)
    assert is_cut(hidden)
    quality = with_hidden_parts(TrackQuality(GOOD, "", (GOOD,) * 5, 0.9), hidden)
    assert quality.parts[TRUNK] == DOUBTFUL and PART_NAMES[TRUNK] in quality.reason


def test_an_arm_that_leaves_the_volume_is_doubtful_at_once_and_is_not_moved_to_what_is_left_over(person):
    """Its rays go within one set. What else the hull holds near the shoulder is no place for it."""
    monitor, settings, figure = TrackMonitor(RecoverySettings()), ArticulatedSettings(), Figure.of(person.body)
    whole, wall = data_of(person), wall_through_the_left_forearm(person)
    for k in range(10):
        monitor.examine(round(k / FPS * 1e9), person.body, person.pose, whole, settings, person.pose)
    gone = whole._replace(hull=whole.hull._replace(unseen=wall), contour_rays=without_left_arm(person, whole))
    assert evidence_of(figure, person.pose, gone).rays < evidence_of(figure, person.pose, whole).rays
    for k in range(10, 20):
        found = monitor.examine(round(k / FPS * 1e9), person.body, person.pose, gone, settings, person.pose)
        assert found.quality.parts[LEFT_ARM] == DOUBTFUL and found.unseen[LEFT_HAND]
        assert found.better is None


def test_a_body_that_was_lost_is_believed_when_other_poses_have_been_tried(person):
    monitor, settings, data = TrackMonitor(RecoverySettings()), ArticulatedSettings(), data_of(person)
    unchecked = []
    for k in range(30):
        if k == 5:
            monitor.lose()
        found = monitor.examine(round(k / FPS * 1e9), person.body, person.pose, data, settings, person.pose)
        assert found.better is None and found.quality.state == GOOD  # its covariance is as it was
        unchecked.append(found.unchecked)
    assert unchecked == [False] * 5 + [True] * (CHECKS - 1) + [False] * (30 - 5 - CHECKS + 1)
    told = unchecked_quality(found.quality)
    assert told.parts == (DOUBTFUL,) * 5 and "other poses are being tried" in told.reason
