"""Checks whether a frame is a picture of the scene at all, on a sparse grid of its pixels.

    checks = FrameChecks(background.mean)    # without a background yet: FrameChecks()
    flags = checks.check(frame.image, frame.stamp_ns)    # () for a sound frame
    for flag in flags: WARN with REMEDIES[flag]

A flag says what the frame looks like now; it is gone as soon as frames are sound again.
"""

from __future__ import annotations

import math
import zlib

import numpy as np
import numpy.typing as npt

from ..frame_source import Image

DARK, FROZEN, SATURATED = "dark", "frozen", "saturated"
REMEDIES = {
    DARK: "the image is black: take the lens cap off, switch the light on, or lengthen the exposure",
    FROZEN: "the camera sends the same picture again and again: power it off and on",
    SATURATED: "much of the image is white: shorten the exposure, lower the gain, or open less of the iris",
}
SAMPLES = 2500
# Thresholds: judgement, no measurement.
WHITE_LEVEL = 250
DARK_LEVEL, DARK_SHARE = 16, 0.99  # a frame is dark when so much of it is no brighter than this grey level
SATURATED_SHARE = 0.2  # a frame is saturated when so much more of it is white than of the background
FROZEN_S = 1.0  # a camera is frozen when its picture stays the same for so long
MIN_REPEATS = 5  # two equal frames and a jump of the clock are no frozen camera
MIN_LIT_LEVEL = 24  # grey levels; darker backgrounds do not show a change of the lights


class FrameChecks:
    """Checks every frame of one camera, and remembers what it needs to notice a frozen image.

    ``background_mean`` (H, W) or (H, W, 3) grey levels of the empty scene; without it only what needs no comparison is
    found. Time is taken from the frames' stamps, so that replayed footage gives the same flags.
    """

    def __init__(self, background_mean: np.ndarray | None = None, *, may_repeat: bool = False) -> None:
        """``may_repeat`` : footage, whose codec repeats a picture in which nothing moves: it is never frozen."""
        self._may_repeat = may_repeat
        self._black_share, self._white_share = 0.0, 0.0  # of the background
        if background_mean is not None:
            background = grid_sample(background_mean)
            self._black_share = float((background <= 1.5 * DARK_LEVEL).mean())
            self._white_share = float((background >= WHITE_LEVEL).mean())
        self._checksum: int | None = None
        self._same_since_ns, self._repeats = 0, 0

    def check(self, image: Image, stamp_ns: int) -> tuple[str, ...]:
        """Flags of ``image`` (H, W) or (H, W, 3) uint8, taken at ``stamp_ns``: some of the keys of REMEDIES."""
        sample = grid_sample(image)
        frozen = self._is_frozen(sample, stamp_ns)
        if is_black(sample) and self._black_share < DARK_SHARE:
            return (DARK,)  # a black image has no noise: whether it is frozen is not visible
        white = int(np.count_nonzero(sample >= WHITE_LEVEL))
        if white > (self._white_share + SATURATED_SHARE) * len(sample):
            return (SATURATED,)  # nor has a white one
        return (FROZEN,) if frozen else ()

    def _is_frozen(self, sample: npt.NDArray[np.uint8], stamp_ns: int) -> bool:
        """Sensor noise makes every frame differ somewhere: equal ones are one frame sent again."""
        checksum = zlib.crc32(sample.data)
        if checksum != self._checksum or stamp_ns < self._same_since_ns:
            self._checksum, self._same_since_ns, self._repeats = checksum, stamp_ns, 0
            return False
        self._repeats += 1
        long_s = (stamp_ns - self._same_since_ns) * 1e-9
        return not self._may_repeat and self._repeats >= MIN_REPEATS and long_s >= FROZEN_S


def is_black(sample: npt.NDArray[np.uint8]) -> bool:
    """Return whether hardly any of these grey levels is brighter than DARK_LEVEL: a covered lens, or a dark room."""
    return int(np.count_nonzero(sample <= DARK_LEVEL)) >= DARK_SHARE * len(sample)


def grid_sample(image: np.ndarray) -> np.ndarray:
    """About SAMPLES pixels of the image (n,), or all channels of them, on a regular grid."""
    step = max(1, math.isqrt(image.shape[0] * image.shape[1] // SAMPLES))
    return np.ascontiguousarray(image[step // 2 :: step, step // 2 :: step]).reshape(-1)
