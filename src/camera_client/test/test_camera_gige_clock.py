"""A camera's clock mapped onto the host's, and the stamps made from it, against clocks whose truth is known."""

import numpy as np
import pytest

from camera_client.gige.capture_time import (
    CameraTime,
    ClockReading,
    FrameTimes,
    after_last,
    choose_time_source,
    read_clock,
)
from camera_client.gige.features import DeviceRefusal
from camera_client.settings import AravisSettings
from capture_rig.errors import InputError

US, MS, SECOND = 1_000, 1_000_000, 1_000_000_000
PERIOD_NS = 10 * MS
HOST_EPOCH_NS = 1_700_000_000 * SECOND
DELAY_NS = 400 * US  # of the least delayed frame


def camera_times(count, start_ns=7 * SECOND):
    return start_ns + np.arange(count) * PERIOD_NS


def host_times(camera_ns, drift=0.0):
    """The same instants on the host's clock, when the camera's clock is slow by ``drift``."""
    return HOST_EPOCH_NS + np.round((camera_ns - camera_ns[0]) * (1 + drift)).astype(np.int64)


def delays(count, seed=0):
    return DELAY_NS + (np.random.default_rng(seed).exponential(2.0, count) * MS).astype(np.int64)


def stamps_of(source, camera_ns, arrival_ns, exposure_ns=0):
    times = zip(camera_ns, arrival_ns, strict=True)
    return [source.stamp(FrameTimes(int(camera), int(arrival), exposure_ns)) for camera, arrival in times]


@pytest.mark.parametrize("drift_ppm", [-50, 0, 12, 50])
def test_jitter_of_arrival_is_taken_out_and_drift_is_followed_for_minutes(drift_ppm):
    camera_ns = camera_times(9000)
    true_ns = host_times(camera_ns, drift_ppm * 1e-6)
    source = CameraTime(ClockReading(int(camera_ns[0]), HOST_EPOCH_NS, 60 * US), "exposure_start")
    stamps = stamps_of(source, camera_ns, true_ns + delays(9000))
    errors_us = np.abs(np.array([stamp.ns for stamp in stamps]) - true_ns)[400:] / US
    assert errors_us.max() < 100 + 4 * abs(drift_ppm)  # what drifts away in the 4 s of the map
    assert (errors_us <= np.array([stamp.uncertainty_ns for stamp in stamps])[400:] / US).all()
    assert source.jumps == 0


