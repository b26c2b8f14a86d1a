"""The same image scaled in one or both directions, for detectors that look for patterns of a certain size."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]

OWN_BLUR_PX = 0.6  # of an ordinary image: optics and pixel
COMFORTABLE_PX = 900  # long side at which boards are found fast
MAX_PIXELS = 8e6
STRETCHES: tuple[tuple[Any, ...], ...] = (  # across, down, blur, equalised
    (1, 2),
    (1, 1, 1.0),
    (1, 3),
    (1, 4),
    (2, 2),
    (1, 1, 2.5),
    (2, 4),
    (2, 6),
    (1, 2, 2.2),
    (2, 1),
    (1, 1, 1.35, True),
    (0.5, 0.5),
    (1, 1, 4.0),
)


@dataclass(frozen=True)
class Variant:
    """The image ``across`` times as wide and ``down`` times as high, to be smoothed so that its blur, its own included,
    becomes about ``blur_px`` in all directions (a blur that differs with the direction turns the edges that are seen at
    a corner); ``equalised``: with its contrast levelled."""

    across: float = 1.0
    down: float = 1.0
    blur_px: float = 1.35
    equalised: bool = False

    @property
    def smoothing_px(self) -> tuple[float, float]:
        """Standard deviation of the Gaussian still needed, in both directions."""
        own = OWN_BLUR_PX * max(self.across, 0.5), OWN_BLUR_PX * max(self.down, 0.5)
        wanted = max(self.blur_px, 1.1 * max(own))
        return math.sqrt(wanted**2 - own[0] ** 2), math.sqrt(wanted**2 - own[1] ** 2)

    def make(self, image: npt.NDArray[np.uint8]) -> npt.NDArray[np.uint8]:
        """The scaled image."""
        if self.equalised:
            image = np.asarray(cv2.createCLAHE(clipLimit=4.0, tileGridSize=(8, 8)).apply(image), np.uint8)
        if self.across == self.down == 1.0:
            return image
        smaller = self.across < 1 and self.down < 1
        method = cv2.INTER_AREA if smaller else cv2.INTER_CUBIC
        return np.asarray(cv2.resize(image, self._size(image.shape), interpolation=method), np.uint8)

    def to_raw(self, pixels: Array) -> Array:
        """Pixels (..., 2) of the scaled image in the raw one."""
        return (pixels + 0.5) / [self.across, self.down] - 0.5

    def _size(self, shape: tuple[int, ...]) -> tuple[int, int]:
        return max(round(shape[1] * self.across), 1), max(round(shape[0] * self.down), 1)


def variants_for(shape: tuple[int, ...], thorough: bool) -> tuple[Variant, ...]:
    """What to look at, in order: large images made smaller first; ``thorough`` adds enlarged and stretched ones, in
    which small boards and boards at a grazing angle look like ordinary ones. All of them stay below ``MAX_PIXELS``."""
    long_side = max(shape[:2])
    scale = COMFORTABLE_PX / long_side if long_side > 1.2 * COMFORTABLE_PX else 1.0
    variants = [Variant(scale, scale), Variant()] if scale < 1 else [Variant()]
    if thorough:
        variants += [Variant(scale * across, scale * down, *rest) for across, down, *rest in STRETCHES]
        variants += [Variant(1, 2), Variant(1, 3), Variant(2, 2)] if scale < 1 else []
    return tuple(each for each in variants if each.across * each.down * shape[0] * shape[1] <= MAX_PIXELS)
