"""Frame sets over stamps that step, lag, drift or begin anew: one camera never moves the rig's time, most do."""

from __future__ import annotations

import dataclasses
from itertools import pairwise

from frame_traffic import (
    CAMERAS,
    EPOCH,
    HOUR,
    PERIOD,
    SECOND,
    TOLERANCE,
    Frame,
    assert_conserved,
    instants_of,
    make_collector,
    send,
)
from hypothesis import given, settings
from hypothesis import strategies as st

from mocap_packets.frame_set import FrameSetCollector


@settings(max_examples=200, deadline=None)
@given(
    st.lists(
        st.tuples(
            st.sampled_from(CAMERAS),
            st.sampled_from([-HOUR, -2 * SECOND, 0, 0, 0, 2 * SECOND, HOUR]),
            st.integers(0, 6 * PERIOD),
            st.integers(0, PERIOD),
        ),
        max_size=60,
    ),
    st.integers(1, 8),
)
def test_counts_are_conserved_and_sets_coherent_whatever_the_stamps(
    frames: list[tuple[str, int, int, int]], max_open: int
) -> None:
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


def test_footage_started_again_begins_a_new_timeline_and_loses_nothing() -> None:
    collector = make_collector()
    first = send(collector, range(120))
    second = []
    for k in range(5):
        for camera in CAMERAS:
            second += collector.add(camera, EPOCH + k * PERIOD, (camera, k), 121 * PERIOD + k * PERIOD)
    assert instants_of(first + second) == [*range(120), *range(5)]
    assert all(not each.missing for each in second)
    assert dataclasses.asdict(collector.counters) == {
        **dict.fromkeys(dataclasses.asdict(collector.counters), 0),
        "frames": 375,
        "complete": 125,
        "restarts": 1,
    }


def test_first_set_of_a_new_timeline_leaves_with_its_last_frame() -> None:
    collector = make_collector()
    send(collector, range(100, 200))
    now = 200 * PERIOD
    assert collector.add("cam01", EPOCH, ("cam01", 0), now) == []
    assert collector.add("cam02", EPOCH, ("cam02", 0), now + 1) == []
    assert instants_of(collector.add("cam03", EPOCH, ("cam03", 0), now + 2)) == [0]


def test_footage_started_again_after_a_camera_died_goes_on_without_it() -> None:
    collector = make_collector()
    send(collector, range(100))
    sets = send(collector, range(100, 120), cameras=["cam01", "cam02"])
    for k in range(10):
        for camera in ("cam01", "cam02"):
            sets += collector.add(camera, EPOCH + k * PERIOD, (camera, k), (121 + k) * PERIOD)
    sets += collector.flush()
    assert instants_of(sets) == [*range(100, 120), *range(10)]
    assert collector.counters.backwards == collector.counters.late == 0


def test_one_camera_going_back_for_good_does_not_stop_the_others() -> None:
    collector = make_collector()
    sets = send(collector, range(100))
    for k in range(100, 140):
        sets += send(collector, [k], cameras=["cam01", "cam02"])
        sets += send(collector, [k], cameras=["cam03"], shift=-HOUR)
    sets += collector.poll(200 * PERIOD) + collector.flush()
    assert instants_of(sets) == list(range(140))
    assert collector.counters.backwards == 40
    assert all(each.missing == ("cam03",) for each in sets[100:])


def test_one_stamp_far_ahead_costs_one_frame() -> None:
    collector = make_collector()
    sets = send(collector, range(10))
    sets += send(collector, [10], cameras=["cam01"], shift=HOUR)
    sets += send(collector, [10], cameras=["cam02", "cam03"])
    sets += send(collector, range(11, 60))
    assert instants_of(sets) == list(range(60))
    assert [each.missing for each in sets if each.missing] == [("cam01",)]
    assert (collector.counters.ahead, collector.counters.restarts) == (1, 0)


def test_one_camera_with_a_clock_far_ahead_does_not_stop_the_others() -> None:
    collector = make_collector()
    sets = []
    for k in range(100):
        sets += send(collector, [k], cameras=["cam01", "cam02"])
        sets += send(collector, [k], cameras=["cam03"], shift=HOUR)
    sets += collector.poll(200 * PERIOD)
    assert instants_of(sets) == list(range(100))
    assert all(set(each.frames) == {"cam01", "cam02"} for each in sets)
    assert collector.counters.ahead == 100


def test_one_camera_ahead_from_the_first_frame_is_outvoted() -> None:
    collector = make_collector()
    sets = []
    for k in range(100):
        sets += send(collector, [k], cameras=["cam01"], shift=HOUR)
        sets += send(collector, [k], cameras=["cam02", "cam03"])
    sets += collector.poll(200 * PERIOD)
    present = [each for each in sets if each.stamp_ns < EPOCH + HOUR]
    assert instants_of(present) == list(range(100))
    assert collector.counters.restarts == 1


