"""What an empty room looks like to its camera now, and how surely: levels and 1 / sigma of each, pixel by pixel.

The learned background, displaced as the camera is, under the light of now: level = gain field learned + offset. Its
variance adds up noise, what a pixel varied by beyond that when it was learned (a screen, a plant), the displacement
that is left times the picture's slope, and a little uneven light.
"""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt

from ..frame_source import Image, Mask
from ..sources.frame_checks import WHITE_LEVEL
from .kernels import BLACK, STEP_PX, WHITE, Bounds, Learned, Today, compare_box, distance_of_samples, refresh_samples
from .light import FIELD_ACROSS, FIELD_DOWN, Light
from .model import BackgroundModel
from .noise import Noise
from .shift import Displacement, gradients, steepness2

# Thresholds: measured by python bench/rooms.py.
UNEVEN_LIGHT = 0.004  # relative standard deviation of what a smooth field of light does not hold
BLACK_LEVEL = 3  # grey levels; a background pixel beyond this or WHITE_LEVEL tells one bound only

Floats = npt.NDArray[np.float32]
Samples = npt.NDArray[np.uint8]
"""Every STEP_PX-th row and column of an image, (C, h, w)."""
Corners = tuple[int, int, int, int]
"""Of a part of the picture: top, left, bottom, right, the last two excluded."""
Rows = npt.NDArray[np.int64]
"""Of each row of a part (h, 2): the first column that is looked at, and the one after the last."""


def samples_of(image: Image) -> Samples:
    """Return every STEP_PX-th row and column of an image (H, W) or (H, W, C): (C, h, w)."""
    return np.ascontiguousarray(np.atleast_3d(image)[::STEP_PX, ::STEP_PX].transpose(2, 0, 1))


class ExpectedImage:
    """Level and variance of every pixel, of samples at once and of any part when it is asked for.

    Of samples, changes of light and noise act on the rows that are renewed; gain and offset act at once.
    displaced : what was learned of every pixel, (H, W, C), where the camera looks now.
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
        down, across = -(-height // STEP_PX), -(-width // STEP_PX)
        levels, inverse_sigma = np.empty((2, self.shape[2], down * across), np.float32)
        self.samples: tuple[Floats, Floats] = levels, inverse_sigma
        """Level / gain, without the offset, and 1 / sigma of every sample, both (C, n)."""
        self.place(Displacement())

    @property
    def doubtful(self) -> float:
        """Share of the pixels that are white or black, and tell one bound only."""
        return float(np.count_nonzero(self._clipped)) / self._clipped.size

    # --- what it looks like now

    def today(self, light: Light, noise: Noise, left_px: float) -> Today:
        """Return light and noise, and what clipped pixels look like now: what was white may be brighter, what was black
        darker. ``left_px`` : displacement that is left."""
        variances = np.empty((4, self.shape[2]), np.float32)
        variances[0], variances[1] = np.maximum(noise.read, self._least_variance), noise.slope
        variances[2], variances[3] = left_px**2, UNEVEN_LIGHT**2
        gain = light.brightness
        white = WHITE_LEVEL * gain if gain < 1 else math.inf
        bounds = Bounds(white, BLACK_LEVEL * (1 + gain) + max(*light.offset.tolist(), 0.0), noise.correlation)
        return Today(light.field, variances, np.stack([light.gain, light.offset]), bounds)

    def distance(self, samples: Samples, today: Today) -> Mask:
        """Return how far each sample of (C, h, w) uint8 is from the background: min(255, SCALE z^2), (h, w) uint8."""
        out, looks = np.empty(samples.shape[1:], np.uint8), (each.reshape(samples.shape) for each in self.samples)
        distance_of_samples(samples, *looks, today, self._clipped_samples, out)
        return out

    def compare(self, image: Image, box: Corners, today: Today, rows: Rows) -> tuple[Floats, Mask]:
        """Return what :func:`.kernels.compare_box` finds in a box: the grey levels (h, w), of colour images (h, w, 3);
        and (2, h, w) uint8 by how much ``image`` differs."""
        (top, left, bottom, right), (height, _, channels) = box, self.shape
        out = np.empty((bottom - top, (right - left) * channels), np.float32)
        found = np.empty((2, bottom - top, right - left), np.uint8)
        flat = Learned(*(each.reshape(height, -1) for each in self.displaced))
        compare_box(image.reshape(height, -1), flat, today, self._clipped, (top, left), rows, out, found)
        return out if channels == 1 else out.reshape(bottom - top, right - left, channels), found

    def cell_weights(self, row: npt.NDArray[np.intp], column: npt.NDArray[np.intp]) -> Floats:
        """Return the weight of each of the light's cells (n, cells) at some pixels."""
        down, across = (
            np.maximum(1 - np.abs(_in_cells(at, size, cells)[:, None] - np.arange(cells)), 0)
            for at, size, cells in ((row, self.shape[0], FIELD_DOWN), (column, self.shape[1], FIELD_ACROSS))
        )
        weights = down[:, :, None] * across[:, None, :]
        return weights.reshape(len(row), FIELD_DOWN * FIELD_ACROSS).astype(np.float32)

    # --- changes

    def place(self, displacement: Displacement) -> tuple[Floats, Floats]:
        """Move the learned background to where the camera looks now; return its slopes right and down, levels / px.

        All rows have to be renewed then.
        """
        mean, excess = (np.maximum(displacement.moved(each), 0) for each in (self._learned, self._excess_learned))
        white, black = (mean >= WHITE_LEVEL).any(axis=2), (mean <= BLACK_LEVEL).all(axis=2)
        self._clipped = np.where(white, np.uint8(WHITE), np.where(black, np.uint8(BLACK), np.uint8(0)))
        self._clipped_samples = np.ascontiguousarray(self._clipped[::STEP_PX, ::STEP_PX])
        self.displaced = Learned(mean, excess, steepness2(mean))
        thinned = (each[::STEP_PX, ::STEP_PX].transpose(2, 0, 1) for each in self.displaced)
        self._thinned = Learned(*map(np.ascontiguousarray, thinned))
        return gradients(mean)

    def renew(self, rows: slice, today: Today) -> None:
        """Renew the samples in some rows for the light and noise of now."""
        shape = self._thinned.mean.shape
        first, end = rows.start // STEP_PX, -(-rows.stop // STEP_PX)
        refresh_samples(self._thinned, today, first, end, *(each.reshape(shape) for each in self.samples))


def _in_cells(at: npt.NDArray[np.intp], size: int, cells: int) -> Floats:
    """Return where rows or columns of a picture of that ``size`` lie between the middles of the light's cells."""
    return ((at + 0.5) * cells / size - 0.5).clip(0, cells - 1).astype(np.float32)
