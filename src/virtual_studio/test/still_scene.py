"""A scene that never changes, so that a frame's pixels are known."""

from __future__ import annotations

import numpy as np


class Still:
    """A scene that never changes."""

    def __init__(self, picture):
        self.picture = picture

    @property
    def shape(self):
        return self.picture.shape

    def image(self, instant_ns):
        return self.picture


def noise(*shape):
    return np.random.default_rng(3).integers(0, 256, shape).astype(np.uint8)
