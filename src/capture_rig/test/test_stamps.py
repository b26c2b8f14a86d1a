"""Frames are picked by their stamps alone."""

from __future__ import annotations

import pytest

from capture_rig.stamps import StampThrottle

MS = 1_000_000


def picked(throttle: StampThrottle, stamps_ms: list[float]) -> list[float]:
    return [round(throttle.step_s(round(stamp * MS)), 6) for stamp in stamps_ms]


def test_one_frame_a_period_is_due_and_stands_for_the_time_since_the_last() -> None:
    assert picked(StampThrottle(0.5), [0, 100, 499, 500, 700, 1050, 1549]) == [0.5, 0, 0, 0.5, 0, 0.55, 0]


def test_frame_that_comes_a_little_early_is_due_where_stamps_jitter() -> None:
    assert picked(StampThrottle(0.5, early_share=0.1), [0, 449, 450, 905]) == [0.5, 0, 0.45, 0.455]


@pytest.mark.parametrize(("longest_s", "counted_s"), [(None, 1.0), (2.0, 2.0)])
def test_pause_counts_as_the_longest_step(longest_s: float | None, counted_s: float) -> None:
    assert picked(StampThrottle(0.5, longest_s=longest_s), [0, 60_000]) == [0.5, counted_s]


def test_stamps_that_go_back_begin_anew() -> None:
    assert picked(StampThrottle(0.5), [10_000, 3_000, 3_100, 3_600]) == [0.5, 0.5, 0, 0.6]


def test_stamp_zero_is_a_stamp_as_any_other() -> None:
    assert picked(StampThrottle(0.5), [0, 400, 500]) == [0.5, 0, 0.5]
