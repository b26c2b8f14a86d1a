"""A source that opens a webcam of this machine: a Video4Linux2 device, through OpenCV."""

from __future__ import annotations

import threading
import time
from collections import deque
from collections.abc import Callable
from typing import Any

import cv2

from capture_rig.errors import InputError
from capture_rig.stamps import NS_PER_S

from ..frame_source import LASTING_S, RELEASE_S, Frame, FrameNumbers, FrameSource, SourceUnavailable
from ..settings import WebcamSettings
from .footage_reader import convert_channels

# Thresholds: judgement, no measurement.
DEPTH = 2  # pictures that may wait: older ones make room, and count as lost


def open_device(device: str) -> Any:
    """Return OpenCV's capture of a device: a number, or a path as /dev/video0 or /dev/v4l/by-id/..."""
    return cv2.VideoCapture(int(device) if device.isdecimal() else device, cv2.CAP_V4L2)


class WebcamSource(FrameSource):
    """Pictures of a webcam. Its driver stamps when a picture's first byte came, on this machine's monotonic clock.

    A webcam has no trigger, and exposes before it stamps: ``stamp_offset_ms`` and ``stamp_uncertainty_ms`` say how
    far mid-exposure is from the stamp. Pictures are taken on a thread of its own, because OpenCV may block for seconds.
    """

    def __init__(
        self, settings: WebcamSettings, channels: str = "auto", open_capture: Callable[[str], Any] = open_device
    ) -> None:
        super().__init__()
        self.description = f"webcam {settings.device}"
        self._settings, self._channels, self._open = settings, channels, open_capture
        self._capture: Any = None
        self._thread: threading.Thread | None = None
        self._stopping = threading.Event()
        self._taken: deque[tuple[Any, int, str]] = deque(maxlen=DEPTH)  # picture, stamp, clock
        self._changed = threading.Condition()
        self._numbers = FrameNumbers(self._statistics)
        self._lost = False

    def connect(self) -> None:
        settings = self._settings
        capture = self._open(settings.device)
        if not capture.isOpened():
            raise SourceUnavailable("is not there, or another program uses it", where=self.description)
        if settings.fourcc:
            capture.set(cv2.CAP_PROP_FOURCC, cv2.VideoWriter.fourcc(*settings.fourcc))
        wanted = {
            cv2.CAP_PROP_FRAME_WIDTH: settings.width,
            cv2.CAP_PROP_FRAME_HEIGHT: settings.height,
            cv2.CAP_PROP_FPS: settings.frame_rate,
            cv2.CAP_PROP_AUTO_EXPOSURE: 1 if settings.exposure_100us > 0 else 0,  # V4L2: 1 is by hand
            cv2.CAP_PROP_EXPOSURE: settings.exposure_100us,
        }
        refused = [name for name, value in wanted.items() if value > 0 and not capture.set(name, value)]
        came, image = capture.read()
        if not came:
            capture.release()
            raise SourceUnavailable("gives no picture", where=self.description)
        height, width = image.shape[:2]
        if any(want not in (0, got) for want, got in ((settings.width, width), (settings.height, height))):
            capture.release()
            raise InputError(
                f"gives {width} x {height} pixels instead of {settings.width} x {settings.height}",
                where=self.description,
                remedy="v4l2-ctl --list-formats-ext names its sizes; set webcam.width and height to one of them.",
            )
        if refused:
            self.warnings = (f"{self.description} refused {len(refused)} of its settings: look at its picture",)
        self._capture, self._lost = capture, False
        self.shape = convert_channels(image, self._channels).shape

    def start(self) -> None:
        if self._thread is not None and self._stopping.is_set():
            raise SourceUnavailable("has not answered since it was stopped", where=self.description)
        if self._thread is not None:
            return
        self._stopping.clear()
        self._taken.clear()
        self._numbers.restart()
        self._thread = threading.Thread(target=self._read_pictures, args=(self._capture,), name="webcam", daemon=True)
        self._thread.start()

    def _read_pictures(self, capture: Any) -> None:
        """Take pictures until stopped or unplugged, on a thread of its own; give a device back that was closed."""
        while not self._stopping.is_set():
            came, image = capture.read()
            stamp_ns, clock = stamp_of(capture.get(cv2.CAP_PROP_POS_MSEC))
            with self._changed:
                if came:
                    self._taken.append((image, stamp_ns, clock))
                else:
                    self._lost = True
                self._changed.notify()
            if not came:
                break
        if self._capture is not capture:
            capture.release()

    def read(self, timeout_s: float) -> Frame | None:
        with self._changed:
            if not self._changed.wait_for(lambda: self._taken or self._lost, timeout_s) or not self._taken:
                return None
            image, stamp_ns, clock = self._taken.popleft()
        settings = self._settings
        number = self._numbers.add(stamp_ns)
        if number is None:
            return None
        stamp_ns += round(settings.stamp_offset_ms * 1e6)
        uncertainty_ns = round(settings.stamp_uncertainty_ms * 1e6)
        return Frame(convert_channels(image, self._channels), stamp_ns, number, clock, uncertainty_ns)

    def stop(self) -> None:
        self._stopping.set()
        if self._thread is not None:
            self._thread.join(RELEASE_S)  # a dead device may hold it for seconds: it ends by itself
            self._thread = self._thread if self._thread.is_alive() else None

    def close(self) -> None:
        self.stop()
        capture, self._capture = self._capture, None
        if capture is not None and self._thread is None:  # never under a thread that still reads from it
            capture.release()

    @property
    def details(self) -> dict[str, str]:
        return self._numbers.details()

    @property
    def lost(self) -> bool:
        return self._lost


def stamp_of(position_ms: float) -> tuple[int, str]:
    """Return the system time, ns, of a picture that OpenCV stamped, and whose clock that is.

    V4L2 stamps by the monotonic clock; where a driver does not, the picture's arrival counts.
    """
    age_s = time.monotonic() - position_ms * 1e-3
    if 0 <= age_s < LASTING_S:  # else the stamp is of another clock
        return time.time_ns() - round(age_s * NS_PER_S), "driver"
    return time.time_ns(), "arrival"
