"""Clocks and instants of exposure: arithmetic, without any camera."""

import threading
import time
from collections import Counter
from fractions import Fraction
from types import SimpleNamespace

import pytest
from gige_client import eventually
from hypothesis import given
from hypothesis import strategies as st

from virtual_studio.gige import CameraSettings, EventLoop, Faults, Playback, TriggerWire
from virtual_studio.gige.acquisition import CameraClock, next_multiple

SECOND_NS = 1_000_000_000
NOW_NS = 1_800_000_000 * SECOND_NS
TAI_NS = 37 * SECOND_NS

instants = st.integers(NOW_NS, NOW_NS + 10**15)
rates = st.sampled_from([0.5, 25, 29.97, 30, 59.94, 60, 100, 120, 999.9])


@pytest.fixture
def now(monkeypatch):
    """A system clock that stands still until it is moved."""
    clock = SimpleNamespace(ns=NOW_NS, time_ns=lambda: clock.ns, monotonic_ns=lambda: clock.ns)
    for module in ("virtual_studio.gige.acquisition", "capture_rig.stamps"):
        monkeypatch.setattr(f"{module}.time", clock)
    return clock


@given(instants, rates)
def test_next_multiple_lies_ahead_by_at_most_a_period_on_a_grid_that_all_cameras_share(after_ns, rate):
    period_ns = SECOND_NS / Fraction(rate).limit_denominator(1000)
    instant = next_multiple(after_ns, period_ns)
    assert after_ns < instant <= after_ns + period_ns + 1
    assert abs(instant / period_ns - round(instant / period_ns)) * period_ns <= Fraction(1, 2)
    second = next_multiple(instant, period_ns)
    assert next_multiple(instant + 1, period_ns) == next_multiple(second - 1, period_ns) == second


@given(st.integers(0, 10**13), st.floats(-500, 500))
def test_free_running_clock_drifts_by_its_ppm_and_its_readings_lead_back_to_their_instants(elapsed_ns, drift_ppm):
    clock = CameraClock(CameraSettings(drift_ppm=drift_ppm), Faults())
    begin_ns = time.time_ns()
    first, last = (clock.stamp(instant_ns) for instant_ns in (begin_ns, begin_ns + elapsed_ns))
    assert last - first == pytest.approx(elapsed_ns * (1 + drift_ppm * 1e-6), abs=2)
    assert clock.utc_of(last) == pytest.approx(begin_ns + elapsed_ns, abs=2)


def test_ptp_goes_through_listening_to_slave_and_then_counts_tai(now):
    clock = CameraClock(CameraSettings(ptp_settle_s=1.0, ptp_offset_ns=50), Faults())
    assert clock.ptp_state == 3
    clock.enable_ptp(True)
    states = []
    for ms in (100, 900, 1100):
        now.ns = NOW_NS + ms * 1_000_000
        states.append(clock.ptp_state)
    assert states == [4, 4, 9]
    assert abs(clock.stamp(now.ns) - now.ns - TAI_NS) <= 50
    clock.enable_ptp(False)
    assert clock.stamp(now.ns) < 10 * SECOND_NS


@pytest.mark.parametrize("rate", [25.0, 59.94, 60.0, 100.0])
def test_free_running_camera_at_the_stage_s_rate_sees_every_frame_once_and_then_the_last_or_the_first(rate):
    playback = Playback(frames=400, fps=rate)
    start = playback.play(NOW_NS, loop=False)
    assert playback.frame_at(start - SECOND_NS) == 0
    period_ns = SECOND_NS / Fraction(rate).limit_denominator(1000)
    seen, instant = [], start - 1
    for _ in range(500):
        instant = next_multiple(instant, period_ns)
        seen.append(playback.frame_at(instant + 2_000_000))  # the middle of 4 ms of exposure
    assert seen == [*range(400), *[399] * 100]
    playback.loop = True
    assert playback.frame_at(instant + 2_000_000) == 99
    playback.hold()
    assert playback.frame_at(instant) == 0


@pytest.fixture
def loop():
    loop = EventLoop()
    loop.start()
    yield loop
    loop.stop()


def test_timer_never_runs_before_its_time(loop):
    early, done = [], threading.Event()

    def check(when_ns, left):
        early.append(max(when_ns - time.time_ns(), 0))
        if left:
            after_ns = time.time_ns() + 1_300_000 * left
            loop.call_at(after_ns, lambda: check(after_ns, left - 1))
        else:
            done.set()

    loop.call(lambda: check(time.time_ns(), 12))
    assert done.wait(30)
    assert max(early) == 0


def test_error_in_one_callback_hurts_nobody_else(loop, caplog):
    done = threading.Event()

    def fail():
        raise ValueError("broken camera")

    loop.call(lambda: (loop.call_at(0, fail), loop.call_at(1, done.set)))
    assert done.wait(30)
    assert "broken camera" in caplog.text
    with pytest.raises(ValueError, match="broken camera"):
        loop.call(fail)


def test_pulse_generator_pulses_at_whole_multiples_of_its_period(loop):
    wire, pulses = TriggerWire(loop), Counter()
    wire.listen(lambda instant_ns: pulses.update([instant_ns]))
    wire.run(200.0)
    eventually(lambda: len(pulses) >= 5)
    wire.run(0)
    assert all(instant_ns % 5_000_000 == 0 for instant_ns in pulses)
    assert set(pulses.values()) == {1}
