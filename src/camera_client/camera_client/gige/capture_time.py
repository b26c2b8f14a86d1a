"""Stamps frames with their time of capture on the system's clock (UTC), from PTP, the camera's clock, or arrival.

A camera's own clock is mapped onto the host's, free of the jitter of the network and of our scheduling. Every frame
gives one bound: it cannot have arrived before it was taken, so arrival - camera time is the clocks' offset plus a
delay. The frames least delayed form the lower envelope of these differences; its slope is the drift between the clocks
(the line below all points that lies closest to them, an edge of their convex hull: Moon, Skelly and Towsley,
"Estimation and removal of clock skew from network delay measurements", INFOCOM 1999).
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from itertools import pairwise
from statistics import median
from typing import NamedTuple

from capture_rig.errors import InputError
from gige_vision import bootstrap
from mocap_packets.frame_set import TIME_JUMP_NS

from ..settings import AravisSettings
from .features import AravisFeatures, DeviceRefusal

MS, SECOND = 1_000_000, 1_000_000_000
BUCKET_NS, BUCKETS = 250 * MS, 64  # the envelope: the least delayed frame of each quarter of a second, for 16 s
# Thresholds: method from Moon, Skelly & Towsley 1999; values judgement.
DRIFT_SPAN_NS = 4 * SECOND  # a drift is used once the envelope is this long
USUAL_DRIFT, MOST_DRIFT = 50e-6, 200e-6  # between two quartz clocks
JUMP_NS = 50 * MS  # delays vary by less, unless for a moment
# Thresholds: judgement, no measurement.
PTP_TOLERANCE_NS = 100 * MS  # a PTP clock further from the host's than this is set wrong
PTP_IN_STEP = ("Slave", "Master")
ARRIVAL_UNCERTAINTY_NS = 5 * MS  # readout, transfer and scheduling between the end of exposure and its first packet
UNREAD_CLOCK_UNCERTAINTY_NS = 1 * MS  # readout and first packet, of a camera whose clock cannot be read
UNSEEN_DELAY_NS = 200_000  # by which the smallest delay of a link may change as the computers' load does
SETTLING_NS = 8 * SECOND  # so long the smallest delay of a link is estimated; then it is kept
MIDDLE = {"exposure_start": 0.5, "exposure_middle": 0.0, "exposure_end": -0.5}
"""Share of the exposure from the instant that the camera stamps to its middle."""


class CameraClock:
    """Maps camera time to host time; both in ns.

    ``jumps`` counts how often the camera's clock was set: the map then begins anew.
    """

    def __init__(self) -> None:
        self.jumps = 0
        self._begin()

    def _begin(self) -> None:
        """Forget everything."""
        self._closed: deque[tuple[int, int]] = deque(maxlen=BUCKETS)  # (camera, offset) of the least delayed frames
        self._open: tuple[int, int] | None = None
        self._open_until_ns = 0
        self._drift, self._base_ns, self._origin_ns = 0.0, 0, 0  # offset = base + drift * (camera - origin)
        self.knows_drift = False
        self.spread_ns = 0.0  # how far the envelope's points typically lie above it: what we are not sure of
        self._last_camera_ns: int | None = None

    def to_host_ns(self, camera_ns: int, arrival_ns: int) -> int:
        """Host time of a camera time, for a frame that arrived at ``arrival_ns``: as if it was delayed the least.

        The result lies after the true instant by the smallest delay there is (exposure, readout, transfer).
        """
        if self._has_jumped(camera_ns, arrival_ns - camera_ns):
            self.jumps += 1
            self._begin()
        self._add(camera_ns, arrival_ns - camera_ns)
        self._last_camera_ns = camera_ns
        return camera_ns + round(self.offset_ns(camera_ns))

    def offset_ns(self, camera_ns: int) -> float:
        """Host minus camera time (smallest delay included) when the camera's clock shows ``camera_ns``."""
        return self._base_ns + self._drift * (camera_ns - self._origin_ns)

    @property
    def span_ns(self) -> int:
        """Camera time that the envelope covers."""
        return (self._last_camera_ns or 0) - self._closed[0][0] if self._closed else 0

    def _has_jumped(self, camera_ns: int, offset_ns: int) -> bool:
        if self._last_camera_ns is None:
            return False
        if camera_ns <= self._last_camera_ns:  # it went back
            return True
        settled = bool(self._closed) and camera_ns - self._closed[0][0] > SECOND
        early_ns = self.offset_ns(camera_ns) - offset_ns
        return early_ns > (JUMP_NS if settled else SECOND)  # it would have come before it was taken: set forward

    def _add(self, camera_ns: int, offset_ns: int) -> None:
        if self._open is not None and camera_ns >= self._open_until_ns:
            self._closed.append(self._open)
            self._open = None
            self._fit()
        if self._open is None:
            self._open, self._open_until_ns = (camera_ns, offset_ns), camera_ns + BUCKET_NS
        elif offset_ns - self._drift * (camera_ns - self._open[0]) < self._open[1]:
            self._open = (camera_ns, offset_ns)
        first = not self._closed and self._last_camera_ns is None
        if first or offset_ns < self.offset_ns(camera_ns):
            self._base_ns += round(offset_ns - self.offset_ns(camera_ns))  # the envelope lies below every frame

    def _fit(self) -> None:
        """The line below all points that is closest to them; level as long as their scatter hides a usual drift."""
        points = list(self._closed)
        span_ns = points[-1][0] - points[0][0]
        self._fit_line(points, _skew(points) if span_ns >= DRIFT_SPAN_NS else 0.0)
        self.knows_drift = span_ns >= DRIFT_SPAN_NS and self.spread_ns <= USUAL_DRIFT * span_ns
        if not self.knows_drift:
            self._fit_line(points, 0.0)

    def _fit_line(self, points: list[tuple[int, int]], drift: float) -> None:
        """The highest line of this slope that lies below all points."""
        self._drift, self._origin_ns = drift, points[-1][0]
        self._base_ns = round(min(offset - drift * (camera - self._origin_ns) for camera, offset in points))
        self.spread_ns = median(offset - self.offset_ns(camera) for camera, offset in points)


