"""The background as it was learned, whatever happens to the light: the thesis's rules (6.2, 6.3)."""

from __future__ import annotations

import cv2
import numpy as np
import numpy.typing as npt

from ..frame_source import Image, Mask
from ..settings import BackgroundSettings
from .adaptation.adaptive import BackgroundState
from .adaptation.light import Light
from .adaptation.shift import Displacement
from .model import BackgroundModel
from .noise import Noise, assumed_noise

FOREGROUND_DISTANCE = 255


class FixedBackground:
    """Answers as :class:`.adaptive.AdaptiveBackground` does, and follows nothing: pixels are background or not."""

    threshold = FOREGROUND_DISTANCE - 1

    def __init__(self, model: BackgroundModel, settings: BackgroundSettings) -> None:
        self._limits, self._mean = model.limits(settings), model.mean
        typical = float(np.median(np.maximum(model.sigma, np.float32(settings.sigma_floor))))
        channels = 1 if model.mean.ndim == 2 else 3
        noise = assumed_noise(typical, channels)
        self.state = BackgroundState(Light.unchanged(channels), noise, noise, Displacement(), 0.0, 0.0)

    @property
    def light(self) -> Light:
        return self.state.light

    @property
    def noise(self) -> Noise:
        return self.state.noise

    def follow(self, image: Image, stamp_ns: int) -> None:
        """Follow nothing."""

    def note_foreground(self, dense: Mask) -> None:
        """Take no notice."""

    def distance(self, image: Image, out: Mask) -> Mask:
        """Write 0 into ``out`` (H, W) where the image keeps the limits of 6.3, else 255."""
        cv2.inRange(image, self._limits.lo, self._limits.hi, dst=out)
        return np.asarray(cv2.bitwise_not(out, dst=out))

    def expected(self, at: tuple[slice, slice]) -> npt.NDArray[np.float32]:
        """Return a part of the background: (h, w) or (h, w, 3), grey levels."""
        return self._mean[at]
