"""From light to grey levels: exposure, flicker of the lamps, noise of the sensor."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import cv2
import numpy as np
from numpy.typing import NDArray

WHITE = 240.0
"""Grey level of a perfectly white surface in full light."""
_BANK_SIZE = 1 << 22


@dataclass(frozen=True)
class Sensor:
    """Imperfections of the sensor and the lamps.

    noise: standard deviation of each pixel's noise, grey levels; flicker: relative standard deviation of the whole
    frame's brightness. Both follow from (seed, camera, frame), so any frame can be made again on its own.
    """

    noise: float = 3.0
    flicker: float = 0.005
    seed: int = 0

    def expose(self, light: NDArray[np.float32], camera: int, frame: int) -> NDArray[np.uint8]:
        """The picture (h, w) uint8 of light (h, w), 0..1, taken by one camera at one frame."""
        rng = np.random.Generator(np.random.SFC64([self.seed, camera, frame]))
        gain = WHITE * (1.0 + self.flicker * rng.standard_normal())
        start = int(rng.integers(_BANK_SIZE - light.size))
        noise = self._noise_bank[start : start + light.size].reshape(light.shape)
        picture = np.maximum(cv2.addWeighted(light, gain, noise, self.noise, 0.0), 0.0)
        return np.asarray(cv2.convertScaleAbs(picture), np.uint8)

    @cached_property
    def _noise_bank(self) -> NDArray[np.float32]:
        """Standard normal numbers; each frame takes a stretch at a place of its own, which costs nothing."""
        return np.random.Generator(np.random.SFC64(self.seed)).standard_normal(_BANK_SIZE, dtype=np.float32)