def _skew(points: list[tuple[int, int]]) -> float:
    """Slope of the edge of the lower convex hull above the middle of ``points`` (sorted by their first coordinate)."""
    hull: list[tuple[int, int]] = []
    for point in points:
        while len(hull) > 1 and _orientation(hull[-2], hull[-1], point) <= 0:
            hull.pop()
        hull.append(point)
    middle = sum(camera for camera, _ in points) / len(points)
    left, right = next((pair for pair in pairwise(hull) if pair[1][0] >= middle), (hull[0], hull[-1]))
    slope = (right[1] - left[1]) / (right[0] - left[0])
    return min(max(slope, -MOST_DRIFT), MOST_DRIFT)


def _orientation(a: tuple[int, int], b: tuple[int, int], c: tuple[int, int]) -> int:
    """Positive when a, b, c turn left."""
    return (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])


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


class ArrivalTime:
    """The host's clock at the first packet, less half the exposure: cameras send once the exposure is over.

    Uncertain by half the exposure and what readout, transfer and scheduling may take.
    """

    name, jumps = "host, at arrival", 0

    def stamp(self, times: FrameTimes) -> Stamp:
        half_ns = times.exposure_ns // 2
        return Stamp(times.arrival_ns - half_ns, half_ns + ARRIVAL_UNCERTAINTY_NS, self.name)


class CameraTime:
    """The camera's own clock, mapped onto the host's by the least delayed frames.

    reading : of the camera's clock at the start: it gives the smallest delay of a frame, which is then taken out. None:
        the delay is taken for the rest of the exposure, and the stamp is uncertain by a millisecond more.

    Uncertain by that of the reading and by how unsteady the smallest delay is (twice the median height of the
    envelope's points, and 0.2 ms for changes that no frame shows); in the first seconds by the drift that is not known
    yet instead, and in the first second after the camera's clock was set by what a frame may be late.
    """

    name = "camera, mapped onto the host"

    def __init__(self, reading: ClockReading | None, camera_stamps: str) -> None:
        self._reading, self._camera_stamps = reading, camera_stamps
        self._clock = CameraClock()
        self._delay_ns: int | None = None

    @property
    def jumps(self) -> int:
        return self._clock.jumps

    def stamp(self, times: FrameTimes) -> Stamp:
        host_ns = self._clock.to_host_ns(times.camera_ns, times.arrival_ns)
        to_middle_ns = round(MIDDLE[self._camera_stamps] * times.exposure_ns)
        delay_ns = self._smallest_delay(times)
        unsure_ns = UNREAD_CLOCK_UNCERTAINTY_NS if self._reading is None else self._reading.uncertainty_ns
        if self._clock.jumps and self._clock.span_ns < SECOND:
            unsure_ns += ARRIVAL_UNCERTAINTY_NS
        if self._clock.knows_drift:
            unsure_ns += UNSEEN_DELAY_NS
        else:
            unsure_ns += round(USUAL_DRIFT * self._clock.span_ns)
        unsure_ns += round(2 * self._clock.spread_ns)
        return Stamp(host_ns - delay_ns + to_middle_ns, unsure_ns, self.name)

    def _smallest_delay(self, times: FrameTimes) -> int:
        """From the instant that the camera stamps to the arrival of the least delayed frame."""
        if self._reading is None:
            return round((0.5 + MIDDLE[self._camera_stamps]) * times.exposure_ns)
        if self._delay_ns is None or (self._clock.jumps == 0 and self._clock.span_ns < SETTLING_NS):
            at_reading_ns = self._clock.offset_ns(self._reading.camera_ns)
            self._delay_ns = max(round(at_reading_ns - self._reading.offset_ns), 0)
        return self._delay_ns


