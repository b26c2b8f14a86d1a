"""Frame sets: whatever the order, delay or loss of the frames, no set ever mixes two instants."""

from __future__ import annotations

from itertools import pairwise

import pytest
from frame_traffic import (
    CAMERAS,
    DEADLINE,
    EPOCH,
    HOUR,
    PERIOD,
    TOLERANCE,
    assert_conserved,
    instants_of,
    make_collector,
    send,
)
from hypothesis import given, settings
from hypothesis import strategies as st

Sent = tuple[str, int, int, int]  # camera, stamp, instant, arrival


@st.composite
def traffic(draw: st.DrawFn) -> tuple[tuple[str, ...], list[Sent]]:
    """Frames of some cameras over some instants: jittered, lost, delayed, repeated, in order of arrival."""
    cameras = tuple(f"cam{index:02}" for index in range(draw(st.integers(1, 4))))
    sent: list[Sent] = []
    for k in range(draw(st.integers(1, 10))):
        for camera in cameras:
            copies = draw(st.sampled_from([0, 1, 1, 1, 1, 1, 2]))
            stamp = EPOCH + k * PERIOD + draw(st.integers(0, TOLERANCE - 1))
            for _ in range(copies):
                sent.append((camera, stamp, k, k * PERIOD + draw(st.integers(0, 4 * PERIOD))))
    return cameras, sorted(sent, key=lambda frame: frame[3])


