"""The thesis's background subtraction: the background stays as it was learned, pixels are background or not (6.3)."""

from __future__ import annotations

import math
from statistics import NormalDist

import cv2
import numpy as np

from ..frame_source import Image, Mask
from ..settings import BackgroundSettings
from .expected_image import Corners, Floats, Rows, Samples
from .kernels import HIGHEST
from .light import Light
from .model import BackgroundModel
from .noise import assumed_noise

SQRT_2_PI = math.sqrt(2 * math.pi)


class FixedBackground:
    """Answers as :class:`.adaptive.AdaptiveBackground` does, and follows nothing."""

    threshold, step_px = int(HIGHEST) - 1, 1

    def __init__(self, model: BackgroundModel, settings: BackgroundSettings) -> None:
        self._limits, self._mean = limits(model, settings), model.mean
        typical = float(np.median(np.maximum(model.sigma, np.float32(settings.sigma_floor))))
        self.light, self.noise = Light.unchanged(model.channels), assumed_noise(typical, model.channels)

    def update(self, image: Image, samples: Samples, stamp_ns: int) -> None:
        """Follow nothing."""

    def add_foreground(self, dense: Mask) -> None:
        """Take no notice."""

    def distance(self, image: Image, samples: Samples) -> Mask:
        """Return 0 (H, W) where the image keeps the limits of 6.3, else 255."""
        return self._beyond(image)

    def compare(self, image: Image, box: Corners, rows: Rows) -> tuple[Floats, Mask]:
        """Return a part of the background, (h, w) or (h, w, 3), grey levels; and (2, h, w) uint8: 0 where the image
        keeps the limits of 6.3, else 255, and by how many grey levels it differs."""
        top, left, bottom, right = box
        at = slice(top, bottom), slice(left, right)
        change = cv2.absdiff(image[at], cv2.convertScaleAbs(self._mean[at]))
        change = change if change.ndim == 2 else change.max(axis=2)
        return self._mean[at], np.stack([self._beyond(image, at), change])

    def _beyond(self, image: Image, at: tuple[slice, slice] = (slice(None), slice(None))) -> Mask:
        lo, hi = self._limits
        return cv2.bitwise_not(cv2.inRange(image[at], lo[at], hi[at]))


def limits(model: BackgroundModel, settings: BackgroundSettings) -> tuple[Image, Image]:
    """Return the lowest and highest grey level of the background, uint8, shaped as the image; 255, 0 for none.

    Thesis 6.3, corrected: a pixel is *foreground* when it is improbable under its background (as printed, the sentence
    calls almost every background pixel foreground). Both rules ask for |g - mu| <= half, and so collapse exactly to two
    images of whole grey levels. "tail": P(|g - mu| > half) = risk, the same number of sigmas everywhere. "pdf": the
    density at the limit equals ``risk`` per grey level (as in the HumanEva code), so that a noisier pixel gets fewer
    sigmas, and one with sigma > 1 / (risk sqrt(2 pi)) none at all.
    """
    mean, sigma = model.mean.astype(float), np.maximum(model.sigma.astype(float), settings.sigma_floor)
    if settings.rule == "pdf":
        log_ratio = np.log(settings.risk * sigma * SQRT_2_PI)
        half = np.where(log_ratio <= 0, sigma * np.sqrt(-2 * np.minimum(log_ratio, 0)), -1.0)
    else:
        half = sigma * -NormalDist().inv_cdf(settings.risk / 2)
    lo, hi = np.ceil(mean - half), np.floor(mean + half)
    never = (half < 0) | (lo > hi)
    lo, hi = np.where(never, 255, np.clip(lo, 0, 255)), np.where(never, 0, np.clip(hi, 0, 255))
    return lo.astype(np.uint8), hi.astype(np.uint8)
