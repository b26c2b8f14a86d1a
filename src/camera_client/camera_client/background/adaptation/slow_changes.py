"""Follows what changes slowly in single places: a patch of sun that creeps over a wall, dust, a lamp that warms up.

A pixel follows its own grey level only where no foreground has been near for half a minute, so that a person who stands
still stays foreground, and so does everything around. What it may follow is bounded, so that nothing can creep in. The
constants were chosen on the rooms of test/test_camera_light.py: the sun, and a person who stands still for ten minutes.
"""

from __future__ import annotations

import cv2
import numpy as np
import numpy.typing as npt

from ...frame_source import Mask

# Thresholds: chosen with the rooms of test_camera_light.py.
MOST_CHANGE = 12.0  # grey levels by which a single pixel may depart from how it was learned
FOLLOW_S = 60.0  # time constant
QUIET_S = 30.0  # a pixel is followed when no foreground has been near for so long ...
NEAR_OF_HEIGHT = 0.06  # ... within this share of the image height

Floats = npt.NDArray[np.float32]


class SlowChanges:
    """The departure of each pixel from the learned background, grey levels: ``local`` (H, W, C) float32."""

    def __init__(self, shape: tuple[int, ...], block_px: int) -> None:
        """``shape`` : (H, W, C). block_px : side of the blocks of :meth:`note_foreground`."""
        self.local = np.zeros(shape, np.float32)
        self._block_px = block_px
        self._disturbed_ns: npt.NDArray[np.int64] | None = None
        reach = 2 * -(-int(NEAR_OF_HEIGHT * shape[0]) // block_px) + 1
        self._reach = np.ones((reach, reach), np.uint8)

    def note_foreground(self, dense: Mask, stamp_ns: int) -> None:
        """Take the blocks of a frame, one pixel each, that are foreground (not 0)."""
        if self._disturbed_ns is None or (self._disturbed_ns > stamp_ns).any():  # the first, or a clock set back
            self._disturbed_ns = np.full(dense.shape, stamp_ns, np.int64)
        self._disturbed_ns[cv2.dilate(dense, self._reach) > 0] = stamp_ns

    def quiet_anywhere(self, rows: slice, stamp_ns: int) -> bool:
        """Whether some pixels of these rows may be followed."""
        return self._disturbed_ns is not None and bool(self._quiet_blocks(rows, stamp_ns).any())

    def follow(
        self, rows: slice, rest: Floats, background: npt.NDArray[np.bool_], stamp_ns: int, step_s: float
    ) -> Floats:
        """Follow some rows; return by how much their pixels changed (h, W, C).

        rest (h, W, C) : image minus background. background (h, W) : where the image shows the background. step_s :
        since these rows' last turn.
        """
        follows = (self._quiet(rows, stamp_ns) & background)[..., None]
        local = self.local[rows]
        step = np.float32(min(step_s / FOLLOW_S, 1.0)) * rest * follows
        moved = np.clip(local + step, -MOST_CHANGE, MOST_CHANGE)
        self.local[rows] = moved
        return np.asarray(moved - local, np.float32)

    def _quiet_blocks(self, rows: slice, stamp_ns: int) -> npt.NDArray[np.bool_]:
        assert self._disturbed_ns is not None
        blocks = self._disturbed_ns[rows.start // self._block_px : -(-rows.stop // self._block_px)]
        return np.asarray(stamp_ns - blocks >= int(QUIET_S * 1e9))

    def _quiet(self, rows: slice, stamp_ns: int) -> npt.NDArray[np.bool_]:
        """Return (h, W) pixels that no foreground has been near for QUIET_S."""
        side, width = self._block_px, self.local.shape[1]
        pixels = self._quiet_blocks(rows, stamp_ns).repeat(side, axis=0).repeat(side, axis=1)
        top = rows.start % side
        return np.asarray(pixels[top : top + rows.stop - rows.start, :width])