def test_clock_step_of_most_cameras_moves_the_rig() -> None:
    collector = make_collector()
    sets = send(collector, range(20))
    for k in range(20, 60):
        sets += send(collector, [k], cameras=["cam01", "cam03"], shift=HOUR)
        sets += send(collector, [k], cameras=["cam02"])
    sets += collector.poll(100 * PERIOD) + collector.flush()
    moved = [each for each in sets if each.stamp_ns >= EPOCH + HOUR]
    assert instants_of(moved) == list(range(20, 60))
    assert all(set(each.frames) == {"cam01", "cam03"} for each in moved)


def test_pause_of_all_cameras_loses_nothing() -> None:
    collector = make_collector()
    sets = send(collector, range(10)) + send(collector, range(1000, 1010))
    assert instants_of(sets) == [*range(10), *range(1000, 1010)]
    assert all(not each.missing for each in sets)
    assert collector.counters.restarts == 0


def test_camera_lagging_by_seconds_is_late() -> None:
    collector = make_collector()
    sets = []
    for k in range(200):
        sets += send(collector, [k], cameras=["cam01", "cam02"])
        if k >= 120:
            for each in collector.add("cam03", EPOCH + (k - 120) * PERIOD, ("cam03", k - 120), k * PERIOD + 5000):
                sets.append(each)
    sets += collector.flush()
    assert instants_of(sets) == list(range(200))
    assert collector.counters.late == 80
    assert collector.counters.restarts == 0


def test_camera_that_lags_with_few_frames_has_not_jumped() -> None:
    """A starved client leaves out so many frames that its own stamps step by more than a jump, forwards."""
    collector = make_collector()
    sets = send(collector, range(60))
    for k in range(60, 240):
        sets += send(collector, [k], cameras=["cam01"])
        if k >= 90 and k % 30 == 0:
            for camera in ("cam02", "cam03"):
                sets += collector.add(camera, EPOCH + (k - 30) * PERIOD + 1000, (camera, k - 30), k * PERIOD + 5000)
    sets += collector.flush()
    assert [each.stamp_ns for each in sets] == sorted(each.stamp_ns for each in sets)
    assert collector.counters.restarts == 0 and collector.counters.late == 10


def test_most_cameras_lagging_for_a_moment_do_not_turn_time_back() -> None:
    collector = make_collector()
    sets = send(collector, range(100))
    late = [(k + 30, camera, k) for k in range(100, 130) for camera in ("cam01", "cam02")]  # half a second behind
    on_time = [(k, "cam03", k) for k in range(100, 160)]
    for now, camera, k in sorted(late + on_time):
        sets += collector.add(camera, EPOCH + k * PERIOD, (camera, k), now * PERIOD)
    sets += send(collector, range(160, 200))
    assert all(a.stamp_ns < b.stamp_ns for a, b in pairwise(sets))
    assert collector.counters.restarts == 0
    assert all(not each.missing for each in sets[-40:])


def test_camera_that_drifts_ahead_is_outvoted_after_a_while() -> None:
    collector = make_collector()
    sets = []
    for k in range(400):
        sets += send(collector, [k], cameras=["cam01", "cam02"])
        sets += send(collector, [k], cameras=["cam03"], shift=min(k * PERIOD // 10, SECOND))
    met = [each for each in sets if {"cam01", "cam02"} <= set(each.frames)]
    assert sum(each.stamps_ns["cam01"] >= EPOCH + 380 * PERIOD for each in met) >= 15


def test_camera_lagging_less_than_the_deadline_still_joins() -> None:
    collector = make_collector(deadline_ns=SECOND, max_open=100)
    sets = []
    for k in range(130):
        sets += send(collector, [k], cameras=["cam01", "cam02"])
        if k >= 30:
            sets += collector.add("cam03", EPOCH + (k - 30) * PERIOD, ("cam03", k - 30), k * PERIOD + 5000)
    assert instants_of(sets) == list(range(100))
    assert all(not each.missing for each in sets)


def test_cameras_one_after_the_other_still_meet_while_their_sets_are_open() -> None:
    collector = make_collector(deadline_ns=HOUR, max_open=1000)
    sets = [each for camera in CAMERAS for each in send(collector, range(300), cameras=[camera])]
    assert instants_of(sets) == list(range(300))
    assert all(not each.missing for each in sets)


def test_slow_cameras_do_not_leap_with_every_frame() -> None:
    slow = 5 * SECOND
    collector = FrameSetCollector[Frame](CAMERAS, tolerance_ns=slow // 2, deadline_ns=2 * slow)
    sets = []
    for k in range(5):
        for camera in CAMERAS:
            sets += collector.add(camera, EPOCH + k * slow, (camera, k), k * slow)
    assert instants_of(sets) == list(range(5))
    assert collector.counters.restarts == 0


def test_rival_timeline_is_settled_when_nobody_delivers_any_more() -> None:
    collector = make_collector()
    send(collector, range(3))
    collector.add("cam01", EPOCH + HOUR, ("cam01", 3), 3 * PERIOD)
    due = collector.next_deadline_ns()
    assert due is not None and collector.poll(due - 1) == []
    assert instants_of(collector.poll(due)) == [3]  # the others are silent: the only voice counts
    assert collector.next_deadline_ns() is None
