"""Webcams, played by an object with the interface of OpenCV's capture, and sources of the user's own."""

import threading
import time
from pathlib import Path
from types import SimpleNamespace

import cv2
import numpy as np
import pytest
from camera_pictures import frames_of

from camera_client.configuration import live_source
from camera_client.frame_source import SourceUnavailable
from camera_client.settings import CameraClientSettings, PluginSettings, WebcamSettings
from camera_client.sources import webcam_source
from camera_client.sources.webcam_source import WebcamSource
from capture_rig.errors import InputError

EXAMPLES = Path(__file__).resolve().parents[3] / "examples"
PERIOD_MS = 10.0


class Capture:
    """A webcam of 64 x 48 whose pictures come as fast as they are read, PERIOD_MS apart by its own stamps."""

    def __init__(self, pictures=10**6, opened=True, size=(64, 48), skips=()):
        self.pictures, self.opened, self.size, self.skips = pictures, opened, size, skips
        self.asked, self.taken, self.released = {}, 0, False
        self.begin_ms = time.monotonic() * 1e3

    def isOpened(self):
        return self.opened

    def set(self, name, value):
        self.asked[name] = value
        return name != cv2.CAP_PROP_FPS

    def read(self):
        if self.taken >= self.pictures:
            return False, None
        self.taken += 1
        while self.stamp_ms > time.monotonic() * 1e3:
            time.sleep(1e-3)  # the exposure
        return True, np.full((self.size[1], self.size[0], 3), self.taken % 250, np.uint8)

    @property
    def stamp_ms(self):
        return self.begin_ms + PERIOD_MS * (self.taken + sum(skip < self.taken for skip in self.skips))

    def get(self, name):
        return self.stamp_ms if name == cv2.CAP_PROP_POS_MSEC else 0.0

    def release(self):
        self.released = True


def webcam(capture, channels="auto", **settings):
    return WebcamSource(WebcamSettings(**settings), channels, lambda device: capture)


def test_pictures_are_stamped_by_the_driver_moved_to_mid_exposure(monkeypatch):
    monkeypatch.setattr(webcam_source, "stamp_of", lambda position_ms: (round(position_ms * 1e6), "driver"))
    capture = Capture()
    with webcam(capture, "mono", stamp_offset_ms=-15.0, stamp_uncertainty_ms=8.0) as source:
        assert source.shape == (48, 64)
        source.start()
        frames = frames_of(source, 5)
    for frame in frames:
        periods = ((frame.stamp_ns + 15_000_000) * 1e-6 - capture.begin_ms) / PERIOD_MS
        assert abs(periods - round(periods)) < 1e-3
        assert (frame.clock, frame.uncertainty_ns, frame.image.shape) == ("driver", 8_000_000, (48, 64))
    assert capture.released


@pytest.mark.parametrize("position_ms, stamp_ns, clock", [(4990, 10**18 - 10**7, "driver"), (0, 10**18, "arrival")])
def test_stamps_of_the_monotonic_clock_become_system_time_and_others_the_arrival(
    monkeypatch, position_ms, stamp_ns, clock
):
    monkeypatch.setattr(webcam_source, "time", SimpleNamespace(monotonic=lambda: 5.0, time_ns=lambda: 10**18))
    stamp = webcam_source.stamp_of(position_ms)
    assert abs(stamp[0] - stamp_ns) < 1000 and stamp[1] == clock


def test_refused_settings_are_a_warning_and_a_size_that_it_does_not_have_an_error_with_the_remedy():
    capture = Capture()
    with webcam(capture, width=64, height=48, frame_rate=30, exposure_100us=50) as source:
        assert capture.asked[cv2.CAP_PROP_EXPOSURE] == 50 and capture.asked[cv2.CAP_PROP_AUTO_EXPOSURE] == 1
        assert "refused 1 of its settings" in source.warnings[0]
    capture = Capture()
    with pytest.raises(InputError, match=r"64 x 48 pixels instead of 1280 x 720.*list-formats-ext"):
        webcam(capture, width=1280, height=720).connect()
    assert capture.released


@pytest.mark.parametrize(
    "capture, said", [(Capture(opened=False), "another program"), (Capture(pictures=0), "no picture")]
)
def test_webcam_that_cannot_be_used_is_tried_again(capture, said):
    with pytest.raises(SourceUnavailable, match=said):
        webcam(capture).connect()


def test_skipped_pictures_count_as_lost_and_an_unplugged_webcam_is_lost(monkeypatch):
    # a machine that stops for a second would make the pictures too old for their stamps to count
    monkeypatch.setattr(webcam_source, "stamp_of", lambda position_ms: (round(position_ms * 1e6), "driver"))
    with webcam(Capture(pictures=31, skips=(20,))) as source:
        source.start()
        while not source.lost:
            source.read(0.1)
        while source.read(0.0) is not None:
            pass
        counts = source.statistics.counts()
    assert counts["lost"] >= 1 and counts["delivered"] + counts["lost"] == counts["expected"]


def test_a_webcam_that_hangs_is_not_released_under_its_reader_and_not_started_again(monkeypatch):
    monkeypatch.setattr(webcam_source, "RELEASE_S", 0.01)
    capture, hung, go_on = Capture(), threading.Event(), threading.Event()
    source = webcam(capture)
    source.connect()
    read = capture.read
    monkeypatch.setattr(capture, "read", lambda: (hung.set(), go_on.wait(), read())[-1])
    source.start()
    assert hung.wait(20)
    source.stop()
    with pytest.raises(SourceUnavailable, match="has not answered"):
        source.start()
    reader = source._thread
    source.close()
    assert not capture.released
    go_on.set()
    reader.join(20)
    assert capture.released


def test_source_of_the_users_own(monkeypatch):
    monkeypatch.syspath_prepend(EXAMPLES)
    plugin = PluginSettings("pattern_camera:PatternCamera", ["width=80", "height=60", "frame_rate=200"])
    seen = []
    source = live_source(CameraClientSettings(source="plugin", plugin=plugin), seen.append)
    source.connect()
    source.start()
    frames = frames_of(source, 3)
    source.close()
    assert [frame.image.shape for frame in frames] == [(60, 80)] * 3 and len(seen) == 1
    assert [frame.frame_id for frame in frames] == [1, 2, 3] and source.statistics.delivered == 3


@pytest.mark.parametrize("name", ["", "nowhere:Camera", "pathlib:Path", "pathlib:Camera"])
def test_what_is_no_source_is_refused(name):
    with pytest.raises(InputError, match=r"plugin\.source"):
        live_source(CameraClientSettings(source="plugin", plugin=PluginSettings(name)), lambda source: None)
