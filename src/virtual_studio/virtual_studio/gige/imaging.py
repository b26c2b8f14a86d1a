"""What the sensor makes of the scene: exposure, gain, binning, region, noise, and the faults of light and lens."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from .exposure import ExposureControl
from .faults import Faults
from .pixels import Image
from .registers import Registers
from .settings import CameraSettings

_NOISE_PIXELS = 1 << 21


class Sensor:
    """Turns what the scene shows into the picture that leaves the camera, (H, W) or (H, W, 3) uint8."""

    def __init__(
        self, registers: Registers, exposure: ExposureControl, settings: CameraSettings, faults: Faults
    ) -> None:
        self._registers, self._exposure, self._settings, self._faults = registers, exposure, settings, faults
        self._rng = np.random.default_rng(settings.seed)
        self._noise_bank: NDArray[np.int8] | None = None
        self._last: Image | None = None

    def see(self, scene: Image) -> Image:
        """The picture of what the scene shows."""
        if self._faults.frozen and self._last is not None:
            return self._last
        picture = self._noisy(self._lit(self._cut(self._binned(scene))))
        self._last = picture
        return picture

    def _binned(self, scene: Image) -> Image:
        across, down = self._registers.integer("BinningHorizontal"), self._registers.integer("BinningVertical")
        if across == down == 1:
            return scene
        height, width = scene.shape[0] // down, scene.shape[1] // across
        whole = scene[: height * down, : width * across]
        return np.asarray(cv2.resize(whole, (width, height), interpolation=cv2.INTER_AREA), np.uint8)

    def _cut(self, scene: Image) -> Image:
        x, y, w, h = (self._registers.integer(key) for key in ("OffsetX", "OffsetY", "Width", "Height"))
        return scene if (h, w) == scene.shape[:2] else scene[y : y + h, x : x + w]

    def _lit(self, scene: Image) -> Image:
        if self._faults.lens_cap:
            return np.zeros_like(scene)
        factor = self._exposure.factor(scene) * self._faults.brightness
        if factor == 1.0:
            return scene
        table = np.clip(np.rint(np.arange(256) * factor), 0, 255).astype(np.uint8)
        return np.asarray(cv2.LUT(np.ascontiguousarray(scene), table), np.uint8)

    def _noisy(self, picture: Image) -> Image:
        if not self._settings.noise:
            return picture
        if self._noise_bank is None:
            noise = self._settings.noise * self._rng.standard_normal(_NOISE_PIXELS, np.float32)
            self._noise_bank = np.clip(np.rint(noise), -128, 127).astype(np.int8)
        bank = self._noise_bank
        while len(bank) <= picture.size:  # a sensor of many megapixels sees the pattern repeat
            bank = self._noise_bank = np.tile(bank, 2)
        start = int(self._rng.integers(len(bank) - picture.size))
        noise_of_frame = bank[start : start + picture.size].reshape(picture.shape)
        return np.asarray(cv2.add(picture, noise_of_frame, dtype=cv2.CV_8U), np.uint8)