@pytest.mark.parametrize("jump_ns", [5 * SECOND, 80 * MS, -5 * SECOND, -30 * MS])
def test_clock_that_is_set_is_noticed_once_and_stamps_go_on(jump_ns):
    camera_ns = camera_times(600)
    true_ns = host_times(camera_ns)
    camera_ns[300:] += jump_ns
    source = CameraTime(None, "exposure_start")
    stamps = np.array([stamp.ns for stamp in stamps_of(source, camera_ns, true_ns + DELAY_NS + delays(600) // 10)])
    assert source.jumps == 1
    assert (np.diff(stamps) > 0).all()
    assert np.abs(stamps - true_ns - DELAY_NS)[310:].max() < 2 * MS


@pytest.mark.parametrize(
    "late, until, reading, most_us", [((300, 600), 600, False, 10), ((0, 5), 35, True, 1)], ids=["for 3 s", "at first"]
)
def test_frames_that_were_held_up_are_no_jump_and_do_not_spoil_the_stamps(late, until, reading, most_us):
    """The computer was busy: the frames of that time come all at once."""
    camera_ns = camera_times(1000)
    true_ns = host_times(camera_ns)
    arrival_ns = true_ns + DELAY_NS
    arrival_ns[slice(*late)] = arrival_ns[until]
    at_start = ClockReading(int(camera_ns[0]) - 50 * MS, HOST_EPOCH_NS - 50 * MS, 60 * US) if reading else None
    source = CameraTime(at_start, "exposure_start")
    stamps = np.array([stamp.ns for stamp in stamps_of(source, camera_ns, arrival_ns)])
    assert source.jumps == 0
    assert np.abs(stamps - true_ns - (0 if reading else DELAY_NS)).max() < most_us * US


# --- reading a camera's clock ------------------------------------------------------------------------------------


class Registers:
    """A device whose clock runs at ``ticks`` a second and is ahead of the host by ``ahead_ns``; writes take time."""

    def __init__(self, ticks, ahead_ns=0, way_there_ns=(300_000, 100_000, 900_000), way_back_ns=50_000):
        self.ticks, self.ahead_ns, self.ways, self.way_back_ns = ticks, ahead_ns, list(way_there_ns), way_back_ns
        self.now_ns, self.latched, self.count = HOST_EPOCH_NS, 0, 0

    def clock(self):
        return self.now_ns

    def write_register(self, address, value):
        assert (address, value) == (0x944, 2)
        self.now_ns += self.ways[self.count % len(self.ways)]
        self.count += 1
        self.latched = (self.now_ns + self.ahead_ns) * self.ticks // SECOND
        self.now_ns += self.way_back_ns

    def read_register(self, address):
        words = {0x93C: self.ticks >> 32, 0x940: self.ticks, 0x948: self.latched >> 32, 0x94C: self.latched}
        return words[address] & 0xFFFFFFFF


@pytest.mark.parametrize("ticks", [SECOND, 125_000_000, 8_000_000_000])
def test_reading_of_a_clock_contains_the_truth_within_its_uncertainty(ticks):
    registers = Registers(ticks, ahead_ns=123 * SECOND)
    reading = read_clock(registers, registers.clock)
    assert abs(reading.offset_ns + 123 * SECOND) <= reading.uncertainty_ns
    assert reading.uncertainty_ns <= 75 * US + SECOND // ticks  # the shortest exchange took 150 us


def test_device_without_a_clock_gives_no_reading():
    assert read_clock(Registers(0), lambda: 0) is None

    class Refusing(Registers):
        def write_register(self, address, value):
            raise DeviceRefusal("write protect")

    assert read_clock(Refusing(SECOND), lambda: 0) is None


# --- stamps ------------------------------------------------------------------------------------------------------


def run(source, exposure_ns, ahead_ns=0, count=400, marks=0.0):
    """Stamps of frames whose camera stamps the start of exposure, + ``marks`` of it; and the true mid-exposures."""
    taken_ns = HOST_EPOCH_NS + np.arange(count) * PERIOD_NS
    camera_ns = taken_ns + ahead_ns + round(marks * exposure_ns)
    arrival_ns = taken_ns + exposure_ns + DELAY_NS + delays(count) // 20
    return stamps_of(source, camera_ns, arrival_ns, exposure_ns), taken_ns + exposure_ns // 2


@pytest.mark.parametrize("marks, name", [(0.0, "exposure_start"), (0.5, "exposure_middle"), (1.0, "exposure_end")])
def test_camera_time_is_mid_exposure_whatever_instant_the_camera_stamps(marks, name):
    reading = ClockReading(HOST_EPOCH_NS - 5 * SECOND, HOST_EPOCH_NS, 60 * US)
    stamps, true_ns = run(CameraTime(reading, name), 4 * MS, ahead_ns=-5 * SECOND, marks=marks)
    errors = np.array([stamp.ns for stamp in stamps]) - true_ns
    assert np.abs(errors).max() <= 2 * US


def test_camera_time_without_a_reading_is_late_by_the_least_delay_and_says_so():
    stamps, true_ns = run(CameraTime(None, "exposure_start"), 4 * MS, ahead_ns=-5 * SECOND)
    errors = (np.array([stamp.ns for stamp in stamps]) - true_ns)[100:]
    assert errors.min() >= DELAY_NS and errors.max() < DELAY_NS + 100 * US
    assert all(stamp.uncertainty_ns > error for stamp, error in zip(stamps[100:], errors, strict=True))


def test_ptp_time_is_believed_while_frames_are_held_up():
    source, exposure_ns = CameraTime(reading_ahead(37), "exposure_start", 37 * SECOND, 60 * US), 4 * MS
    taken_ns = HOST_EPOCH_NS + np.arange(1000) * PERIOD_NS
    arrival_ns = taken_ns + exposure_ns + DELAY_NS
    arrival_ns[300:600] = arrival_ns[600]  # the computer was busy for 3 s
    stamps = stamps_of(source, taken_ns + 37 * SECOND, arrival_ns, exposure_ns)
    assert {stamp.clock for stamp in stamps} == {"PTP"} and source.jumps == 0
    assert [stamp.ns for stamp in stamps] == (taken_ns + exposure_ns // 2).tolist()


# --- which source ------------------------------------------------------------------------------------------------


def reading_ahead(seconds):
    return ClockReading(HOST_EPOCH_NS + round(seconds * SECOND), HOST_EPOCH_NS, 60 * US)


def choose(wanted, reading, status, offset_s=37):
    settings = AravisSettings(stamp_source=wanted, tai_utc_offset_s=offset_s)
    return choose_time_source(settings, reading, status, "camera X")


@pytest.mark.parametrize(
    "wanted, ahead_s, status, chosen",
    [
        ("auto", 37.0, "Slave", "PTP"),
        ("auto", 37.04, "Master", "PTP"),
        ("auto", 37.0, "Listening", "camera"),
        ("auto", 5.0, None, "camera"),
        ("camera", 37.0, "Slave", "camera"),
        ("ptp", 37.0, "Slave", "PTP"),
    ],
)
def test_best_trustworthy_source_is_chosen(wanted, ahead_s, status, chosen):
    source, warning = choose(wanted, reading_ahead(ahead_s), status)
    assert source.name.startswith(chosen) and warning == ""


@pytest.mark.parametrize(
    "reading, status, reason",
    [
        (reading_ahead(0.0), "Slave", r"0\.000 s ahead.*not 37"),
        (reading_ahead(38.0), "Slave", r"38\.000 s ahead"),
        (None, "Slave", "cannot be read"),
    ],
)
def test_ptp_that_does_not_fit_the_host_is_left_or_refused(reading, status, reason):
    source, warning = choose("auto", reading, status)
    assert source.name.startswith("camera") and "PTP is not used" in warning
    with pytest.raises(InputError, match=f"{reason}.*stamp_source"):
        choose("ptp", reading, status)


def test_stamps_follow_a_host_clock_that_was_set_back_and_no_smaller_step():
    def followed(given):
        stamps = [0]
        for stamp_ns in given:
            stamps.append(after_last(stamp_ns, stamps[-1]))
        return stamps[1:]

    arrivals = [HOST_EPOCH_NS, HOST_EPOCH_NS + 10 * MS, HOST_EPOCH_NS + 5 * MS]  # the last one: hardly delayed
    back = [HOST_EPOCH_NS - 3600 * SECOND + k * PERIOD_NS for k in range(3)]
    assert followed([*arrivals, *back]) == [HOST_EPOCH_NS, HOST_EPOCH_NS + 10 * MS, HOST_EPOCH_NS + 10 * MS + 1, *back]
