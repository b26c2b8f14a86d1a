"""A camera's clock, the instants at which it exposes, and the trigger cable.

Exposures begin at whole multiples of the period, in step with every other camera, or when triggered.
"""

from __future__ import annotations

import random
import time
from collections.abc import Callable
from fractions import Fraction
from functools import lru_cache

from capture_rig.stamps import UTC, CaptureClock

from .device import CameraSettings, Faults
from .feature_table import ON, PTP_STATES, TICKS_PER_SECOND, TRIGGER_SOURCES
from .imaging import ExposureControl
from .loop import EventLoop, Timer
from .registers import Registers

SECOND_NS = 1_000_000_000
MOST_HZ = 1000.0
_RATE_GRAIN = 1000  # rates are taken to 1/1000 Hz
LONGEST_BACKLOG_NS = 250_000_000  # frames, and pulses of the generator, that are late by more are left out


def next_multiple(after_ns: int, period_ns: Fraction, origin_ns: int = 0) -> int:
    """Returns the first whole multiple of a period, counted from the origin, after an instant; to the nearest ns."""
    length, share = period_ns.numerator, period_ns.denominator  # whole numbers: a hundred times as fast
    index = -(-(2 * (after_ns - origin_ns) + 1) * share // (2 * length))  # the first that is rounded to beyond it
    return origin_ns + (2 * index * length + share) // (2 * share)


class CameraClock:
    """A camera's clock: stamps, ns, for instants of the studio's clock (UTC, unless in slow motion; ns), and back.

    Free running, it counts from power-on and drifts. With PTP it is synchronised (status Slave) after a while, and then
    it is TAI but for a small constant offset.
    """

    def __init__(self, settings: CameraSettings, faults: Faults, clock: CaptureClock = UTC) -> None:
        self._settings, self._faults, self._now_ns = settings, faults, clock.now_ns
        rng = random.Random(settings.seed)
        self._zero_ns = self._now_ns() - rng.randrange(2_000_000_000)  # it counted while the camera booted
        self._ptp_since_ns: int | None = None
        self._residual_ns = round(rng.uniform(-1, 1) * settings.ptp_offset_ns)

    def enable_ptp(self, enabled: bool) -> None:
        if enabled != (self._ptp_since_ns is not None):
            self._ptp_since_ns = time.monotonic_ns() if enabled else None

    def stamp(self, utc_ns: int) -> int:
        """Returns the clock's reading at an instant."""
        if self.is_synchronised:
            reading = utc_ns + self._tai_ns + self._residual_ns
        else:
            elapsed = utc_ns - self._zero_ns
            reading = elapsed + round(elapsed * self._settings.drift_ppm * 1e-6)
        return max(reading + self._faults.stamp_jump_ns, 0)

    def utc_of(self, stamp_ns: int) -> int:
        """Returns the instant at which the clock reads ``stamp_ns``."""
        reading = stamp_ns - self._faults.stamp_jump_ns
        if self.is_synchronised:
            return reading - self._tai_ns - self._residual_ns
        return self._zero_ns + round(reading / (1 + self._settings.drift_ppm * 1e-6))

    @property
    def is_synchronised(self) -> bool:
        """True while PTP disciplines the clock."""
        return self.ptp_state == PTP_STATES["Slave"]

    @property
    def ptp_state(self) -> int:
        if self._ptp_since_ns is None:
            return PTP_STATES["Disabled"]
        settled = (time.monotonic_ns() - self._ptp_since_ns) * 1e-9 >= self._settings.ptp_settle_s
        return PTP_STATES["Slave" if settled and not self._faults.ptp_lost else "Listening"]

    @property
    def _tai_ns(self) -> int:
        return self._settings.tai_minus_utc_s * TICKS_PER_SECOND


class Timing:
    """The instants (studio's clock, ns) at which exposures begin, for all cameras with one rate the same."""

    def __init__(self, registers: Registers, clock: CameraClock, exposure: ExposureControl) -> None:
        self._registers, self._clock, self._exposure = registers, clock, exposure
        self._timer_rate, self._timer_start = 0.0, 0
        registers.writes["SyncFreeRunTimerUpdate"] = self._update_timer
        registers.reads["ResultingFrameRate"] = lambda: float(1 / self.period_s)

    @property
    def source(self) -> str:
        """What starts an exposure: "" (free running) or a trigger source."""
        r = self._registers
        if r.integer("TriggerMode") != ON:
            return ""
        return next(name for name, value in TRIGGER_SOURCES.items() if value == r.integer("TriggerSource"))

    @property
    def is_periodic(self) -> bool:
        """True when exposures follow each other by themselves."""
        return self.source in ("", "PeriodicSignal1")

    @property
    def period_s(self) -> Fraction:
        """Seconds between exposures; not shorter than an exposure."""
        r = self._registers
        if self.source == "PeriodicSignal1":
            signal_ns = round(r.real("BslPeriodicSignalPeriod") * 1000)
            return Fraction(max(signal_ns, self._exposure.exposure_ns), SECOND_NS)
        if self._free_run_timer:
            rate_hz = self._timer_rate
        else:
            rate_hz = r.real("AcquisitionFrameRate") if r.integer("AcquisitionFrameRateEnable") else MOST_HZ
        return _period_s(rate_hz, self._exposure.exposure_ns)

    def next_start(self, after_ns: int) -> int:
        """Returns when the first exposure after an instant begins."""
        period_ns = _nanoseconds(self.period_s)
        if self.source == "PeriodicSignal1":
            delay_ns = round(self._registers.real("BslPeriodicSignalDelay") * 1000)
            return self._in_camera_time(after_ns, period_ns, delay_ns)
        if self._free_run_timer:
            return self._in_camera_time(after_ns, period_ns, self._timer_start)
        return next_multiple(after_ns, period_ns)

    @property
    def trigger_delay_ns(self) -> int:
        return round(self._registers.real("TriggerDelay") * 1000)

    @property
    def _free_run_timer(self) -> bool:
        return bool(self._registers.integer("SyncFreeRunTimerEnable")) and self._timer_rate > 0

    def _in_camera_time(self, after_ns: int, period_ns: Fraction, origin_ns: int) -> int:
        """Multiples that the camera's own clock counts."""
        after = self._clock.stamp(after_ns)
        start = origin_ns if after < origin_ns else next_multiple(after, period_ns, origin_ns)
        return max(self._clock.utc_of(start), after_ns + 1)

    def _update_timer(self) -> None:
        r = self._registers
        self._timer_rate = r.real("SyncFreeRunTimerTriggerRate")
        self._timer_start = r.integer("SyncFreeRunTimerStartTimeHigh") << 32 | r.integer("SyncFreeRunTimerStartTimeLow")


@lru_cache
def _period_s(rate_hz: float, exposure_ns: int) -> Fraction:
    return max(1 / Fraction(rate_hz).limit_denominator(_RATE_GRAIN), Fraction(exposure_ns, SECOND_NS))


@lru_cache
def _nanoseconds(seconds: Fraction) -> Fraction:
    return seconds * SECOND_NS


class TriggerWire:
    """The cable to input Line1 of several cameras, which see each pulse at the same instant.

    pulse() is one rising edge; run() is a pulse generator at a steady rate.
    """

    def __init__(self, loop: EventLoop) -> None:
        self._loop = loop
        self._listeners: list[Callable[[int], None]] = []
        self._timer: Timer | None = None

    def listen(self, callback: Callable[[int], None]) -> None:
        """Calls back with the instant (studio's clock, ns) of each rising edge, from within the loop."""
        self._listeners.append(callback)

    def pulse(self) -> int:
        """Makes one rising edge now; returns its instant (studio's clock, ns)."""
        return self._loop.call(lambda: self._rise(self._loop.clock.now_ns()))

    def run(self, rate_hz: float) -> None:
        """Generates pulses at whole multiples of the period of its clock, until another rate; 0: none."""
        self._loop.call(lambda: self._restart(Fraction(rate_hz).limit_denominator(_RATE_GRAIN)))

    def _restart(self, rate: Fraction) -> None:
        if self._timer is not None:
            self._timer.cancel()
            self._timer = None
        if rate:
            self._schedule(rate)

    def _schedule(self, rate: Fraction) -> None:
        when_ns = next_multiple(self._loop.clock.now_ns(), SECOND_NS / rate)
        self._timer = self._loop.call_at(when_ns, lambda: self._tick(when_ns, rate))

    def _tick(self, when_ns: int, rate: Fraction) -> None:
        if self._loop.clock.now_ns() - when_ns < LONGEST_BACKLOG_NS:
            self._rise(when_ns)
        self._schedule(rate)

    def _rise(self, instant_ns: int) -> int:
        for listener in self._listeners:
            listener(instant_ns)
        return instant_ns