@settings(max_examples=200, deadline=None)
@given(traffic(), st.integers(PERIOD // 4, 4 * PERIOD), st.integers(1, 8))
def test_sets_never_mix_instants_nor_leave_out_of_order_whatever_arrives(
    sent: tuple[tuple[str, ...], list[Sent]], deadline_ns: int, max_open: int
) -> None:
    cameras, frames = sent
    collector = make_collector(cameras, deadline_ns, max_open)
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


@settings(max_examples=100, deadline=None)
@given(traffic())
def test_sets_are_complete_whatever_the_order_when_nothing_is_lost_or_late(
    sent: tuple[tuple[str, ...], list[Sent]],
) -> None:
    cameras, frames = sent
    delivered = {(camera, instant): (stamp, arrival) for camera, stamp, instant, arrival in reversed(frames)}
    per_camera = {camera: sorted(k for name, k in delivered if name == camera) for camera in cameras}
    common = set.intersection(*(set(instants) for instants in per_camera.values()))
    collector = make_collector(cameras, deadline_ns=100 * PERIOD, max_open=100)
    sets = []
    for camera in cameras:  # one camera after the other: the worst order there is
        for k in sorted(common):
            sets += collector.add(camera, delivered[camera, k][0], (camera, k), 0)
    assert instants_of(sets) == sorted(common)
    assert all(not each.missing for each in sets)


def test_set_closes_with_its_last_frame_cameras_in_name_order() -> None:
    collector = make_collector()
    assert collector.add("cam03", EPOCH + 5, ("cam03", 0), 0) == []
    assert collector.add("cam01", EPOCH + 9, ("cam01", 0), 1) == []
    (closed,) = collector.add("cam02", EPOCH + 2, ("cam02", 0), 2)
    assert list(closed.frames) == list(closed.stamps_ns) == ["cam01", "cam02", "cam03"]
    assert (closed.stamp_ns, closed.spread_ns, closed.missing) == (EPOCH + 16 // 3, 7, ())  # the mean
    assert collector.counters.complete == 1


def test_set_waits_for_its_deadline_then_leaves_naming_what_is_missing() -> None:
    collector = make_collector()
    collector.add("cam02", EPOCH, ("cam02", 0), 100)
    assert collector.next_deadline_ns() == 100 + DEADLINE
    assert collector.poll(100 + DEADLINE - 1) == []
    (closed,) = collector.poll(100 + DEADLINE)
    assert closed.missing == ("cam01", "cam03")
    assert (collector.counters.incomplete, collector.counters.missing) == (1, 2)
    assert collector.next_deadline_ns() is None


def test_frame_after_its_set_has_left_is_late_and_joins_no_other() -> None:
    collector = make_collector()
    first = send(collector, [0], cameras=["cam01", "cam02"]) + collector.poll(DEADLINE)
    collector.add("cam01", EPOCH + PERIOD, ("cam01", 1), DEADLINE)
    late = collector.add("cam03", EPOCH + 7, ("cam03", 0), DEADLINE)
    assert instants_of(first + late + collector.flush()) == [0, 1]
    assert collector.counters.late == 1


def test_stamp_that_goes_back_is_refused() -> None:
    collector = make_collector()
    collector.add("cam01", EPOCH + PERIOD, ("cam01", 1), 0)
    collector.add("cam01", EPOCH, ("cam01", 0), 1)
    assert collector.counters.backwards == 1
    assert instants_of(collector.flush()) == [1]


def test_frame_that_comes_twice_counts_once() -> None:
    collector = make_collector()
    collector.add("cam01", EPOCH, ("cam01", 0), 0)
    collector.add("cam01", EPOCH, ("cam01", 99), 1)
    (closed,) = collector.flush()
    assert closed.frames == {"cam01": ("cam01", 0)}
    assert collector.counters.duplicate == 1


def test_complete_set_does_not_overtake_an_older_one() -> None:
    collector = make_collector()
    send(collector, [0], cameras=["cam01"])
    assert send(collector, [1], cameras=["cam02"]) == []
    assert send(collector, [1], cameras=["cam01"]) == []  # instant 0 still waits for cam03
    assert instants_of(send(collector, [1], cameras=["cam03"])) == [0, 1]


def test_set_does_not_wait_for_a_camera_that_has_sent_a_later_frame() -> None:
    collector = make_collector(deadline_ns=HOUR)
    assert send(collector, [0], cameras=["cam01", "cam02"]) == []  # the network loses the frame of cam03
    closed = send(collector, [1], cameras=["cam03"])
    assert instants_of(closed) == [0] and closed[0].missing == ("cam03",)
    assert instants_of(send(collector, [1], cameras=["cam01", "cam02"])) == [1]


def test_camera_of_half_the_rate_delays_no_set_by_a_deadline() -> None:
    collector = make_collector(deadline_ns=HOUR)
    sets = []
    for k in range(20):
        sets += send(collector, [k], cameras=CAMERAS if k % 2 == 0 else CAMERAS[:2])
    assert instants_of(sets) == list(range(19))  # the last one may still become whole
    assert [each.missing for each in sets] == [() if k % 2 == 0 else ("cam03",) for k in range(19)]


def test_camera_missing_from_several_sets_in_a_row_is_waited_for_again_once_heard() -> None:
    collector = make_collector(deadline_ns=HOUR, give_up=3)
    sets = send(collector, range(3)) + send(collector, range(3, 6), cameras=["cam01", "cam02"])
    sets += collector.poll(2 * HOUR)  # the deadline of the three sets
    assert instants_of(sets) == list(range(6))
    assert instants_of(send(collector, range(6, 9), cameras=["cam01", "cam02"])) == [6, 7, 8]  # at once
    assert send(collector, [8], cameras=["cam03"]) == [] and collector.counters.late == 1
    assert send(collector, [9], cameras=["cam01", "cam02"]) == []
    (whole,) = send(collector, [9], cameras=["cam03"])
    assert whole.missing == ()


def test_frames_that_are_known_not_to_exist_are_not_waited_for_and_never_make_the_set_give_up() -> None:
    collector, sets = make_collector(deadline_ns=HOUR, give_up=3), []
    for k in range(6):
        sets += send(collector, [k], cameras=["cam01", "cam02"])
        sets += collector.add_absence("cam03", EPOCH + k * PERIOD, k * PERIOD)
    assert instants_of(sets) == list(range(6)) and {each.missing for each in sets} == {("cam03",)}
    assert send(collector, [6], cameras=["cam01", "cam02"]) == []  # its next frame has its place, whoever comes first
    (whole,) = send(collector, [6], cameras=["cam03"])
    assert whole.missing == ()


def test_camera_that_sent_a_later_frame_has_not_been_waited_for_in_vain() -> None:
    collector = make_collector(deadline_ns=HOUR, give_up=2)
    for k in range(6):  # half the rate
        send(collector, [k], cameras=CAMERAS if k % 2 == 0 else CAMERAS[:2])
    assert send(collector, [6], cameras=["cam01", "cam02"]) == []


def test_older_set_completed_late_releases_the_complete_ones_behind_it() -> None:
    collector = make_collector()
    send(collector, [0, 1], cameras=["cam01", "cam02"])
    assert instants_of(send(collector, [0, 1], cameras=["cam03"])) == [0, 1]


def test_too_many_open_sets_close_the_oldest() -> None:
    collector = make_collector(max_open=2, deadline_ns=HOUR)
    closed = send(collector, range(5), cameras=["cam01"])
    assert instants_of(closed) == [0, 1, 2]
    assert instants_of(collector.flush()) == [3, 4]


def test_deadline_that_is_changed_holds_for_open_sets_and_later_ones() -> None:
    collector = make_collector(deadline_ns=HOUR)
    send(collector, [0], cameras=["cam01"])
    collector.wait(DEADLINE)
    assert collector.next_deadline_ns() == DEADLINE and instants_of(collector.poll(DEADLINE)) == [0]
    send(collector, [3], cameras=["cam01"])
    assert collector.next_deadline_ns() == 3 * PERIOD + DEADLINE


def test_unknown_camera_is_a_key_error() -> None:
    with pytest.raises(KeyError, match="cam09"):
        make_collector().add("cam09", EPOCH, ("cam09", 0), 0)


def test_frames_still_waiting_are_the_rest_of_the_count() -> None:
    collector = make_collector()
    sets = send(collector, range(3)) + send(collector, [3], cameras=["cam01", "cam02"])
    collector.add("cam03", EPOCH + HOUR, ("cam03", 3), 3 * PERIOD)
    assert_conserved(collector, sets, waiting=3)
