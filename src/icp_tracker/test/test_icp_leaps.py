"""Limbs that leap where no motion leads to: kept where they were expected, or not seen."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from test_icp_contour_rays import grazing_rays
from test_icp_track_monitor import FOLDED, FPS, LEFT_HAND, STANCE, data_of, inside_of, posed

from icp_tracker.articulated_fit import ArticulatedSettings
from icp_tracker.monitor.evidence import evidence_of
from icp_tracker.monitor.leaps import (
    MOST_M_S,
    NEAR_M,
    RecentRays,
    expected_on_trunk,
    kept_limb,
    leaps_of_limbs,
    reach_m,
)
from icp_tracker.monitor.pose_library import LIMBS
from icp_tracker.monitor.track_monitor import RecoverySettings, TrackMonitor
from icp_tracker.monitor.track_quality import points_of_limbs, with_torn_limbs
from mocap_packets.fit import DOUBTFUL, GOOD, PART_POINTS, TrackQuality
from stick_figure.body import Body
from stick_figure.kinematics import forward
from stick_figure.least_squares.contour_factor import match_rays
from stick_figure.least_squares.placed_figure import Figure, State, place

DT = 1.0 / FPS
LEFT_ARM_LIMB = LIMBS[0]


@pytest.fixture(scope="module")
def person():
    body, pose = Body.from_stature(1.75), posed(STANCE)
    rays, inside = grazing_rays(body, pose, np.random.default_rng(8), 50), inside_of(body, pose)
    return SimpleNamespace(body=body, pose=pose, rays=rays, inside=inside)


def without_arm(person, share):
    """The set's data with a share of the left arm's rays gone."""
    data, figure = data_of(person), Figure.of(person.body)
    match = match_rays(data.contour_rays, place(State.of(person.pose), figure), 0.05)
    own = np.isin(figure.surface.stick[match.capsule], [LEFT_ARM_LIMB.upper, LEFT_ARM_LIMB.lower])
    kept = ~own | (np.cumsum(own) % 10 >= 10 * share)
    return data._replace(contour_rays=data.contour_rays.chosen(kept, data.contour_rays.information[kept]))


@pytest.mark.parametrize("dt", [1 / 100, 1 / 60, 1 / 30, 1 / 12])
def test_a_fist_that_stops_dead_does_not_leap(dt):
    """At 9 m/s (Walilko et al. 2005, Olympic boxers) within a thirtieth of a second."""
    speed, deceleration = 9.0, 270.0
    slowed = min(dt, speed / deceleration)
    short_of_m = speed * dt - (speed * slowed - 0.5 * deceleration * slowed**2)
    assert max(short_of_m, NEAR_M) < reach_m(dt) <= MOST_M_S * dt


def leaps_of(body, pose, expected):
    return leaps_of_limbs(forward(body, pose), expected_on_trunk(body, pose, expected))


def test_leaps_are_those_of_the_limb_and_not_of_the_body(person):
    moved = replace(person.pose, position_world=person.pose.position_world + 0.5)
    assert leaps_of(person.body, moved, person.pose).max() < 1e-9
    leaps = leaps_of(person.body, posed(FOLDED, person.pose), person.pose)
    assert leaps[0] > reach_m(DT) and leaps[1:].max() < 1e-9


def test_a_limb_that_leapt_away_from_its_rays_is_kept_where_it_was_expected(person):
    leapt, data = posed(FOLDED, person.pose), data_of(person)
    kept = kept_limb(person.body, leapt, person.pose, LEFT_ARM_LIMB, data)
    off = np.linalg.norm(forward(person.body, kept) - forward(person.body, person.pose), axis=1)
    assert off[LEFT_HAND] < 0.06
    others = [point for point in range(15) if point not in PART_POINTS[LEFT_ARM_LIMB.part]]
    assert off[others].max() < 1e-9


def test_a_limb_that_found_its_own_rays_is_let_go(person):
    assert kept_limb(person.body, person.pose, posed(FOLDED, person.pose), LEFT_ARM_LIMB, data_of(person)) is None


def test_the_monitor_keeps_it_and_goes_on_looking_at_where_it_leapt(person):
    monitor, data, settings = TrackMonitor(RecoverySettings()), data_of(person), ArticulatedSettings()
    monitor.examine(0, person.body, person.pose, data, settings, person.pose)
    leapt = posed(FOLDED, person.pose)
    found = monitor.examine(round(DT * 1e9), person.body, leapt, data, settings, person.pose)
    assert found.better is None and found.quality.state == GOOD
    kept = forward(person.body, found.kept)[LEFT_HAND]
    assert np.linalg.norm(kept - forward(person.body, person.pose)[LEFT_HAND]) < 0.06
    unknown = monitor.examine(round(2 * DT * 1e9), person.body, person.pose, data, settings, None)
    assert unknown.kept is None  # nothing was expected


def test_a_limb_whose_rays_go_as_it_leaves_is_not_seen_for_a_moment(person):
    figure, recent = Figure.of(person.body), RecentRays()
    whole = evidence_of(figure, person.pose, data_of(person))
    torn = evidence_of(figure, person.pose, without_arm(person, 0.6))
    away, still = np.array([0.12, 0.0, 0.0, 0.0]), np.zeros(4)
    assert not recent.torn(torn, away, DT).any()  # nothing is known yet
    for _ in range(10):
        recent.add(whole, DT)
    assert list(recent.torn(torn, away, DT)) == [True, False, False, False]
    assert not recent.torn(torn, still, DT).any() and not recent.torn(whole, away, DT).any()
    for _ in range(10):
        recent.add(torn, DT)
    assert not recent.torn(torn, away, DT).any()  # that is how it looks now


def test_a_torn_limb_is_doubtful_and_its_points_are_not_seen():
    torn = np.array([True, False, False, False])
    quality = with_torn_limbs(TrackQuality(GOOD, "", (GOOD,) * 5, 0.9), torn)
    assert quality.state == DOUBTFUL and quality.reason == "left arm: its rays are gone"
    assert quality.parts == (GOOD, DOUBTFUL, GOOD, GOOD, GOOD)
    assert list(np.flatnonzero(points_of_limbs(torn))) == sorted(PART_POINTS[LEFT_ARM_LIMB.part])
    assert with_torn_limbs(quality, np.zeros(4, bool)) is quality
