"""Maps a camera's own clock onto the host's, free of the jitter of the network and of our scheduling.

Every frame gives one bound: it cannot have arrived before it was taken, so arrival - camera time is the clocks' offset
plus a delay. The frames least delayed form the lower envelope of these differences; its slope is the drift between the
clocks (the line below all points that lies closest to them, an edge of their convex hull: Moon, Skelly and Towsley,
"Estimation and removal of clock skew from network delay measurements", INFOCOM 1999).
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from itertools import pairwise
from statistics import median

from gige_vision import bootstrap

from .features import DeviceAccess, DeviceRefusal

MS, SECOND = 1_000_000, 1_000_000_000
BUCKET_NS, BUCKETS = 250 * MS, 64  # the envelope: the least delayed frame of each quarter of a second, for 16 s
# Thresholds: method from Moon, Skelly & Towsley 1999; values judgement.
DRIFT_SPAN_NS = 4 * SECOND  # a drift is used once the envelope is this long
USUAL_DRIFT, MOST_DRIFT = 50e-6, 200e-6  # between two quartz clocks
JUMP_NS = 50 * MS  # delays vary by less, unless for a moment
LATE_NS = 5 * SECOND  # when everything is late for so long, the clock was set back


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
        self._late_since_ns: int | None = None
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
        above_ns = offset_ns - self.offset_ns(camera_ns)
        settled = bool(self._closed) and camera_ns - self._closed[0][0] > SECOND
        if above_ns < (-JUMP_NS if settled else -SECOND):  # it would have come before it was taken: set forward
            return True
        if above_ns < JUMP_NS:
            self._late_since_ns = None
        elif self._late_since_ns is None:
            self._late_since_ns = camera_ns
        return self._late_since_ns is not None and camera_ns - self._late_since_ns > LATE_NS

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


def read_clock(registers: DeviceAccess, host_clock: Callable[[], int]) -> ClockReading | None:
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


def _read_once(registers: DeviceAccess, host_clock: Callable[[], int], ticks_a_second: int) -> ClockReading:
    before_ns = host_clock()
    registers.write_register(bootstrap.TIMESTAMP_CONTROL, bootstrap.TIMESTAMP_LATCH)
    after_ns = host_clock()
    ticks = _long(registers, bootstrap.TIMESTAMP_HIGH, bootstrap.TIMESTAMP_LOW)
    half_ns = (after_ns - before_ns) // 2
    return ClockReading(ticks * SECOND // ticks_a_second, before_ns + half_ns, half_ns + SECOND // ticks_a_second)


def _long(registers: DeviceAccess, high: int, low: int) -> int:
    return registers.read_register(high) << 32 | registers.read_register(low)
