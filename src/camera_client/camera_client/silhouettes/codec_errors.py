"""Estimates a codec's errors beside what it had to draw anew.

A codec draws an empty room once, and well; but where somebody comes, the blocks around them are drawn anew, coarsely:
the background beside a person differs from what it was by a share of the contrast within the block. That a codec is
there shows in its noise, which is as coarse as its blocks (``Noise.spatial_correlation``).
"""

from __future__ import annotations

import cv2
import numpy as np
import numpy.typing as npt

from ..background.noise import Noise
from ..frame_source import Image
from .masks import largest_difference

# Thresholds: REACH_PX from the blocks of codecs; else measured by python bench/rooms.py, test_camera_codecs.py.
REACH_PX = 8  # a block of brightness: JPEG, MPEG-4, H.264; colour's are twice as wide, but hardly seen beyond
OF_CONTRAST = 0.12  # of the contrast, standard deviation 2 to 8 px beside people through bench/rooms.py's codecs
FINE_GRAIN = 0.2  # light and displacements that are known inexactly have as much
COLOUR_SHARE = 0.5  # of the errors' standard deviation is left when their brightness is taken away (same bench)


def codec_error_sigma(image: Image, expected: npt.NDArray[np.float32], noise: Noise) -> npt.NDArray[np.float32] | None:
    """Return the standard deviation (h, w) float32 of a codec's errors beside what changed; None without a codec.

    image, expected (h, w[, 3]) : the same part of the frame, and of the background, grey levels.
    """
    if noise.spatial_correlation <= FINE_GRAIN:
        return None
    change = largest_difference(image, expected)
    around = cv2.dilate(change, np.ones((2 * REACH_PX + 1, 2 * REACH_PX + 1), np.uint8))
    share = OF_CONTRAST * (noise.spatial_correlation - FINE_GRAIN) / (1 - FINE_GRAIN)
    return np.asarray(around * np.float32(share), np.float32)
