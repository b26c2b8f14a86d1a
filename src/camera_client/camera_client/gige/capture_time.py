"""Stamps frames with their time of capture on the system's clock (UTC), from PTP, or from the camera's clock.

A camera's own clock is mapped onto the host's, free of the jitter of the network and of our scheduling. Every frame
gives one bound: it cannot have arrived before it was taken, so arrival - camera time is the clocks' offset plus a
delay. The frame of the last four seconds that was least delayed gives the offset: in that time two quartz clocks drift
apart by 0.2 ms (50 ppm) at most.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from statistics import median
from typing import NamedTuple

from capture_rig.errors import InputError
from gige_vision import bootstrap
from mocap_packets.frame_set import TIME_JUMP_NS

from ..settings import AravisSettings
from .features import AravisFeatures, DeviceRefusal

MS, SECOND = 1_000_000, 1_000_000_000
BUCKET_NS, BUCKETS = 250 * MS, 16  # the least delayed frame of each quarter of a second, for 4 s
# Thresholds: judgement, no measurement.
JUMP_NS = 50 * MS  # delays vary by less, unless for a moment
PTP_TOLERANCE_NS = 100 * MS  # a PTP clock further from the host's than this is set wrong
PTP_IN_STEP = ("Slave", "Master")
MAPPED, PTP = "camera, mapped onto the host", "PTP"  # whose clock a stamp is from
LATE_NS = 5 * MS  # what readout, transfer and scheduling may take from the end of exposure to a frame's first packet
UNREAD_CLOCK_UNCERTAINTY_NS = 1 * MS  # readout and first packet, of a camera whose clock cannot be read
UNSEEN_DELAY_NS = 200_000  # by which the smallest delay may change with the computers' load, or a drift not seen yet
MIDDLE = {"exposure_start": 0.5, "exposure_middle": 0.0, "exposure_end": -0.5}
"""Share of the exposure from the instant that the camera stamps to its middle."""


# --- reading a camera's clock over the network

READINGS = 5


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


def read_clock(registers: AravisFeatures, host_clock: Callable[[], int]) -> ClockReading | None:
    """Return the best of a few readings; None for a device without a clock that can be read.

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


