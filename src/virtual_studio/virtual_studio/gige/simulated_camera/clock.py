"""A camera's clock: a counter since power-on that drifts, or, with PTP, the common time (TAI)."""

from __future__ import annotations

import random
import time

from ..server.settings import CameraSettings, Faults

TICKS_PER_SECOND = 1_000_000_000
LISTENING_SHARE = 0.4  # of the time it takes PTP to settle
PTP_STATES = {
    "Initializing": 1,
    "Faulty": 2,
    "Disabled": 3,
    "Listening": 4,
    "PreMaster": 5,
    "Master": 6,
    "Passive": 7,
    "Uncalibrated": 8,
    "Slave": 9,
}
"""Port states of IEEE 1588-2008, table 8."""


class CameraClock:
    """Stamps of the camera's own clock, ns, for instants of the system clock (UTC, ns), and back.

    Free running, it counts from power-on and drifts. With PTP it is in step (status Slave) after a while, and then
    it is TAI but for a small constant offset.
    """

    def __init__(self, settings: CameraSettings, faults: Faults) -> None:
        self._settings, self._faults = settings, faults
        self._rng = random.Random(settings.seed)
        self.power_on()

    def power_on(self) -> None:
        """The counter begins anew, PTP is off."""
        self._zero_ns = time.time_ns() - self._rng.randrange(2_000_000_000)  # it counted while the camera booted
        self._ptp_since_ns: int | None = None
        self._residual_ns = round(self._rng.uniform(-1, 1) * self._settings.ptp_offset_ns)

    def reset(self) -> None:
        """Count from 0 again."""
        self._zero_ns = time.time_ns()

    def enable_ptp(self, enabled: bool) -> None:
        if enabled != (self._ptp_since_ns is not None):
            self._ptp_since_ns = time.time_ns() if enabled else None

    def stamp(self, utc_ns: int) -> int:
        """The clock's reading at an instant."""
        if self.in_step:
            reading = utc_ns + self._tai_ns + self._residual_ns
        else:
            elapsed = utc_ns - self._zero_ns
            reading = elapsed + round(elapsed * self._settings.drift_ppm * 1e-6)
        return max(reading + self._faults.stamp_jump_ns, 0)

    def utc_of(self, stamp_ns: int) -> int:
        """The instant at which the clock reads ``stamp_ns``."""
        reading = stamp_ns - self._faults.stamp_jump_ns
        if self.in_step:
            return reading - self._tai_ns - self._residual_ns
        return self._zero_ns + round(reading / (1 + self._settings.drift_ppm * 1e-6))

    @property
    def in_step(self) -> bool:
        """True while PTP disciplines the clock."""
        return self.ptp_state == PTP_STATES["Slave"]

    @property
    def ptp_state(self) -> int:
        if self._ptp_since_ns is None:
            return PTP_STATES["Disabled"]
        if self._faults.ptp_lost or not self._settings.ptp_grandmaster:
            return PTP_STATES["Listening"]
        waited = (time.time_ns() - self._ptp_since_ns) * 1e-9
        if waited < LISTENING_SHARE * self._settings.ptp_settle_s:
            return PTP_STATES["Listening"]
        return PTP_STATES["Uncalibrated" if waited < self._settings.ptp_settle_s else "Slave"]

    @property
    def offset_from_master_ns(self) -> int:
        """What PtpOffsetFromMaster says: 0 as long as there is no master."""
        return self._residual_ns if self.in_step else 0

    @property
    def _tai_ns(self) -> int:
        return self._settings.tai_minus_utc_s * TICKS_PER_SECOND
