"""Frame sets over stamps that step, lag, drift or begin anew: one camera never moves the rig's time, most do."""

import dataclasses
from itertools import pairwise

import pytest
from frame_traffic import (
    CAMERAS,
    EPOCH,
    HOUR,
    PERIOD,
    SECOND,
    TOLERANCE,
    TWO,
    assert_conserved,
    instants_of,
    make_collector,
    send,
)
from hypothesis import given, settings
from hypothesis import strategies as st

SHIFTS = (-HOUR, -2 * SECOND, 0, 0, 0, 2 * SECOND, HOUR)
ODD_FRAMES = st.tuples(
    st.sampled_from(CAMERAS), st.sampled_from(SHIFTS), st.integers(0, 6 * PERIOD), st.integers(0, PERIOD)
)


@settings(max_examples=200)
@given(st.lists(ODD_FRAMES, max_size=60), st.integers(1, 8))
def test_counts_are_conserved_and_sets_coherent_whatever_the_stamps(frames, max_open):
    collector = make_collector(max_open=max_open)
    sets, now = [], 0
    for index, (camera, shift, offset, wait) in enumerate(frames):
        now += wait
        sets += collector.add(camera, EPOCH + shift + offset, (camera, index), now)
    sets += collector.flush()
    assert collector.next_deadline_ns() is None
    assert_conserved(collector, sets)
    emitted = [frame for each in sets for frame in each.frames.values()]
    assert len(emitted) == len(set(emitted))
    assert all(each.spread_ns <= TOLERANCE for each in sets)
    goes_back = sum(b.stamp_ns <= a.stamp_ns for a, b in pairwise(sets))
    assert goes_back <= collector.counters.restarts


def test_footage_started_again_begins_a_new_timeline_at_once_and_loses_nothing():
    collector = make_collector()
    first = send(collector, range(120))
    assert send(collector, [0], TWO, later=121) == []
    second = send(collector, [0], ["cam03"], later=121.1)
    assert instants_of(second) == [0]  # leaves with its last frame
    second += send(collector, range(1, 5), later=121)
    assert instants_of(first + second) == [*range(120), *range(5)]
    assert all(not each.missing for each in second)
    counted = {name: count for name, count in dataclasses.asdict(collector.counters).items() if count}
    assert counted == {"frames": 375, "complete": 125, "restarts": 1}


def test_footage_started_again_after_a_camera_died_goes_on_without_it():
    collector = make_collector()
    send(collector, range(100))
    sets = send(collector, range(100, 120), TWO) + send(collector, range(10), TWO, later=121) + collector.flush()
    assert instants_of(sets) == [*range(100, 120), *range(10)]
    assert collector.counters.backwards == collector.counters.late == 0


@pytest.mark.parametrize(
    ("camera", "shift", "off", "end", "counted"),
    [
        ("cam03", -HOUR, range(100, 140), 140, {"backwards": 40}),
        ("cam03", HOUR, range(100), 100, {"ahead": 100}),
        ("cam01", HOUR, range(10, 11), 60, {"ahead": 1}),
    ],
    ids=["back for good", "ahead for good", "ahead for a frame"],
)
def test_camera_whose_stamps_are_off_costs_its_own_frames_alone(camera, shift, off, end, counted):
    collector = make_collector()
    sets = send(collector, range(off.start)) + send(collector, off, **{camera: shift})
    sets += send(collector, range(off.stop, end)) + collector.poll(200 * PERIOD) + collector.flush()
    assert instants_of(sets) == list(range(end))
    assert [each.missing for each in sets] == [(camera,) if k in off else () for k in range(end)]
    counters = dataclasses.asdict(collector.counters)
    assert {name: counters[name] for name in ("backwards", "ahead", "late", "restarts") if counters[name]} == counted


def test_one_camera_ahead_from_the_first_frame_is_outvoted():
    collector = make_collector()
    sets = send(collector, range(100), cam01=HOUR) + collector.poll(200 * PERIOD)
    assert instants_of(each for each in sets if each.stamp_ns < EPOCH + HOUR) == list(range(100))
    assert collector.counters.restarts == 1


