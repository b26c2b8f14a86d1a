"""What an empty room looks like to its camera now, and how surely: levels and 1 / sigma of each, pixel by pixel.

The learned background, displaced as the camera is, changed where single places changed, under the light of now:
level = gain field (learned + local) + offset. Its variance adds up noise, what a pixel varied by beyond that when it
was learned (a screen, a plant), the displacement that is left times the picture's slope, and a little uneven light.
"""

from __future__ import annotations

import cv2
import numpy as np
import numpy.typing as npt

from ...frame_source import Image, Mask
from ..kernels import current_levels, refresh_rows, squared_distance, squared_distance_of_colours
from ..model import BackgroundModel
from ..noise import Noise
from .light import FIELD_DOWN, Light
from .shift import Displacement, gradients, steepness2

# Thresholds: measured by python bench/rooms.py.
UNEVEN_LIGHT = 0.004  # relative standard deviation of what a smooth field of light does not hold
WHITE, BLACK = 250.0, 3.0  # grey levels beyond which a background pixel tells one bound only

Floats = npt.NDArray[np.float32]
At = tuple[slice, slice]


class ExpectedImage:
    """Level and 1 / sigma of every pixel.

    Changes of light and noise act on the rows that are renewed; gain and offset act at once.
    """

    def __init__(self, model: BackgroundModel, learned_noise: Noise | None, sigma_floor: float) -> None:
        """``learned_noise`` : None where it was assumed, not measured. sigma_floor : grey levels."""
        height, width = model.shape[:2]
        self.shape = height, width, model.mean.size // (height * width)
        self._learned = np.ascontiguousarray(model.mean.reshape(self.shape), np.float32)
        self._excess_learned = np.zeros_like(self._learned)
        if learned_noise is not None:
            square = model.sigma.reshape(self.shape).astype(float) ** 2
            self._excess_learned += np.maximum(square - learned_noise.variance(self._learned), 0).astype(np.float32)
        self._least_variance = sigma_floor**2
        self._levels, self._inverse_sigma = np.empty_like(self._learned), np.empty_like(self._learned)
        self.place(Displacement(), None)

    @property
    def doubtful(self) -> float:
        """Share of the pixels that are white or black, and tell one bound only."""
        return (len(self._white) + len(self._black)) / (self.shape[0] * self.shape[1])

    # --- what it looks like now

    def samples(self, row: npt.NDArray[np.intp], column: npt.NDArray[np.intp]) -> tuple[Floats, Floats]:
        """Return level / gain, without the offset, and 1 / sigma of some pixels, both (n, C)."""
        return self._levels[row, column], self._inverse_sigma[row, column]

    def flat(self) -> tuple[Floats, Floats, Floats]:
        """Return level / gain without the offset, 1 / sigma, and variance beyond the noise's, (H W, C)."""
        shape = -1, self.shape[2]
        return self._levels.reshape(shape), self._inverse_sigma.reshape(shape), self._excess.reshape(shape)

    def levels(self, at: At, light: Light) -> Floats:
        """Return the grey levels of a part: (h, w), of colour images (h, w, 3)."""
        part, channels = self._levels[at], self.shape[2]
        height, width = part.shape[:2]
        out = np.empty((height, width * channels), np.float32)
        gain, offset = (np.tile(each, width) for each in (light.gain, light.offset))
        current_levels(part.reshape(height, -1), gain, offset, out)
        return out if channels == 1 else out.reshape(part.shape)

    def distance(self, image: Image, light: Light, correlation: float, out: Mask) -> Mask:
        """Write into ``out`` (H, W) uint8 how far each pixel is from the background: min(255, SCALE z^2)."""
        flat = image.reshape(-1), self._levels.reshape(-1), self._inverse_sigma.reshape(-1), light.gain, light.offset
        if self.shape[2] == 1:
            squared_distance(*flat, out.reshape(-1))
        else:
            squared_distance_of_colours(*flat, correlation, out.reshape(-1))
        self._clear_clipped(image, light, out.reshape(-1))
        return out

    def _clear_clipped(self, image: Image, light: Light, out: Mask) -> None:
        """Write 0 where the learned level was clipped: what was white may now be brighter, what was black darker."""
        pixels, gain = image.reshape(-1, self.shape[2]), light.brightness
        if len(self._white) and gain < 1:
            out[self._white[pixels[self._white].min(axis=1) >= WHITE * gain]] = 0
        if len(self._black):
            most = BLACK * (1 + gain) + max(float(light.offset.max()), 0.0)
            out[self._black[pixels[self._black].max(axis=1) <= most]] = 0

    # --- changes

    def place(self, displacement: Displacement, local: Floats | None) -> tuple[Floats, Floats]:
        """Move the learned background to where the camera looks now; return its slopes right and down, levels / px.

        ``local`` (H, W, C) : departures from it, there. All rows have to be renewed then.
        """
        self._mean, self._excess = (
            np.maximum(displacement.moved(each), 0) for each in (self._learned, self._excess_learned)
        )
        self._white = np.flatnonzero((self._mean >= WHITE).any(axis=2).reshape(-1))
        self._black = np.flatnonzero((self._mean <= BLACK).all(axis=2).reshape(-1))
        if local is not None:
            self._mean += local
        right, down = gradients(self._mean)
        self._steepness2 = steepness2(self._mean)
        return right, down

    def change(self, rows: slice, by: Floats) -> None:
        """Add to the background's levels (h, W, C) of some rows, which have to be renewed then."""
        self._mean[rows] += by

    def renew(self, rows: slice, light: Light, noise: Noise, left_px: float) -> None:
        """Renew some rows for the light and noise of now; ``left_px`` : displacement that is left."""
        first, end, _ = rows.indices(self.shape[0])
        height, width, channels = self.shape
        parts = np.stack(
            [
                np.maximum(noise.read, self._least_variance),
                noise.slope,
                np.full(channels, left_px**2),
                np.full(channels, UNEVEN_LIGHT**2),
            ]
        )
        across = cv2.resize(light.field, (width, FIELD_DOWN), interpolation=cv2.INTER_LINEAR)
        down = (np.arange(first, end) + 0.5) * FIELD_DOWN / height - 0.5
        refresh_rows(
            *(each[rows].reshape(end - first, -1) for each in (self._mean, self._excess, self._steepness2)),
            across.reshape(FIELD_DOWN, -1),
            down.clip(0, FIELD_DOWN - 1).astype(np.float32),
            np.tile(parts.astype(np.float32), width),
            *(each[rows].reshape(end - first, -1) for each in (self._levels, self._inverse_sigma)),
        )

    def rest(self, image: Image, rows: slice, light: Light) -> tuple[Floats, Floats]:
        """Return image minus background of some rows, and its squared distance in each channel, (h, W, C)."""
        rest = image.reshape(self.shape)[rows] - (self._levels[rows] * light.gain + light.offset)
        return rest, np.square(rest * self._inverse_sigma[rows])


# --- what changes slowly in single places: sun that creeps over a wall, dust, a lamp that warms up

# Thresholds: chosen with the rooms of test_camera_light.py.
MOST_CHANGE = 12.0  # grey levels by which a single pixel may depart from how it was learned
FOLLOW_S = 60.0  # time constant
QUIET_S = 30.0  # a pixel is followed when no foreground has been near for so long ...
NEAR_OF_HEIGHT = 0.06  # ... within this share of the image height


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
