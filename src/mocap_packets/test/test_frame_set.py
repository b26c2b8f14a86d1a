"""Frame sets: whatever the order, delay, loss or stamps of the frames, no set ever mixes two instants."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable
from itertools import pairwise

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mocap_packets.frame_set import FrameSet, FrameSetCollector

CAMERAS = ("cam01", "cam02", "cam03")
SECOND = 1_000_000_000
PERIOD = SECOND // 60
TOLERANCE = PERIOD // 2
DEADLINE = 2 * PERIOD
EPOCH = 1_700_000_000 * SECOND
HOUR = 3600 * SECOND

Frame = tuple[str, int]  # camera and instant: what a test frame carries
Sent = tuple[str, int, int, int]  # camera, stamp, instant, arrival


def make_collector(
    cameras: Iterable[str] = CAMERAS, deadline_ns: int = DEADLINE, max_open: int = 8, give_up: int = 0
) -> FrameSetCollector[Frame]:
    return FrameSetCollector(
        cameras, tolerance_ns=TOLERANCE, deadline_ns=deadline_ns, max_open=max_open, give_up=give_up
    )


def send(collector: FrameSetCollector, instants: Iterable[int], cameras: Iterable[str] = CAMERAS, shift: int = 0):
    """Frames of the given instants, each arriving 1 us after the last and at the pace of the instants."""
    sets = []
    for k in instants:
        for index, camera in enumerate(cameras):
            stamp = EPOCH + k * PERIOD + shift
            sets += collector.add(camera, stamp, (camera, k), k * PERIOD + 1000 * index)
    return sets


def instants_of(sets: list[FrameSet[Frame]]) -> list[int]:
    """The instant of each set; fails when a set holds frames of two."""
    found = []
    for each in sets:
        (instant,) = {k for _, k in each.frames.values()}
        found.append(instant)
    return found


def assert_conserved(collector: FrameSetCollector, sets: list[FrameSet], waiting: int = 0) -> None:
    c = collector.counters
    in_sets = sum(len(each.frames) for each in sets)
    assert c.frames == in_sets + c.late + c.duplicate + c.backwards + c.ahead + waiting
    assert c.complete == sum(not each.missing for each in sets)
    assert c.incomplete == sum(bool(each.missing) for each in sets)
    assert c.missing == sum(len(each.missing) for each in sets)


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
        assert each.stamp_ns == min(each.stamps_ns.values())
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


def test_set_closes_with_its_last_frame_cameras_in_name_order() -> None:
    collector = make_collector()
    assert collector.add("cam03", EPOCH + 5, ("cam03", 0), 0) == []
    assert collector.add("cam01", EPOCH + 9, ("cam01", 0), 1) == []
    (closed,) = collector.add("cam02", EPOCH + 2, ("cam02", 0), 2)
    assert list(closed.frames) == list(closed.stamps_ns) == ["cam01", "cam02", "cam03"]
    assert (closed.stamp_ns, closed.spread_ns, closed.missing) == (EPOCH + 2, 7, ())
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
        sets += collector.note_absence("cam03", EPOCH + k * PERIOD, k * PERIOD)
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


def test_frames_still_waiting_are_the_rest_of_the_count() -> None:
    collector = make_collector()
    sets = send(collector, range(3)) + send(collector, [3], cameras=["cam01", "cam02"])
    collector.add("cam03", EPOCH + HOUR, ("cam03", 3), 3 * PERIOD)
    assert_conserved(collector, sets, waiting=3)