class PtpTime:
    """A camera's clock that PTP keeps: TAI (or UTC, where the grandmaster says so), no mapping needed.

    tai_utc_offset_s : seconds by which the clock is ahead of UTC.
    uncertainty_ns : how well the camera's clock was found to agree with the system's at the start.
    fallback : stamps the frames whose PTP time cannot be right: after they arrived, or long before. ``jumps`` counts
        how often that began.
    """

    name = "PTP"

    def __init__(self, tai_utc_offset_s: int, camera_stamps: str, uncertainty_ns: int, fallback: CameraTime) -> None:
        self._ahead_ns, self._camera_stamps = tai_utc_offset_s * SECOND, camera_stamps
        self._uncertainty_ns, self._fallback = uncertainty_ns, fallback
        self._in_step = True
        self.jumps = 0

    def stamp(self, times: FrameTimes) -> Stamp:
        mapped = self._fallback.stamp(times)
        taken_ns = times.camera_ns - self._ahead_ns + round(MIDDLE[self._camera_stamps] * times.exposure_ns)
        in_step = abs(taken_ns - mapped.ns) <= PTP_TOLERANCE_NS
        self.jumps += self._in_step and not in_step
        self._in_step = in_step
        return Stamp(taken_ns, self._uncertainty_ns, self.name) if in_step else mapped


TimeSource = ArrivalTime | CameraTime | PtpTime
"""Stamps the frames of one run, in the order of their arrival (see :func:`after_last`): ``stamp(times)``.

``name``: whose clock the stamps are from, for diagnostics; ``jumps``: how often it was found to have been set.
"""


def after_last(stamp_ns: int, last_ns: int) -> int:
    """Return ``stamp_ns``, or a nanosecond after the last one if that is later by less than a clock is set by."""
    return last_ns + 1 if 0 <= last_ns - stamp_ns < TIME_JUMP_NS else stamp_ns


def choose_time_source(
    settings: AravisSettings, reading: ClockReading | None, ptp_status: str | None, where: str
) -> tuple[TimeSource, str]:
    """Return the source for ``settings.stamp_source``, and a warning ("" when there is none).

    ptp_status : the camera's PTP status; None where it has no PTP.
    Raises InputError when PTP was demanded and the camera's clock is not that of PTP.
    """
    wanted, offset_s = settings.stamp_source, settings.tai_utc_offset_s
    if wanted == "arrival":
        return ArrivalTime(), ""
    mapped = CameraTime(reading, settings.camera_stamps)
    in_step = ptp_status in PTP_IN_STEP
    if wanted == "camera" or (wanted == "auto" and not in_step):
        return mapped, ""
    if not in_step:
        objection = f"its PTP status is {ptp_status}, not {' or '.join(PTP_IN_STEP)} (is a grandmaster on the network?)"
    elif reading is None:
        objection = "the camera's clock cannot be read, so nothing shows that it is in step with this host's"
    else:
        away_ns = -reading.offset_ns - offset_s * SECOND
        unsure_ns = max(abs(away_ns), reading.uncertainty_ns)
        if unsure_ns <= PTP_TOLERANCE_NS + reading.uncertainty_ns:
            return PtpTime(offset_s, settings.camera_stamps, unsure_ns, mapped), ""
        objection = (
            f"its clock is {offset_s + away_ns / SECOND:.3f} s ahead of this host's UTC, not {offset_s} s as "
            "aravis.tai_utc_offset_s says (37: the grandmaster gives TAI, 0: UTC); set that right, or this host's "
            "clock (chrony; ptp4l and phc2sys)"
        )
    if wanted == "ptp":
        remedy = "Set aravis.stamp_source to auto or camera to do without."
        raise InputError(f"cannot be stamped by PTP: {objection}", where=where, remedy=remedy)
    return mapped, f"PTP is not used for stamps: {objection}"
