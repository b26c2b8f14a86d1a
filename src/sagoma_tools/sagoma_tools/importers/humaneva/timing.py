"""The common clock of a sequence: which image of each camera, and which instant of the motion capture, belong together.

Frames are counted from 1 as the data set's authors do, so that their frame numbers (S2 Walking 1: 6 to 438 validation,
439 to 876 training) can be used here. All cameras of the sequence take part, also those that are not imported.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from .ofs import Offset

FIRST_USABLE_FRAME = 6
"""The codec repeats the first image of every movie: its first five frames show nothing new."""


@dataclass(frozen=True)
class CommonTime:
    """Common frame k is image ``first_image[camera]`` + k - 1 and mocap frame ``first_mocap`` + (k - 1) times the rate.

    All counted from 1; images are whole, mocap frames fractional; ``mocap_per_frame`` is near 2.
    """

    first_image: Mapping[str, int]
    first_mocap: float
    mocap_per_frame: float

    def image(self, camera: str, frame: int) -> int:
        """The camera's image (1-based) of a common frame."""
        return self.first_image[camera] + frame - 1

    def mocap(self, frames: np.ndarray) -> np.ndarray:
        """Fractional mocap frames (F,), 1-based, of common frames (F,)."""
        return self.first_mocap + (np.asarray(frames, float) - 1) * self.mocap_per_frame


def common_time(offsets: Mapping[str, Offset]) -> CommonTime:
    """The clock that the authors' code derives from all cameras' offsets, in the order colour before grey cameras."""
    cameras = list(offsets.values())
    # every camera's image at one instant: mocap frame b of the first camera
    instant = cameras[0].mocap
    images = np.array([c.image + (instant - c.mocap) / c.mocap_per_image for c in cameras])
    mocap_per_frame = float(np.mean([c.mocap_per_image for c in cameras]))
    # common frame 1 is the first image of the camera that starts latest, ...
    first_mocap = instant - mocap_per_frame * (images.min() - 1)
    first_images = images - images.min() + 1
    # ... or the first mocap frame where the motion capture starts later still
    if first_mocap < 1:
        first_images = first_images + (1 - first_mocap) / mocap_per_frame
        first_mocap = 1.0
    rounded = np.floor(first_images + 0.5).astype(int).tolist()  # shutters are not in step: off by half a frame at most
    return CommonTime(dict(zip(offsets, rounded, strict=True)), float(first_mocap), mocap_per_frame)
