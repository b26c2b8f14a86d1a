"""When frames leave: by a clock of the test's own, never by waiting."""

import itertools

import pytest

from camera_client.sources.footage_source import AcknowledgedPace, FootageClock, SharedClock, WallClockPace
from capture_rig.session import footage_stamp_ns

EPOCH_NS = 1_800_000_000_000_000_000
MS = 1_000_000
CLOCK = FootageClock(EPOCH_NS, EPOCH_NS)


class Clock:
    """Time that passes only when someone sleeps, or the test says so."""

    def __init__(self, now_ns=EPOCH_NS):
        self.ns = now_ns

    def now_ns(self):
        return self.ns

    def now_s(self):
        return (self.ns - EPOCH_NS) / 1e9

    def sleep(self, seconds):
        self.ns += round(seconds * 1e9)


def departures_ms(pace, clock, frames, first=0):
    """When each frame leaves, in ms after the epoch."""
    times = []
    for frame in range(first, first + frames):
        while not pace.wait(frame, 0.05):
            pass
        times.append((clock.ns - EPOCH_NS) / MS)
    return times


def test_slow_consumer_gets_late_frames_at_once_until_it_has_caught_up():
    clock = Clock()
    pace = WallClockPace(50.0, 1.0, clock.now_ns, clock.sleep)
    pace.begin(CLOCK, 0)
    departures_ms(pace, clock, 1)
    clock.ns += 70 * MS
    assert departures_ms(pace, clock, 5, first=1) == pytest.approx([70, 70, 70, 80, 100], abs=1e-3)


def test_frame_that_is_not_due_in_time_stays():
    clock = Clock(EPOCH_NS - 1000 * MS)
    pace = WallClockPace(50.0, 1.0, clock.now_ns, clock.sleep)
    pace.begin(CLOCK, 0)
    assert not pace.wait(0, 0.2)
    assert clock.ns == EPOCH_NS - 800 * MS


def acknowledged(window=3, patience_s=2.0):
    clock = Clock()
    pace = AcknowledgedPace(50.0, window, patience_s, clock.now_s)
    pace.begin(CLOCK, 0)
    return pace, clock


def test_as_many_frames_as_the_window_leave_and_one_more_with_each_acknowledgement():
    pace, _ = acknowledged(window=3)
    assert all(pace.wait(k, 0.0) for k in range(3))
    for k in range(3, 40):
        assert not pace.wait(k, 0.0)
        pace.acknowledge(footage_stamp_ns(EPOCH_NS, k - 3, 50.0))
        assert pace.wait(k, 0.0)
        assert not pace.wait(k + 1, 0.0)
    assert pace.timeouts == 0


def test_silent_consumer_is_outrun_after_the_timeout_which_frames_and_acknowledgements_begin_anew():
    pace, clock = acknowledged(window=1, patience_s=2.0)
    pace.wait(0, 0.0)
    clock.sleep(1.99)
    assert not pace.wait(1, 0.0)
    clock.sleep(0.02)
    assert pace.wait(1, 0.0) and pace.timeouts == 1
    for outrun in (lambda: pace.acknowledge(footage_stamp_ns(EPOCH_NS, 0, 50.0)), lambda: None):
        clock.sleep(1.5)
        outrun()
        assert not pace.wait(2, 0.0) and pace.timeouts == 1
    clock.sleep(0.5)
    assert pace.wait(2, 0.0) and pace.timeouts == 2


def test_acknowledgements_of_an_earlier_playing_do_not_count():
    pace, _ = acknowledged(window=2)
    pace.acknowledge(EPOCH_NS + 10**15)
    pace.begin(CLOCK, 0)
    assert [pace.wait(k, 0.0) for k in range(3)] == [True, True, False]


@pytest.mark.parametrize("rate", [0.25, 0.5, 1.0, 2.0, 8.0])
def test_stamps_run_at_the_rate_of_playing_from_the_epoch_on(rate):
    """One relation for every frame: stamp = epoch + rate * (time of leaving - epoch)."""
    clock = Clock(EPOCH_NS)
    pace = WallClockPace(25.0, rate, clock.now_ns, clock.sleep)
    pace.begin(CLOCK, 0)
    for frame in range(100):
        assert pace.wait(frame, 10.0)
        since_epoch_ns = footage_stamp_ns(EPOCH_NS, frame, 25.0) - EPOCH_NS
        assert since_epoch_ns == pytest.approx(rate * (clock.now_ns() - EPOCH_NS), abs=1000)


FIRST, SECOND, THIRD = (FootageClock(EPOCH_NS + k * MS, EPOCH_NS + k * MS) for k in range(3))


@pytest.mark.parametrize("order", list(itertools.permutations([FIRST, SECOND, THIRD])))
def test_cameras_come_to_the_clock_that_begins_first_whatever_they_hear_first(order):
    announced = []
    shared = SharedClock(announced.append)
    held = [shared.offer(clock) for clock in order]
    assert held[-1] == FIRST and announced[-1] == FIRST
    assert announced == sorted(set(announced), reverse=True)  # what no longer holds is announced no more
