"""Frames are picked by their stamps alone; a signal that asks to stop is an event."""

import os
import signal

import pytest

from capture_rig.stamps import SLOW_ORIGIN_NS, UTC, CaptureClock, StampThrottle
from capture_rig.stop_signals import STOP_SIGNALS, StopOnSignal

MS = 1_000_000


@pytest.mark.parametrize(
    ("throttle", "stamps_ms", "steps_s"),
    [
        (StampThrottle(0.5), [0, 100, 499, 500, 700, 1050, 1549], [0.5, 0, 0, 0.5, 0, 0.55, 0]),
        (StampThrottle(0.5, early_share=0.1), [0, 449, 450, 905], [0.5, 0, 0.45, 0.455]),
        (StampThrottle(0.5), [0, 60_000], [0.5, 1.0]),
        (StampThrottle(0.5, longest_s=2.0), [0, 60_000], [0.5, 2.0]),
        (StampThrottle(0.5), [10_000, 3_000, 3_100, 3_600], [0.5, 0.5, 0, 0.6]),
    ],
    ids=["one a period", "a little early where stamps jitter", "a pause", "a pause of 2 s at most", "stamps go back"],
)
def test_frame_that_is_due_stands_for_the_time_since_the_last(throttle, stamps_ms, steps_s) -> None:
    """A first stamp of 0 is a stamp as any other."""
    assert [round(throttle.step_s(stamp * MS), 6) for stamp in stamps_ms] == steps_s


def test_capture_clock_at_full_speed_is_utc_to_the_nanosecond() -> None:
    instant_ns = 1_795_468_603_072_793_765
    assert UTC.at_utc(instant_ns) == instant_ns and CaptureClock(1.0).speed == 1


@pytest.mark.parametrize("parts", [2, 3, 32])
def test_slow_capture_clock_takes_so_many_times_as_long(parts: int) -> None:
    clock, instant_ns = CaptureClock(1 / parts), SLOW_ORIGIN_NS + 86_400 * 1000 * MS
    assert clock.at_utc(SLOW_ORIGIN_NS) == SLOW_ORIGIN_NS
    assert clock.at_utc(instant_ns + parts * 60 * MS) - clock.at_utc(instant_ns) == 60 * MS


def test_wait_for_a_time_of_a_slow_clock_is_in_utc_and_not_too_short(monkeypatch: pytest.MonkeyPatch) -> None:
    clock, instant_ns = CaptureClock(1 / 3), SLOW_ORIGIN_NS + 1_000_000_007
    monkeypatch.setattr("time.time_ns", lambda: instant_ns)
    until_ns = clock.now_ns() + 50 * MS
    assert clock.at_utc(instant_ns + clock.wait_ns(until_ns)) >= until_ns
    assert abs(clock.wait_ns(until_ns) - 150 * MS) <= 3
    assert clock.wait_ns(clock.now_ns() - 1) == 0


@pytest.mark.parametrize("number", STOP_SIGNALS)
def test_signal_sets_the_event_and_the_handler_goes_with_the_context(number):
    before = signal.getsignal(number)
    with StopOnSignal() as stop:
        assert not stop.is_set()
        os.kill(os.getpid(), number)
        assert stop.wait(30)
    assert signal.getsignal(number) == before


def test_signal_that_comes_while_the_events_lock_is_held_does_not_hang():
    with StopOnSignal() as stop:
        with stop._cond:  # as in the midst of its wait()
            os.kill(os.getpid(), signal.SIGTERM)
        assert stop.wait(30)
