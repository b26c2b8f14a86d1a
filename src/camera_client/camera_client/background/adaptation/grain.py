"""How coarse a camera's noise is: a sensor's is as fine as its pixels, a codec's as coarse as its blocks.

Measured in places that show the background, by how they differ from it. Light and displacements that are known
inexactly leave something coarse, too, but it stays: what changes from frame to frame is as fine as the sensor then.
"""

from __future__ import annotations

import math
from collections import deque

import numpy as np
import numpy.typing as npt

from ..noise import FOLLOW_S, LEAST_VARIANCE

# Thresholds: NEAR_PX, FAR_PX from demosaicing and the blocks of codecs; else measured by python bench/rooms.py.
NEAR_PX, FAR_PX = 2, 16  # demosaicing reaches less far than the one; no block of a codec as far as the other
LEAST_CHANGE = 0.02  # grey levels squared: less is the same picture again
TAIL_OF_MEDIAN = 9.0  # squared differences beyond so many medians are cut off
FEW = 100  # samples
PASSING = 2.0  # times as coarse as what changes at most: codecs that predict frames spread noise less than they keep it
OPPONENT = np.array([[1 / 3, 1, 0], [1 / 3, -1, -1], [1 / 3, 0, 1]], np.float32)  # BGR: brightness, B - G, R - G

Floats = npt.NDArray[np.floating]


class GrainMeter:
    """Measures the grain at sampled pixels. ``grain`` : 0 until it is known."""

    def __init__(self, row: npt.NDArray[np.intp], column: npt.NDArray[np.intp], width: int) -> None:
        """Sample at ``row``, ``column`` (n,) of a picture of this width."""
        self.row = np.stack([row] * 3)
        self.column = np.minimum(column, width - 1 - FAR_PX) + np.array([[0], [NEAR_PX], [FAR_PX]])
        self._before: Floats | None = None
        self._sure_before = np.zeros(len(row), bool)
        self._passing: deque[float] = deque(maxlen=2)
        self._known, self.grain = False, 0.0

    def update(self, seen: Floats, rest: Floats, sure: npt.NDArray[np.bool_], step_s: float) -> float:
        """Take a frame, ``step_s`` after the last one taken; return the grain.

        seen, rest (3, n, C) : grey levels at ``row``, ``column`` (3, n), and by how much they differ from the
        background. sure (n,) : which samples show the background.
        """
        before, both = self._before, sure & self._sure_before
        self._before, self._sure_before = seen, sure
        if before is None:
            return self.grain
        found, passing = measured_grain(*rest[:, sure]), measured_grain(*(seen - before)[:, both])
        self._passing.append(1.0 if passing is None else passing)  # only codecs show the same picture again
        if found is not None and len(self._passing) == self._passing.maxlen:
            share = 1 - math.exp(-step_s / FOLLOW_S) if self._known else 1.0
            self.grain += share * (min(found, PASSING * min(self._passing)) - self.grain)
            self._known = True
        return self.grain


def measured_grain(own: Floats, near: Floats, far: Floats) -> float | None:
    """Return which share of the noise neighbours have in common, on average over brightness and differences of colours.

    own, near, far (n, C) : differences of pixels from what they were, and of those NEAR_PX and FAR_PX to their right;
    what is common to all three, as light, counts little. None when too little differs to tell.
    """
    if len(own) < FEW:
        return None
    if own.shape[1] == 3:
        own, near, far = (each @ OPPONENT for each in (own, near, far))
    most = TAIL_OF_MEDIAN * np.maximum(np.median((own - far) ** 2, axis=0), LEAST_VARIANCE)
    near2, far2 = (np.minimum((own - each) ** 2, most).mean(axis=0) for each in (near, far))
    if (far2 < LEAST_CHANGE).any():
        return None
    return float(np.clip(1 - near2 / far2, 0.0, 1.0).mean())
