"""A camera's clock, the instants at which it exposes, the acquisition of frames then, and the trigger cable.

Exposures begin at whole multiples of the period, in step with every other camera, or when triggered.
"""

from __future__ import annotations

import random
import time
from collections import deque
from collections.abc import Callable
from fractions import Fraction
from functools import lru_cache

from capture_rig.stamps import UTC, CaptureClock
from gige_vision.gvcp import Action, Status
from gige_vision.gvsp import PixelFormat, image_leader, image_trailer, next_block_id

from .device import CameraSettings, Device, Faults
from .feature_table import PTP_STATES
from .imaging import ImagingPipeline, pixel_bytes
from .loop import EventLoop, Timer
from .registers import RegisterError
from .scenes import CameraScene
from .stream import StreamChannel

SECOND_NS = 1_000_000_000
TAI_MINUS_UTC_NS = 37 * SECOND_NS  # PTP counts TAI
MOST_HZ = 1000.0
_RATE_GRAIN = 1000  # rates are taken to 1/1000 Hz
LONGEST_BACKLOG_NS = 250_000_000  # frames, and pulses of the generator, that are late by more are left out
REMEMBERED = 4096
PERIODIC_SIGNAL = "PeriodicSignal1"


def next_multiple(after_ns: int, period_ns: Fraction) -> int:
    """Returns the first whole multiple of a period after an instant; to the nearest ns."""
    length, share = period_ns.numerator, period_ns.denominator  # whole numbers: a hundred times as fast
    index = -(-(2 * after_ns + 1) * share // (2 * length))  # the first that is rounded to beyond it
    return (2 * index * length + share) // (2 * share)


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
            reading = utc_ns + TAI_MINUS_UTC_NS + self._residual_ns
        else:
            elapsed = utc_ns - self._zero_ns
            reading = elapsed + round(elapsed * self._settings.drift_ppm * 1e-6)
        return max(reading + self._faults.stamp_jump_ns, 0)

    def utc_of(self, stamp_ns: int) -> int:
        """Returns the instant at which the clock reads ``stamp_ns``."""
        reading = stamp_ns - self._faults.stamp_jump_ns
        if self.is_synchronised:
            return reading - TAI_MINUS_UTC_NS - self._residual_ns
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


class Acquisition:
    """Acquires one camera's frames, from AcquisitionStart to AcquisitionStop. Only called from within the loop.

    Exposures begin at instants of the studio's clock (ns), of all cameras with one rate the same.
    """

    def __init__(
        self, device: Device, scene: CameraScene, clock: CameraClock, imaging: ImagingPipeline, stream: StreamChannel
    ) -> None:
        self.scene = scene
        self._registers, self._faults, self._counters = device.registers, device.faults, device.counters
        self._loop, self._clock, self._imaging, self._stream = device.loop, clock, imaging, stream
        self._now_ns = device.loop.clock.now_ns
        self.running = False
        self.lateness_ns: deque[int] = deque(maxlen=REMEMBERED)
        self._block_id = self._busy_until_ns = 0
        self._timers: list[Timer] = []
        r = self._registers
        r.reads["ResultingFrameRate"] = lambda: float(SECOND_NS / self.period_ns)
        r.writes |= {"AcquisitionStart": self.start, "AcquisitionStop": self.stop}
        r.writes["TriggerSoftware"] = lambda: self.trigger("Software", self._now_ns())
        r.writes |= dict.fromkeys(("TriggerMode", "TriggerSource"), self._rearm)

    @property
    def source(self) -> str:
        """What starts an exposure: "" (free running) or a trigger source."""
        return self._registers.label("TriggerSource") if self._registers.integer("TriggerMode") else ""

    @property
    def period_ns(self) -> Fraction:
        """Time between free-running exposures; not shorter than an exposure."""
        r = self._registers
        if self.source == PERIODIC_SIGNAL:
            rate_hz = 1e6 / r.real("BslPeriodicSignalPeriod")
        else:
            rate_hz = r.real("AcquisitionFrameRate") if r.integer("AcquisitionFrameRateEnable") else MOST_HZ
        return max(_period_ns(rate_hz), Fraction(self._imaging.exposure_ns))

    def start(self) -> None:
        if self.running:
            return
        self._stream.discard_blocks()
        self.running, self._block_id = True, 0
        self._busy_until_ns = self._now_ns()
        self._rearm()

    def stop(self) -> None:
        self.running = False
        self._cancel()

    def trigger(self, source: str, instant_ns: int) -> None:
        """Handles a trigger at an instant (of the loop's clock, ns)."""
        if not self.running or self.source != source:
            return
        start_ns = instant_ns + round(self._registers.real("TriggerDelay") * 1000)
        if start_ns < self._busy_until_ns:
            self._counters["triggers_missed"] += 1
            return
        self._counters["triggers"] += 1
        self._expose_at(start_ns)

    def execute_action(self, action: Action) -> bool:
        """Triggers at the time of an action command; False when it is meant for other cameras. Raises RegisterError."""
        r = self._registers
        if action.device_key != r.integer("ActionDeviceKey") or action.group_key != r.integer("ActionGroupKey"):
            return False
        if not action.group_mask & r.integer("ActionGroupMask"):
            return False
        self._counters["actions"] += 1
        if not self._clock.is_synchronised:
            raise RegisterError(Status.NO_REFERENCE_TIME)
        when_ns = self._clock.utc_of(action.time_ns)
        if when_ns < self._now_ns():
            self._counters["actions_late"] += 1
            raise RegisterError(Status.ACTION_LATE)
        self._timers.append(self._loop.call_at(when_ns, lambda: self.trigger("Action1", when_ns)))
        return True

    def _rearm(self) -> None:
        """Schedules the first exposure of a free-running camera; a triggered one waits."""
        self._cancel()
        if self.running:
            self._expose_after(self._now_ns())

    def _expose_after(self, after_ns: int) -> None:
        """Schedule the next exposure of a free-running camera."""
        period_ns = self.period_ns
        if self.source == PERIODIC_SIGNAL:  # which the camera's own clock counts
            start_ns = self._clock.utc_of(next_multiple(self._clock.stamp(after_ns), period_ns))
            self._expose_at(max(start_ns, after_ns + 1))
        elif not self.source:
            self._expose_at(next_multiple(after_ns, period_ns))

    def _expose_at(self, start_ns: int) -> None:
        exposure_ns = self._imaging.exposure_ns
        self._busy_until_ns = start_ns + exposure_ns
        self._timers = [timer for timer in self._timers if not timer.done()]
        self._timers.append(self._loop.call_at(start_ns + exposure_ns, lambda: self._read_out(start_ns, exposure_ns)))

    def _read_out(self, start_ns: int, exposure_ns: int) -> None:
        """Sends the frame when its exposure is over, and begins the next one."""
        late_ns = self._now_ns() - start_ns - exposure_ns
        self.lateness_ns.append(late_ns)
        self._counters["frames_exposed"] += 1
        if not self._faults.stall:
            self._send(start_ns, exposure_ns)
        self._expose_after(self._now_ns() if late_ns > LONGEST_BACKLOG_NS else start_ns)

    def _send(self, start_ns: int, exposure_ns: int) -> None:
        picture = self._imaging.capture(self.scene.image(start_ns + exposure_ns // 2))
        r, announced = self._registers, self._imaging.pixel_format
        self._block_id = next_block_id(self._block_id)
        data = pixel_bytes(picture, announced)
        if self._faults.wrong_format:
            announced = PixelFormat.Mono12 if announced is PixelFormat.Mono8 else PixelFormat.Mono8
        size_px, offset_px = (r.integer("Width"), r.integer("Height")), (r.integer("OffsetX"), r.integer("OffsetY"))
        leader = image_leader(self._clock.stamp(start_ns), announced, size_px, offset_px)
        self._stream.send(self._block_id, leader, data, image_trailer(size_px[1]))

    def _cancel(self) -> None:
        for timer in self._timers:
            timer.cancel()
        self._timers = []


@lru_cache
def _period_ns(rate_hz: float) -> Fraction:
    return SECOND_NS / Fraction(rate_hz).limit_denominator(_RATE_GRAIN)


class TriggerWire:
    """The cable to input Line1 of several cameras, which see each pulse at the same instant.

    run() is a pulse generator at a steady rate.
    """

    def __init__(self, loop: EventLoop) -> None:
        self._loop = loop
        self._listeners: list[Callable[[int], None]] = []
        self._timer: Timer | None = None

    def listen(self, callback: Callable[[int], None]) -> None:
        """Calls back with the instant (studio's clock, ns) of each rising edge, from within the loop."""
        self._listeners.append(callback)

    def run(self, rate_hz: float) -> None:
        """Generates pulses at whole multiples of the period of its clock, until another rate; 0: none."""

        def restart() -> None:
            if self._timer is not None:
                self._timer.cancel()
            if rate_hz:
                self._schedule(_period_ns(rate_hz))

        self._loop.call(restart)

    def _schedule(self, period_ns: Fraction) -> None:
        when_ns = next_multiple(self._loop.clock.now_ns(), period_ns)
        self._timer = self._loop.call_at(when_ns, lambda: self._tick(when_ns, period_ns))

    def _tick(self, when_ns: int, period_ns: Fraction) -> None:
        if self._loop.clock.now_ns() - when_ns < LONGEST_BACKLOG_NS:
            for listener in self._listeners:
                listener(when_ns)
        self._schedule(period_ns)
