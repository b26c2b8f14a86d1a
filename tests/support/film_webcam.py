"""Webcams that are films: the empty room until somebody is let in, then the film of the person, once.

What a webcam user has, but for the camera: no trigger, a clock that the others do not share, pictures of one rate that
begin when they like.
"""

import os
import time
from pathlib import Path

import cv2

from camera_client.settings import WebcamSettings
from camera_client.sources.webcam_source import WebcamSource

ENTRANCE = "entrance"  # file: monotonic time, s, at which the film of the person begins


def let_in(folder: Path, in_s: float) -> float:
    """Have the person come in; return the system time, s, at which the film begins."""
    written = folder / f"{ENTRANCE}.new"
    written.write_text(repr(time.monotonic() + in_s))
    began_s = time.time() + in_s
    written.rename(folder / ENTRANCE)
    return began_s


class Film:
    """As cv2.VideoCapture of a device: FOLDER/NAME_background.mp4 over and over, then FOLDER/NAME.mp4."""

    def __init__(self, folder: Path, name: str, rate_hz: float, phase_s: float) -> None:
        self._folder, self._name, self._period_s, self._phase_s = folder, name, 1.0 / rate_hz, phase_s
        self._film = cv2.VideoCapture(os.fspath(folder / f"{name}_background.mp4"))
        self._due_s, self._entered, self._last = time.monotonic(), False, None

    def isOpened(self) -> bool:
        return self._film.isOpened()

    def set(self, feature: int, value: float) -> bool:
        return True

    def get(self, feature: int) -> float:
        return 1e3 * self._taken_s if feature == cv2.CAP_PROP_POS_MSEC else 0.0

    def release(self) -> None:
        self._film.release()

    def read(self):
        if not self._entered and (self._folder / ENTRANCE).exists():
            entrance_s = float((self._folder / ENTRANCE).read_text())
            if self._due_s >= entrance_s:
                self._film, self._entered = cv2.VideoCapture(os.fspath(self._folder / f"{self._name}.mp4")), True
                self._due_s = entrance_s + self._phase_s
        time.sleep(max(self._due_s - time.monotonic(), 0.0))
        self._taken_s, self._due_s = self._due_s, self._due_s + self._period_s
        came, image = self._film.read()
        if not came and not self._entered:
            self._film.set(cv2.CAP_PROP_POS_FRAMES, 0)
            came, image = self._film.read()
        self._last = image if came else self._last
        return True, self._last


class FilmWebcam(WebcamSource):
    """The product's webcam source before a film instead of a device."""

    def __init__(self, folder: str, name: str, rate_hz: str, phase_ms: str) -> None:
        def opened(device: str) -> Film:
            return Film(Path(folder), device, float(rate_hz), 1e-3 * float(phase_ms))

        super().__init__(WebcamSettings(device=name, stamp_offset_ms=0.0), open_capture=opened)
