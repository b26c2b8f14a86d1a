"""Frame sets: no set ever mixes two instants, whatever arrives; one camera never moves the rig's time, most do."""

import dataclasses
from itertools import pairwise

import pytest
from frame_traffic import (
    CAMERAS,
    DEADLINE,
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


@st.composite
def traffic(draw):
    """Cameras and (camera, stamp, instant, arrival): frames jittered, lost, delayed, repeated, in order of arrival."""
    cameras = tuple(f"cam{index:02}" for index in range(draw(st.integers(1, 4))))
    sent = []
    for k in range(draw(st.integers(1, 10))):
        for camera in cameras:
            copies = draw(st.sampled_from([0, 1, 1, 1, 1, 1, 2]))
            stamp = EPOCH + k * PERIOD + draw(st.integers(0, TOLERANCE - 1))
            for _ in range(copies):
                sent.append((camera, stamp, k, k * PERIOD + draw(st.integers(0, 4 * PERIOD))))
    return cameras, sorted(sent, key=lambda frame: frame[3])


@settings(max_examples=200)
@given(traffic(), st.integers(PERIOD // 4, 4 * PERIOD), st.integers(1, 8))
def test_sets_never_mix_instants_nor_leave_out_of_order_whatever_arrives(sent, deadline_ns, max_open):
    cameras, frames = sent
    collector = make_collector(cameras, deadline_ns=deadline_ns, max_open=max_open)
    sets = []
    for camera, stamp, instant, arrival in frames:
        sets += collector.add(camera, stamp, (camera, instant), arrival)
    sets += collector.flush()
    instants = instants_of(sets)
    assert instants == sorted(set(instants))  # one set an instant at most, in order
    given_stamps = {(camera, instant): stamp for camera, stamp, instant, _ in frames}
    for each in sets:
        assert list(each.frames) == sorted(each.frames)
        assert all(name == camera for name, (camera, _) in each.frames.items())
        assert each.stamps_ns == {name: given_stamps[frame] for name, frame in each.frames.items()}
        assert min(each.stamps_ns.values()) <= each.stamp_ns <= max(each.stamps_ns.values())
        assert each.spread_ns < TOLERANCE
        assert sorted([*each.frames, *each.missing]) == list(cameras)
    assert all(a.stamp_ns < b.stamp_ns for a, b in pairwise(sets))
    assert_conserved(collector, sets)
    assert collector.counters.restarts == collector.counters.ahead == 0


def test_set_closes_with_its_last_frame_cameras_in_name_order():
    collector = make_collector()
    assert collector.add("cam03", EPOCH + 5, ("cam03", 0), 0) == []
    assert collector.add("cam01", EPOCH + 9, ("cam01", 0), 1) == []
    (closed,) = collector.add("cam02", EPOCH + 2, ("cam02", 0), 2)
    assert list(closed.frames) == list(closed.stamps_ns) == ["cam01", "cam02", "cam03"]
    assert (closed.stamp_ns, closed.spread_ns, closed.missing) == (EPOCH + 16 // 3, 7, ())  # the mean
    assert collector.counters.complete == 1


def test_set_waits_for_its_deadline_then_leaves_naming_what_is_missing():
    collector = make_collector()
    collector.add("cam02", EPOCH, ("cam02", 0), 100)
    assert collector.next_deadline_ns() == 100 + DEADLINE
    collector.deadline_ns *= 2
    assert collector.poll(100 + 2 * DEADLINE - 1) == []
    (closed,) = collector.poll(100 + 2 * DEADLINE)
    assert closed.missing == ("cam01", "cam03")
    assert (collector.counters.incomplete, collector.counters.missing) == (1, 2)
    assert collector.next_deadline_ns() is None


def test_frame_after_its_set_has_left_is_late_and_joins_no_other():
    collector = make_collector()
    first = send(collector, [0], TWO) + collector.poll(DEADLINE)
    collector.add("cam01", EPOCH + PERIOD, ("cam01", 1), DEADLINE)
    late = collector.add("cam03", EPOCH + 7, ("cam03", 0), DEADLINE)
    assert instants_of(first + late + collector.flush()) == [0, 1]
    assert collector.counters.late == 1


def test_stamp_that_goes_back_and_frame_that_comes_twice_are_refused():
    collector = make_collector()
    for stamp, instant in ((EPOCH + PERIOD, 1), (EPOCH, 0), (EPOCH + PERIOD, 99)):
        collector.add("cam01", stamp, ("cam01", instant), 0)
    (closed,) = collector.flush()
    assert closed.frames == {"cam01": ("cam01", 1)}
    assert (collector.counters.backwards, collector.counters.duplicate) == (1, 1)


@pytest.mark.parametrize("give_up", [0, 1])
def test_camera_of_half_the_rate_delays_no_set_by_a_deadline_and_is_never_given_up(give_up):
    collector = make_collector(deadline_ns=HOUR, give_up=give_up)
    sets = []
    for k in range(20):
        sets += send(collector, [k], CAMERAS if k % 2 == 0 else TWO)
    assert instants_of(sets) == list(range(19))  # the last one may still become whole
    assert [each.missing for each in sets] == [() if k % 2 == 0 else ("cam03",) for k in range(19)]


def test_camera_missing_from_several_sets_in_a_row_is_waited_for_again_once_heard():
    collector = make_collector(deadline_ns=HOUR, give_up=3)
    sets = send(collector, range(3)) + send(collector, range(3, 6), TWO)
    sets += collector.poll(2 * HOUR)  # the deadline of the three sets
    assert instants_of(sets) == list(range(6))
    assert instants_of(send(collector, range(6, 9), TWO)) == [6, 7, 8]  # at once
    assert send(collector, [8], ["cam03"]) == [] and collector.counters.late == 1
    assert send(collector, [9], TWO) == []
    (whole,) = send(collector, [9], ["cam03"])
    assert whole.missing == ()


def test_frames_that_are_known_not_to_exist_are_not_waited_for_and_never_make_the_set_give_up():
    collector, sets = make_collector(deadline_ns=HOUR, give_up=3), []
    for k in range(6):
        sets += send(collector, [k], TWO)
        sets += collector.add_absence("cam03", EPOCH + k * PERIOD, k * PERIOD)
    assert instants_of(sets) == list(range(6)) and {each.missing for each in sets} == {("cam03",)}
    assert send(collector, [6], TWO) == []  # its next frame has its place, whoever comes first
    (whole,) = send(collector, [6], ["cam03"])
    assert whole.missing == ()


def test_too_many_open_sets_close_the_oldest():
    collector = make_collector(max_open=2, deadline_ns=HOUR)
    assert instants_of(send(collector, range(5), ["cam01"])) == [0, 1, 2]
    assert instants_of(collector.flush()) == [3, 4]


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


@pytest.mark.parametrize(
    ("options", "spans", "restarts"),
    [
        ({}, [(range(10), CAMERAS, 0), (range(1000, 1010), CAMERAS, 0)], 0),
        ({"tolerance_ns": 150 * PERIOD, "deadline_ns": 600 * PERIOD}, [(range(0, 1500, 300), CAMERAS, 0)], 0),
        ({}, [(range(100), CAMERAS, 0), (range(100, 120), TWO, 0), (range(10), TWO, 121)], 1),
    ],
    ids=["a pause", "slow cameras", "started again after a camera died"],
)
def test_leap_of_all_live_cameras_loses_nothing(options, spans, restarts):
    collector, sets = make_collector(**options), []
    for instants, cameras, later in spans:
        sets += send(collector, instants, cameras, later=later)
    sets += collector.flush()
    assert instants_of(sets) == [k for instants, _, _ in spans for k in instants]
    assert sum(len(each.frames) for each in sets) == collector.counters.frames
    assert collector.counters.restarts == restarts


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


def test_rival_timeline_is_settled_when_nobody_delivers_any_more():
    collector = make_collector()
    send(collector, range(3))
    send(collector, [3], ["cam01"], cam01=HOUR)
    due = collector.next_deadline_ns()
    assert due is not None and collector.poll(due - 1) == []
    assert instants_of(collector.poll(due)) == [3]  # the others are silent: the only voice counts
    assert collector.next_deadline_ns() is None
