"""What the sensor makes of the scene, down to the bytes it sends.

Binning, region, exposure, gain, the faults of light and lens, noise, and the pixel format.
"""

from __future__ import annotations

from collections.abc import Callable

import cv2
import numpy as np
from numpy.typing import NDArray

from gige_vision.gvcp import Status
from gige_vision.gvsp import PixelFormat

from ..rendering.camera import Image
from .device import Device
from .registers import RegisterError, Value

Bytes = NDArray[np.uint8]
_AXES = (
    ("SensorWidth", "BinningHorizontal", "WidthMax", "Width", "OffsetX"),
    ("SensorHeight", "BinningVertical", "HeightMax", "Height", "OffsetY"),
)
_STEP = 4
_NOISE_PIXELS = 1 << 21


class ImagingPipeline:
    """Turns the scene's picture into the camera's, (H, W) or (H, W, 3) uint8.

    Keeps limits and payload size true whenever region, binning or format change. While ExposureAuto or GainAuto run,
    the feature that they control cannot be written; its value stays.
    """

    def __init__(self, device: Device) -> None:
        self._registers, self._settings, self._faults = device.registers, device.settings, device.faults
        self._rng = np.random.default_rng(device.settings.seed)
        self._noise: NDArray[np.int8] | None = None
        self._last: Image | None = None
        checks, writes = device.registers.checks, device.registers.writes
        checks["ExposureTime"] = lambda value: self._refuse_while_auto("ExposureAuto")
        checks["Gain"] = lambda value: self._refuse_while_auto("GainAuto")
        for _, binning, largest, size, offset in _AXES:
            checks[size], checks[offset] = self._fits(offset, largest), self._fits(size, largest)
            writes[binning] = writes[size] = self.refresh
        writes["PixelFormat"] = self.refresh
        self.refresh()

    @property
    def exposure_ns(self) -> int:
        return round(self._registers.real("ExposureTime") * 1000)

    @property
    def pixel_format(self) -> PixelFormat:
        return PixelFormat(self._registers.integer("PixelFormat"))

    def refresh(self) -> None:
        """Updates the dependent registers; a region that binning made too large is cropped."""
        r = self._registers
        for sensor, binning, largest, size, offset in _AXES:
            most = r.integer(sensor) // r.integer(binning)
            r[largest] = most
            r[size] = min(r.integer(size), most - most % _STEP)
            r[offset] = min(r.integer(offset), most - r.integer(size))
        r["PayloadSize"] = self.pixel_format.image_bytes(r.integer("Width"), r.integer("Height"))

    def capture(self, scene: Image) -> Image:
        if not self._faults.frozen or self._last is None:
            x, y, w, h = (self._registers.integer(key) for key in ("OffsetX", "OffsetY", "Width", "Height"))
            self._last = self._with_noise(self._exposed(self._binned(scene)[y : y + h, x : x + w]))
        return self._last

    def _binned(self, scene: Image) -> Image:
        across, down = self._registers.integer("BinningHorizontal"), self._registers.integer("BinningVertical")
        if across == down == 1:
            return scene
        height, width = scene.shape[0] // down, scene.shape[1] // across
        whole = scene[: height * down, : width * across]
        return np.asarray(cv2.resize(whole, (width, height), interpolation=cv2.INTER_AREA), np.uint8)

    def _exposed(self, scene: Image) -> Image:
        """Return it as bright as exposure, gain (dB) and light make it, relative to the nominal exposure and 0 dB."""
        exposure = self._registers.real("ExposureTime") / self._settings.nominal_exposure_us
        factor = exposure * 10.0 ** (self._registers.real("Gain") / 20.0) * self._faults.light
        if factor == 1.0:
            return scene
        table = np.clip(np.rint(np.arange(256) * factor), 0, 255).astype(np.uint8)
        return np.asarray(cv2.LUT(np.ascontiguousarray(scene), table), np.uint8)

    def _with_noise(self, picture: Image) -> Image:
        if not self._settings.noise:
            return picture
        if self._noise is None:
            noise = self._settings.noise * self._rng.standard_normal(_NOISE_PIXELS, np.float32)
            self._noise = np.clip(np.rint(noise), -128, 127).astype(np.int8)
        while len(self._noise) <= picture.size:  # a sensor of many megapixels sees the pattern repeat
            self._noise = np.tile(self._noise, 2)
        start = int(self._rng.integers(len(self._noise) - picture.size))
        noise_of_frame = self._noise[start : start + picture.size].reshape(picture.shape)
        return np.asarray(cv2.add(picture, noise_of_frame, dtype=cv2.CV_8U), np.uint8)

    def _fits(self, other: str, largest: str) -> Callable[[Value], None]:
        """Return the check that a size or offset ends within the sensor, together with the ``other``."""
        r = self._registers

        def check(value: Value) -> None:
            if int(value) + r.integer(other) > r.integer(largest):
                raise RegisterError(Status.INVALID_PARAMETER)

        return check

    def _refuse_while_auto(self, name: str) -> None:
        if self._registers.label(name) != "Off":
            raise RegisterError(Status.ACCESS_DENIED)


def pixel_bytes(image: Image, pixel_format: PixelFormat) -> Bytes:
    """Encodes a picture, (H, W) grey or (H, W, 3) BGR, as Mono8 (the grey of BT.601) or BayerRG8: bytes (n,)."""
    if pixel_format is PixelFormat.BayerRG8:
        mosaic = image[..., 1].copy()
        mosaic[::2, ::2], mosaic[1::2, 1::2] = image[::2, ::2, 2], image[1::2, 1::2, 0]
        return mosaic.reshape(-1)
    grey = image if image.ndim == 2 else np.asarray(cv2.cvtColor(image, cv2.COLOR_BGR2GRAY), np.uint8)
    return np.ascontiguousarray(grey).reshape(-1)
