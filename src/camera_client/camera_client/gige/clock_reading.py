"""Reading a camera's clock over the network: what it shows, and how well we know when it showed that."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

from gige_vision import bootstrap

from .errors import DeviceRefusal

READINGS = 5
SECOND = 1_000_000_000


class RegisterAccess(Protocol):
    """A device's 32-bit registers; raises DeviceRefusal or DeviceSilence."""

    def read_register(self, address: int) -> int: ...

    def write_register(self, address: int, value: int) -> None: ...


@dataclass(frozen=True)
class ClockReading:
    """The camera's clock showed ``camera_ns`` within ``uncertainty_ns`` of the host's ``host_ns`` (UTC)."""

    camera_ns: int
    host_ns: int
    uncertainty_ns: int

    @property
    def offset_ns(self) -> int:
        """Host minus camera time."""
        return self.host_ns - self.camera_ns


def read_clock(registers: RegisterAccess, host_clock: Callable[[], int]) -> ClockReading | None:
    """The best of a few readings; None for a device without a clock that can be read.

    The clock is latched by a register write, so that the instant lies between command and acknowledge: the middle is
    taken, and half the time between them is the uncertainty. Source: GigE Vision 2.x, registers 0x093C to 0x094C.
    """
    try:
        ticks_a_second = _long(registers, bootstrap.TICK_FREQUENCY_HIGH, bootstrap.TICK_FREQUENCY_LOW)
        if ticks_a_second == 0:
            return None
        readings = [_read_once(registers, host_clock, ticks_a_second) for _ in range(READINGS)]
    except DeviceRefusal:
        return None
    return min(readings, key=lambda reading: reading.uncertainty_ns)


def _read_once(registers: RegisterAccess, host_clock: Callable[[], int], ticks_a_second: int) -> ClockReading:
    before_ns = host_clock()
    registers.write_register(bootstrap.TIMESTAMP_CONTROL, bootstrap.TIMESTAMP_LATCH)
    after_ns = host_clock()
    ticks = _long(registers, bootstrap.TIMESTAMP_HIGH, bootstrap.TIMESTAMP_LOW)
    half_ns = (after_ns - before_ns) // 2
    return ClockReading(ticks * SECOND // ticks_a_second, before_ns + half_ns, half_ns + SECOND // ticks_a_second)


def _long(registers: RegisterAccess, high: int, low: int) -> int:
    return registers.read_register(high) << 32 | registers.read_register(low)
