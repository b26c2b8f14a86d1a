"""Follows slow changes of the light without ever taking up what stands in front of the background.

The constants were chosen on the rooms of test/test_camera_light_drift.py: lamps that warm up, the sun, and a person
who stands still for ten minutes.
"""

from __future__ import annotations

import cv2
import numpy as np
import numpy.typing as npt

from ..frame_source import Image, Mask
from ..settings import BackgroundSettings
from ..sources.frame_checks import MIN_LIT_LEVEL, grid_step
from .model import BackgroundLimits, BackgroundModel, half_width, whole_limits

SWEEP_S = 1.0  # so often every pixel has its turn
GAIN_TIME_S, GAIN_PERIOD_S = 5.0, 0.25
MAX_GAIN = 0.5  # the whole image may become brighter or darker by at most this share
MAX_GAIN_PER_S = 0.005  # lamps that warm up and clouds are slower; switches are not, and they are not followed
MAX_LOCAL = 12.0  # grey levels by which a single pixel may move on top of that
LOCAL_TIME_S = 60.0  # time constant of a single pixel's drift
QUIET_S = 30.0  # a pixel is followed when no foreground has been near for so long ...
NEAR_OF_HEIGHT = 0.06  # ... within this share of the image height
MIN_USABLE_SHARE = 0.4  # of the image has to be background, or the light is not measured at all
MAX_STEP_S = 1.0  # a gap between frames counts as this


class LightDrift:
    """The background's limits, moved along with the light.

    The mean of a pixel is ``gain`` times the learned one plus a local part. The gain follows the median ratio of all
    pixels that are background now. The local part follows a pixel's own grey level, but only where no foreground has
    been near for half a minute: a person who stands still stays foreground, and so does everything around. Both are
    bounded, so that nothing can creep in. Each call works on a band of rows and moves on, so that it costs little.
    ``limits`` are changed in place; as long as the light does not change they stay as learned but for rounding.
    """

    def __init__(
        self, background: BackgroundModel, limits: BackgroundLimits, settings: BackgroundSettings, block_px: int
    ) -> None:
        """``block_px``: side of the square blocks of the image of :meth:`follow`'s ``dense``."""
        self._limits, self.gain, self._block_px = limits, 1.0, block_px
        self._learned = background.mean
        sigma = np.maximum(background.sigma.astype(float), settings.sigma_floor)
        self._half = half_width(sigma, settings.rule, settings.risk).astype(np.float32)
        self._local = np.zeros_like(background.mean)
        step = grid_step(background.shape)
        self._grid = slice(step // 2, None, step), slice(step // 2, None, step)
        self._blocks_of_grid = np.ix_(*(np.arange(n)[step // 2 :: step] // block_px for n in background.shape[:2]))
        blocks = tuple(-(-n // block_px) for n in background.shape[:2])
        self._disturbed_ns: npt.NDArray[np.int64] | None = None
        self._blocks, self._next_row, self._last_ns, self._gain_ns = blocks, 0, 0, 0
        reach = 2 * -(-int(NEAR_OF_HEIGHT * background.shape[0]) // block_px) + 1
        self._reach = np.ones((reach, reach), np.uint8)

    def follow(self, image: Image, within: Mask, dense: Mask, stamp_ns: int) -> None:
        """Take one frame (H, W) or (H, W, 3) of ``stamp_ns``.

        ``within`` (H, W) is 255 where the frame keeps the limits; ``dense`` has a pixel for each block of the image, 1
        where foreground is, else 0.
        """
        if self._disturbed_ns is None or stamp_ns < self._last_ns:  # the first frame, or a clock that was set back
            self._disturbed_ns, self._last_ns = np.full(self._blocks, stamp_ns, np.int64), stamp_ns
            self._gain_ns = stamp_ns
        step_s = min((stamp_ns - self._last_ns) * 1e-9, MAX_STEP_S)
        self._last_ns = stamp_ns
        self._disturbed_ns[cv2.dilate(dense, self._reach) > 0] = stamp_ns
        if stamp_ns - self._gain_ns >= GAIN_PERIOD_S * 1e9:
            far = self._disturbed_ns < stamp_ns
            self._follow_gain(image, within, far, min((stamp_ns - self._gain_ns) * 1e-9, MAX_STEP_S))
            self._gain_ns = stamp_ns
        rows = max(round(len(self._learned) * step_s / SWEEP_S), 1)
        band = slice(self._next_row, self._next_row + rows)
        self._next_row = band.stop if band.stop < len(self._learned) else 0
        self._follow_band(image[band], within[band], band, stamp_ns)

    def _follow_gain(self, image: Image, within: Mask, far: npt.NDArray[np.bool_], step_s: float) -> None:
        """First order, slow, bounded: the median ratio of the background's pixels ``far`` from all foreground."""
        learned = self._learned[self._grid]
        usable = (within[self._grid] > 0) & far[self._blocks_of_grid]
        if usable.mean() < MIN_USABLE_SHARE:
            return
        learned, seen = learned[usable], image[self._grid][usable] - self._local[self._grid][usable]
        lit = learned >= MIN_LIT_LEVEL
        if not lit.any():
            return
        change = float(np.median(seen[lit] / learned[lit])) / self.gain - 1
        most = MAX_GAIN_PER_S * step_s
        gain = self.gain * (1 + np.clip(change * step_s / GAIN_TIME_S, -most, most))
        limit = 1 + MAX_GAIN
        self.gain = float(np.clip(gain, 1 / limit, limit))

    def _follow_band(self, image: Image, within: Mask, band: slice, stamp_ns: int) -> None:
        """One band's local part, and its limits."""
        local = self._local[band]
        mean = self._learned[band] * np.float32(self.gain)
        assert self._disturbed_ns is not None
        quiet = self._spread(stamp_ns - self._disturbed_ns >= int(QUIET_S * 1e9), band)
        follows = cv2.bitwise_and(within, quiet.astype(np.uint8) * 255)
        if cv2.countNonZero(follows):
            rate = min(SWEEP_S / LOCAL_TIME_S, 1.0)
            rest = cv2.copyTo(cv2.subtract(image, cv2.add(mean, local), dtype=cv2.CV_32F), follows)
            np.clip(local + np.float32(rate) * rest.reshape(local.shape), -MAX_LOCAL, MAX_LOCAL, out=local)
        mean += local
        self._limits.lo[band], self._limits.hi[band] = whole_limits(mean, self._half[band])

    def _spread(self, blocks: npt.NDArray[np.bool_], rows: slice) -> npt.NDArray[np.bool_]:
        """Return one value a block to one value a pixel of the rows of the image."""
        (height, width), side = self._learned.shape[:2], self._block_px
        first, last, _ = rows.indices(height)
        pixels = blocks[first // side : -(-last // side)].repeat(side, axis=0).repeat(side, axis=1)
        return pixels[first % side : first % side + last - first, :width]