def _read_once(registers: AravisFeatures, host_clock: Callable[[], int], ticks_a_second: int) -> ClockReading:
    before_ns = host_clock()
    registers.write_register(bootstrap.TIMESTAMP_CONTROL, bootstrap.TIMESTAMP_LATCH)
    after_ns = host_clock()
    ticks = _long(registers, bootstrap.TIMESTAMP_HIGH, bootstrap.TIMESTAMP_LOW)
    half_ns = (after_ns - before_ns) // 2
    return ClockReading(ticks * SECOND // ticks_a_second, before_ns + half_ns, half_ns + SECOND // ticks_a_second)


def _long(registers: AravisFeatures, high: int, low: int) -> int:
    return registers.read_register(high) << 32 | registers.read_register(low)


# --- from what a frame carries to the stamp of mid-exposure and a bound on its error


class FrameTimes(NamedTuple):
    """What is known of one frame, ns: the camera's stamp on its clock, arrival of the first packet on ours (UTC)."""

    camera_ns: int
    arrival_ns: int
    exposure_ns: int


class Stamp(NamedTuple):
    """Mid-exposure on the system's clock (UTC, ns), how far that may be off, and whose clock it is from."""

    ns: int
    uncertainty_ns: int
    clock: str


class CameraTime:
    """The camera's own clock, mapped onto the host's by the least delayed frames; or as it is, where PTP keeps it.

    It stamps the frames of one run, in the order of their arrival (see :func:`after_last`).

    reading : of the camera's clock at the start: it gives the smallest delay of a frame, which is then taken out. None:
        the delay is taken for the rest of the exposure, and the stamp is uncertain by a millisecond more.
    ptp_ahead_ns : by how much a PTP clock is ahead of UTC (TAI, or 0 where the grandmaster gives UTC); None: no PTP. A
        frame whose PTP time cannot be right, after it arrived or long before, is stamped by the map.
    ptp_uncertainty_ns : how well the camera's clock was found to agree with the system's at the start.

    The map is uncertain by what the reading is and by how unsteady the smallest delay is (twice the spread of the least
    delayed frames, and 0.2 ms for changes that no frame shows); in the first second after the camera's clock was set
    also by what a frame may be late. ``jumps`` counts how often it was: the map then begins anew.
    ``name``: whose clock the stamps are from, for diagnostics.
    """

    def __init__(
        self,
        reading: ClockReading | None,
        camera_stamps: str,
        ptp_ahead_ns: int | None = None,
        ptp_uncertainty_ns: int = 0,
    ) -> None:
        self._reading, self._to_middle = reading, MIDDLE[camera_stamps]
        self._ptp_ahead_ns, self._ptp_uncertainty_ns = ptp_ahead_ns, ptp_uncertainty_ns
        self.name = MAPPED if ptp_ahead_ns is None else PTP
        self.jumps = 0
        self._least: deque[tuple[int, int]] = deque(maxlen=BUCKETS)  # camera time that begins a bucket, least offset
        self._first_ns = self._last_ns = 0  # frames' camera times since the map began
        self._delay_ns: int | None = None

    def stamp(self, times: FrameTimes) -> Stamp:
        self._add_bound(times.camera_ns, times.arrival_ns - times.camera_ns)
        to_middle_ns = round(self._to_middle * times.exposure_ns)
        # as if the frame was delayed the least
        mapped_ns = times.camera_ns + self._offset_ns - self._smallest_delay(times) + to_middle_ns
        if self._ptp_ahead_ns is not None:
            taken_ns = times.camera_ns - self._ptp_ahead_ns + to_middle_ns
            if abs(taken_ns - mapped_ns) <= PTP_TOLERANCE_NS:
                return Stamp(taken_ns, self._ptp_uncertainty_ns, PTP)
        spread_ns = median(offset_ns for _, offset_ns in self._least) - self._offset_ns
        unsure_ns = UNREAD_CLOCK_UNCERTAINTY_NS if self._reading is None else self._reading.uncertainty_ns
        unsure_ns += UNSEEN_DELAY_NS + round(2 * spread_ns)
        if self.jumps and self._span_ns < SECOND:
            unsure_ns += LATE_NS
        return Stamp(mapped_ns, unsure_ns, MAPPED)

    @property
    def _offset_ns(self) -> int:
        """Host minus camera time, smallest delay included."""
        return min(offset_ns for _, offset_ns in self._least)

    @property
    def _span_ns(self) -> int:
        """Camera time since the map began."""
        return self._last_ns - self._first_ns

    def _add_bound(self, camera_ns: int, offset_ns: int) -> None:
        """Take a frame's offset, host minus camera time, into the map."""
        if self._least:
            early_ns = self._offset_ns - offset_ns  # it would have come before it was taken: set forward
            if camera_ns <= self._last_ns or early_ns > (JUMP_NS if self._span_ns > SECOND else SECOND):
                self.jumps += 1
                self._least.clear()
        if not self._least:
            self._first_ns = camera_ns
        if not self._least or camera_ns - self._least[-1][0] >= BUCKET_NS:
            self._least.append((camera_ns, offset_ns))
        else:
            begun_ns, least_ns = self._least[-1]
            self._least[-1] = begun_ns, min(least_ns, offset_ns)
        self._last_ns = camera_ns

    def _smallest_delay(self, times: FrameTimes) -> int:
        """From the instant that the camera stamps to the arrival of the least delayed frame."""
        if self._reading is None:
            return round((0.5 + self._to_middle) * times.exposure_ns)
        if self._delay_ns is None or (self.jumps == 0 and self._span_ns < BUCKETS * BUCKET_NS):
            self._delay_ns = max(self._offset_ns - self._reading.offset_ns, 0)
        return self._delay_ns


def after_last(stamp_ns: int, last_ns: int) -> int:
    """Return ``stamp_ns``, or a nanosecond after the last one if that is later by less than a clock is set by."""
    return last_ns + 1 if 0 <= last_ns - stamp_ns < TIME_JUMP_NS else stamp_ns


def choose_time_source(
    settings: AravisSettings, reading: ClockReading | None, ptp_status: str | None, where: str
) -> tuple[CameraTime, str]:
    """Return the source for ``settings.stamp_source``, and a warning ("" when there is none).

    ptp_status : the camera's PTP status; None where it has no PTP.
    Raises InputError when PTP was demanded and the camera's clock is not that of PTP.
    """
    wanted, offset_s = settings.stamp_source, settings.tai_utc_offset_s
    mapped = CameraTime(reading, settings.camera_stamps)
    in_step = ptp_status in PTP_IN_STEP
    if wanted == "camera" or (wanted == "auto" and not in_step):
        return mapped, ""
    if not in_step or reading is None:
        objection = "its clock cannot be read" if in_step else f"its PTP status is {ptp_status}"
    else:
        away_ns = -reading.offset_ns - offset_s * SECOND
        unsure_ns = max(abs(away_ns), reading.uncertainty_ns)
        if unsure_ns <= PTP_TOLERANCE_NS + reading.uncertainty_ns:
            return CameraTime(reading, settings.camera_stamps, offset_s * SECOND, unsure_ns), ""
        objection = (
            f"its clock is {offset_s + away_ns / SECOND:.3f} s ahead of this host's UTC, not {offset_s} s as "
            "aravis.tai_utc_offset_s says (37: the grandmaster gives TAI, 0: UTC); set that right, or this host's "
            "clock (chrony; ptp4l and phc2sys)"
        )
    if wanted == "ptp":
        remedy = "Is a grandmaster on the network? Set aravis.stamp_source to auto or camera to do without."
        raise InputError(f"cannot be stamped by PTP: {objection}", where=where, remedy=remedy)
    return mapped, f"PTP is not used for stamps: {objection}"
