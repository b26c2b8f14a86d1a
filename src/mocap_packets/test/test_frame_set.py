"""Frame sets: whatever the order, delay or loss of the frames, no set ever mixes two instants."""

from itertools import pairwise

import pytest
from frame_traffic import (
    CAMERAS,
    DEADLINE,
    EPOCH,
    HOUR,
    PERIOD,
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


@settings(max_examples=100)
@given(traffic())
def test_sets_are_complete_whatever_the_order_when_nothing_is_lost_or_late(sent):
    cameras, frames = sent
    stamps = {(camera, instant): stamp for camera, stamp, instant, _ in frames}
    common = set.intersection(*({k for name, k in stamps if name == camera} for camera in cameras))
    collector = make_collector(cameras, deadline_ns=100 * PERIOD, max_open=100)
    sets = []
    for camera in cameras:  # one camera after the other: the worst order there is
        for k in sorted(common):
            sets += collector.add(camera, stamps[camera, k], (camera, k), 0)
    assert instants_of(sets) == sorted(common)
    assert all(not each.missing for each in sets)


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
    assert collector.poll(100 + DEADLINE - 1) == []
    (closed,) = collector.poll(100 + DEADLINE)
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


def test_deadline_that_is_changed_holds_for_open_sets_and_later_ones():
    collector = make_collector(deadline_ns=HOUR)
    send(collector, [0], ["cam01"])
    collector.wait(DEADLINE)
    assert collector.next_deadline_ns() == DEADLINE and instants_of(collector.poll(DEADLINE)) == [0]
    send(collector, [3], ["cam01"])
    assert collector.next_deadline_ns() == 3 * PERIOD + DEADLINE


def test_unknown_camera_is_a_key_error():
    with pytest.raises(KeyError, match="cam09"):
        send(make_collector(), [0], ["cam09"])
