"""Frames are picked by their stamps alone; the clock of the stamps may run slower than UTC."""

import pytest

from capture_rig.stamps import SLOW_ORIGIN_NS, UTC, CaptureClock, StampThrottle

MS = 1_000_000


def picked(throttle: StampThrottle, stamps_ms: list[float]) -> list[float]:
    return [round(throttle.step_s(round(stamp * MS)), 6) for stamp in stamps_ms]


def test_one_frame_a_period_is_due_and_stands_for_the_time_since_the_last() -> None:
    """A first stamp of 0 is a stamp as any other."""
    assert picked(StampThrottle(0.5), [0, 100, 499, 500, 700, 1050, 1549]) == [0.5, 0, 0, 0.5, 0, 0.55, 0]


def test_frame_that_comes_a_little_early_is_due_where_stamps_jitter() -> None:
    assert picked(StampThrottle(0.5, early_share=0.1), [0, 449, 450, 905]) == [0.5, 0, 0.45, 0.455]


@pytest.mark.parametrize(("longest_s", "counted_s"), [(None, 1.0), (2.0, 2.0)])
def test_pause_counts_as_the_longest_step(longest_s: float | None, counted_s: float) -> None:
    assert picked(StampThrottle(0.5, longest_s=longest_s), [0, 60_000]) == [0.5, counted_s]


def test_stamps_that_go_back_begin_anew() -> None:
    assert picked(StampThrottle(0.5), [10_000, 3_000, 3_100, 3_600]) == [0.5, 0.5, 0, 0.6]


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