def test_clock_step_of_most_cameras_moves_the_rig():
    collector = make_collector()
    sets = send(collector, range(20)) + send(collector, range(20, 60), cam01=HOUR, cam03=HOUR)
    sets += collector.poll(100 * PERIOD) + collector.flush()
    moved = [each for each in sets if each.stamp_ns >= EPOCH + HOUR]
    assert instants_of(moved) == list(range(20, 60))
    assert all(set(each.frames) == {"cam01", "cam03"} for each in moved)


def test_pause_of_all_cameras_loses_nothing():
    collector = make_collector()
    sets = send(collector, range(10)) + send(collector, range(1000, 1010))
    assert instants_of(sets) == [*range(10), *range(1000, 1010)]
    assert all(not each.missing for each in sets)
    assert collector.counters.restarts == 0


@pytest.mark.parametrize(
    ("lag", "options", "whole"),
    [(120, {}, 0), (30, {"deadline_ns": SECOND, "max_open": 100}, 170)],
    ids=["by seconds: its frames are late", "by less than the deadline: they still join"],
)
def test_camera_that_lags_moves_no_time_and_joins_within_the_deadline(lag, options, whole):
    collector, sets = make_collector(**options), []
    for k in range(200):
        sets += send(collector, [k], TWO)
        if k >= lag:
            sets += send(collector, [k - lag], ["cam03"], later=lag + 0.5)
    sets += collector.flush()
    assert instants_of(sets) == list(range(200))
    assert [each.missing for each in sets] == [()] * whole + [("cam03",)] * (200 - whole)
    assert (collector.counters.late, collector.counters.restarts) == (200 - lag - whole, 0)


def test_camera_that_lags_with_few_frames_has_not_jumped():
    """A starved client leaves out so many frames that its own stamps step by more than a jump, forwards."""
    collector = make_collector()
    sets = send(collector, range(60))
    for k in range(60, 240):
        sets += send(collector, [k], ["cam01"])
        if k >= 90 and k % 30 == 0:
            sets += send(collector, [k - 30], ["cam02", "cam03"], later=30.5, cam02=1000, cam03=1000)
    sets += collector.flush()
    assert [each.stamp_ns for each in sets] == sorted(each.stamp_ns for each in sets)
    assert (collector.counters.late, collector.counters.restarts) == (10, 0)


def test_most_cameras_lagging_for_a_moment_do_not_turn_time_back():
    collector = make_collector()
    sets = send(collector, range(100))
    late = [(k + 30, camera, k) for k in range(100, 130) for camera in TWO]  # half a second behind
    on_time = [(k, "cam03", k) for k in range(100, 160)]
    for now, camera, k in sorted(late + on_time):
        sets += send(collector, [k], [camera], later=now - k)
    sets += send(collector, range(160, 200))
    assert all(a.stamp_ns < b.stamp_ns for a, b in pairwise(sets))
    assert collector.counters.restarts == 0
    assert all(not each.missing for each in sets[-40:])


def test_camera_that_drifts_ahead_is_outvoted_after_a_while():
    collector = make_collector()
    sets = []
    for k in range(400):
        sets += send(collector, [k], cam03=min(k * PERIOD // 10, SECOND))
    met = [each for each in sets if set(TWO) <= set(each.frames)]
    assert sum(each.stamps_ns["cam01"] >= EPOCH + 380 * PERIOD for each in met) >= 15


def test_cameras_one_after_the_other_still_meet_while_their_sets_are_open():
    collector = make_collector(deadline_ns=HOUR, max_open=1000)
    sets = [each for camera in CAMERAS for each in send(collector, range(300), [camera])]
    assert instants_of(sets) == list(range(300))
    assert all(not each.missing for each in sets)


def test_slow_cameras_do_not_leap_with_every_frame():
    slow = 300  # periods: five seconds
    collector = make_collector(tolerance_ns=slow * PERIOD // 2, deadline_ns=2 * slow * PERIOD)
    assert instants_of(send(collector, range(0, 5 * slow, slow))) == list(range(0, 5 * slow, slow))
    assert collector.counters.restarts == 0


def test_rival_timeline_is_settled_when_nobody_delivers_any_more():
    collector = make_collector()
    send(collector, range(3))
    send(collector, [3], ["cam01"], cam01=HOUR)
    due = collector.next_deadline_ns()
    assert due is not None and collector.poll(due - 1) == []
    assert instants_of(collector.poll(due)) == [3]  # the others are silent: the only voice counts
    assert collector.next_deadline_ns() is None
