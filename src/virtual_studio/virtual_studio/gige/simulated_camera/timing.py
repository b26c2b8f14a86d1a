"""When a camera exposes: at whole multiples of its period, in step with every other camera, or when it is triggered."""

from __future__ import annotations

import time
from collections.abc import Callable
from fractions import Fraction
from functools import lru_cache

from ..server.loop import EventLoop, Timer
from ..server.registers import Registers
from .clock import CameraClock
from .feature_table import ON, TRIGGER_SOURCES
from .imaging import ExposureControl

SECOND_NS = 1_000_000_000
MOST_HZ = 1000.0
_RATE_GRAIN = 1000  # rates are taken to 1/1000 Hz


def next_multiple(after_ns: int, period_ns: Fraction, origin_ns: int = 0) -> int:
    """The first whole multiple of a period, counted from the origin, that lies after an instant; to the nearest ns."""
    length, share = period_ns.numerator, period_ns.denominator  # whole numbers: a hundred times as fast
    index = (after_ns - origin_ns) * share // length + 1
    elapsed_ns = (2 * index * length + share) // (2 * share)
    if origin_ns + elapsed_ns <= after_ns:  # rounded down to where we are
        elapsed_ns = (2 * (index + 1) * length + share) // (2 * share)
    return origin_ns + elapsed_ns


class Timing:
    """The instants (UTC, ns) at which exposures begin. All cameras with one rate expose at the same ones."""

    def __init__(self, registers: Registers, clock: CameraClock, exposure: ExposureControl) -> None:
        self._registers, self._clock, self._exposure = registers, clock, exposure
        self._timer_rate, self._timer_start = 0.0, 0
        registers.writes["SyncFreeRunTimerUpdate"] = self._update_timer
        registers.reads["ResultingFrameRate"] = lambda: float(1 / self.period_s)

    def reset(self) -> None:
        self._timer_rate, self._timer_start = 0.0, 0

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
        """The first exposure that begins after an instant."""
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


# --- A trigger cable that several cameras share: whatever pulses it, they all see the pulse at the same instant.

LATENESS_NS = 250_000_000  # pulses later than this are left out


class TriggerWire:
    """The cameras' input Line1. pulse() is one rising edge; run() is a pulse generator at a steady rate."""

    def __init__(self, loop: EventLoop) -> None:
        self._loop = loop
        self._listeners: list[Callable[[int], None]] = []
        self._timer: Timer | None = None

    def listen(self, callback: Callable[[int], None]) -> None:
        """Call back with the instant (UTC, ns) of each rising edge, from within the loop."""
        self._listeners.append(callback)

    def pulse(self) -> int:
        """One rising edge now; returns its instant (UTC, ns)."""
        return self._loop.call(lambda: self._rise(time.time_ns()))

    def run(self, rate_hz: float) -> None:
        """Pulses at whole multiples of the period of UTC, until stop()."""
        self._loop.call(lambda: self._restart(Fraction(rate_hz).limit_denominator(1000)))

    def stop(self) -> None:
        """No more pulses from the generator."""
        self._loop.call(self._halt)

    def _restart(self, rate: Fraction) -> None:
        self._halt()
        self._schedule(rate)

    def _halt(self) -> None:
        if self._timer is not None:
            self._timer.cancel()
            self._timer = None

    def _schedule(self, rate: Fraction) -> None:
        period_ns = 1_000_000_000 / rate
        when_ns = int((time.time_ns() // period_ns + 1) * period_ns)
        self._timer = self._loop.call_at(when_ns, lambda: self._tick(when_ns, rate))

    def _tick(self, when_ns: int, rate: Fraction) -> None:
        if time.time_ns() - when_ns < LATENESS_NS:
            self._rise(when_ns)
        self._schedule(rate)

    def _rise(self, instant_ns: int) -> int:
        for listener in self._listeners:
            listener(instant_ns)
        return instant_ns
