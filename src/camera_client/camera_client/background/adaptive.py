"""The background of a fixed camera as it looks now: learned once, followed in light, noise and displacement.

:meth:`AdaptiveBackground.follow` is the recipe for each frame: sample the picture, estimate the light, measure the
noise that is left and the displacement, and renew the expected image, some rows at a time. A person in view does not
matter to any of them: the fits are robust, and what was foreground a frame ago counts little.

The thesis's rules (6.2, 6.3), which follow nothing, are :class:`FixedBackground`; both say of every pixel how
far it is from the background, as a squared distance in sigmas.
"""

from __future__ import annotations

import math

import cv2
import numpy as np
import numpy.typing as npt
from scipy.special import chdtri

from ..alignment import LINEAR_PX, PictureAlignment
from ..frame_source import Image, Mask
from ..settings import BackgroundSettings
from ..sources.frame_checks import WHITE_LEVEL
from .expected_image import Corners, ExpectedImage, Floats, Rows, Samples
from .kernels import HIGHEST, SCALE, STEP_PX, USUAL_S, Today, take_residuals, take_samples, thin_out
from .light import FIELD_ACROSS, FIELD_DOWN, Light, LightEstimator
from .model import BackgroundModel
from .noise import Noise, NoiseCorrelationMeter, assumed_noise, learned_noise, measured_noise
from .shift import Displacement, Edges, ShiftEstimator

# Thresholds: measured by python bench/rooms.py; SAMPLES from the error of a mean, 1/sqrt(n): with 1500, 4000 or 6000
# two men in a laboratory are tracked 5 to 15 mm worse (--lab), the noise's correlation being measured lower
SAMPLES = 3000  # on a regular grid: the light to a thousandth
BANDS, SWEEP_S = 8, 0.25  # all rows of the expected image are renewed in so many turns: light's field takes as long
TURN_S = SWEEP_S / BANDS  # a turn: the displacement is not measured more often
NOISE_S = 0.35  # the noise is not measured more often, but for a codec to be known: its time constant is a second
MOST_STEPS = 6  # of a displacement that is taken over at once, each damped


def samples_of(image: Image) -> Samples:
    """Return every STEP_PX-th row and column of an image (H, W) or (H, W, C): (C, h, w)."""
    pixels = image.reshape(*image.shape[:2], -1)
    out = np.empty((pixels.shape[2], *(-(-n // STEP_PX) for n in image.shape[:2])), np.uint8)
    thin_out(pixels, out)
    return out


class AdaptiveBackground:
    """Follows one camera's background. One thread at a time; equal frames give equal bytes.

    lights, shift, expected : what was measured in the last frame, of light, displacement and clipped pixels.
    """

    step_px = STEP_PX

    def __init__(
        self,
        model: BackgroundModel,
        settings: BackgroundSettings,
        block_px: int,
        aligner: PictureAlignment | None = None,
    ) -> None:
        """``block_px`` : side of the blocks of :meth:`note_foreground`. ``aligner`` : of the model's mean; without
        one only displacements of a pixel are followed."""
        measured = model.provenance.frames > 1
        channels = 1 if model.mean.ndim == 2 else model.mean.shape[2]
        self._noise = learned_noise(model) if measured else assumed_noise(model.provenance.mean_noise, channels)
        self._least_noise = self._noise if measured else assumed_noise(settings.sigma_floor, channels)
        self.expected = ExpectedImage(model, self._noise if measured else None, settings.sigma_floor)
        self.threshold = min(round(SCALE * float(chdtri(channels, settings.risk))), int(HIGHEST) - 1)
        height, width = model.shape[:2]
        step = max(1, math.isqrt(height * width // SAMPLES))
        rows, columns = np.meshgrid(
            *(np.arange(step // 2, n, step) // STEP_PX * STEP_PX for n in (height, width)), indexing="ij"
        )
        self._row, self._column = rows.reshape(-1), columns.reshape(-1)
        cell = self._row * FIELD_DOWN // height * FIELD_ACROSS + self._column * FIELD_ACROSS // width
        self.lights = LightEstimator(cell, channels)
        self._coarseness = NoiseCorrelationMeter(self._row, self._column, width)
        self.shift, self._aligner = ShiftEstimator((height, width)), aligner
        self._block_px = block_px
        self._blocks = -(-height // block_px), -(-width // block_px)
        self._sampled = self._indices(self._row, self._column)
        self._sampled[0] = self._sample_indices(self._row, self._column)
        self._dense: Mask | None = None
        self._nowhere = np.zeros(math.prod(self._blocks), np.uint8)
        self._last_ns: int | None = None
        self._next_row = 0
        self._since_noise_s = self._since_shift_s = self._since_renewal_s = 0.0
        self._made_of: tuple[Light | None, Noise | None, float] = None, None, 0.0
        self._place()

    # --- the frame's answer

    @property
    def light(self) -> Light:
        """The light now."""
        return self.lights.light

    @property
    def noise(self) -> Noise:
        """The noise now."""
        return self._noise

    def distance(self, image: Image, samples: Samples) -> Mask:
        """Return how far every ``step_px``-th pixel is from the background: min(255, SCALE z^2), (h, w) uint8."""
        return self.expected.distance(samples, self._today)

    def look(self, image: Image, box: Corners, rows: Rows) -> tuple[Floats, Mask]:
        """Return a part of the background as it looks now, (h, w) or (h, w, 3), grey levels; and (2, h, w) uint8 how
        far the image is from it: min(255, SCALE z^2), and grey levels. ``rows`` : what is looked at."""
        return self.expected.look(image, box, self._today, rows)

    # --- following

    def note_foreground(self, dense: Mask) -> None:
        """Take the blocks of this frame (one pixel each, not 0 where foreground is): they count little in the next."""
        self._dense = cv2.dilate(dense, np.ones((3, 3), np.uint8))

    def follow(self, image: Image, samples: Samples, stamp_ns: int) -> None:
        """Take one frame (H, W) or (H, W, 3) of ``stamp_ns``, and its samples, into account."""
        self._samples = samples
        first = self._last_ns is None
        step_s = USUAL_S if self._last_ns is None else (stamp_ns - self._last_ns) * 1e-9
        step_s, self._last_ns = min(max(step_s, 0.0), USUAL_S), stamp_ns
        picture = image.reshape(self.expected.shape)
        rest = self._follow_light(step_s)
        self._since_shift_s += step_s
        measured = self.shift.measurable and (first or self._since_shift_s >= TURN_S)
        edges = self._edges(picture) if measured else None
        at_once = (  # what has moved at once
            edges is not None
            and self.shift.is_restless(edges, self._since_shift_s, first)
            and self._align(picture, edges)
        )
        if at_once:
            self.lights.rollback()
            rest, edges = self._follow_light(step_s), self._edges(picture)
        self._follow_noise(rest, step_s, first)
        steps, at_once = MOST_STEPS, at_once or first  # without a cause, one step at a time
        while edges is not None and self._follow_shift(picture, edges, at_once):
            if first:
                self._follow_light(step_s)
            steps -= 1
            edges = self._edges(picture) if steps else None
        if first or self.light.switched:
            self.expected.renew(slice(0, self.expected.shape[0]), self._today)
        self._renew_next(step_s)

    def _follow_light(self, step_s: float) -> Floats:
        """Return what is left of the samples (n, C), grey levels."""
        channels, n = self.expected.shape[2], len(self._row)
        samples, trust = np.empty((3, channels, n), np.float32), np.empty(n, np.float32)
        seen = self._samples.reshape(channels, -1)
        take_samples(seen, *self.expected.samples, self._sampled, self._doubted(), samples, trust)
        return self.lights.update(samples, trust, step_s).T

    def _follow_noise(self, rest: Floats, step_s: float, first: bool) -> None:
        """Measure the noise on what shows the background; it is never less than when the room was empty."""
        self._since_noise_s += step_s
        if not first and self._since_noise_s < (NOISE_S if self._coarseness.known else NOISE_S / 3):
            return
        level = self.expected.samples[0][:, self._sampled[0]].T * self.light.gain
        sure = (self._doubted()[self._sampled[1]] == 0) & (level + rest < WHITE_LEVEL).all(axis=1)
        spatial = self._update_correlation(sure)
        level = level[sure]
        found = measured_noise(level, rest[sure], foreground_known=self._dense is not None)
        if found is None:
            return
        found = found.at_least(self._least_noise, float(np.median(level)))
        share = 1 - math.exp(-self._since_noise_s / USUAL_S)
        self._noise = self._noise.moved(found, share)._replace(spatial_correlation=spatial)
        self._since_noise_s = 0.0

    def _update_correlation(self, sure: npt.NDArray[np.bool_]) -> float:
        at = self._sample_indices(self._coarseness.row, self._coarseness.column)
        seen = self._samples.reshape(len(self._samples), -1).T[at].astype(np.float32)
        rest = seen - self.expected.samples[0].T[at] * self.light.gain - self.light.offset
        return self._coarseness.update(seen, rest, sure, self._since_noise_s)

    def _follow_shift(self, picture: Image, edges: Edges, at_once: bool) -> bool:
        """Move the background by a displacement that lasts, one Gauss-Newton step; True when it has moved."""
        step_s, self._since_shift_s = self._since_shift_s, 0.0
        found = self.shift.measure(edges, self.light.gain, step_s, at_once)
        if found.most_px(self.expected.shape) > LINEAR_PX:
            return self._align(picture, edges)
        return found != Displacement() and self._move(found, picture, edges)

    def _align(self, picture: Image, edges: Edges) -> bool:
        """Move the background to where the whole picture lies, if edges fit better there; True when it has moved."""
        if self._aligner is None:
            return False
        total, image = self.shift.total, picture if picture.shape[2] == 3 else picture[..., 0]
        found = self._aligner.shift(image, total)
        if found is None:
            return False
        since = Displacement(*found).plus(total, -1.0)
        return since.most_px(self.expected.shape) >= LINEAR_PX and self._move(since, picture, edges)

    def _move(self, by: Displacement, picture: Image, edges: Edges) -> bool:
        """Move the background; False where edges fit no better there, or the camera is not followed so far."""
        if not self.shift.move(by):
            return False
        self._place()
        if self.shift.misfit(self._edges(picture)) < self.shift.misfit(edges):
            return True
        self.shift.move(Displacement().plus(by, -1.0))
        self._place()
        return False

    def _edges(self, picture: Image) -> Edges:
        """Return what is left at the steep places under the light and noise of now."""
        at, channels = self._steep, self.expected.shape[2]
        out, trust = np.empty((2, at.shape[1], channels), np.float32), np.empty(at.shape[1], np.float32)
        pixels, (mean, excess) = picture.reshape(-1, channels), self.expected.flat()
        now = np.array([self.light.gain, self.light.offset, self._noise.read, self._noise.slope])
        field = self._cell_weights @ self.light.field.reshape(-1, channels)
        take_residuals(pixels, mean, excess, field, at, self._doubted(), now, out, trust)
        return Edges(out[0], out[1], trust)

    def _indices(self, row: npt.NDArray[np.intp], column: npt.NDArray[np.intp]) -> npt.NDArray[np.intp]:
        """Return the index of each pixel in the picture, and of its block in the picture's blocks, (2, n)."""
        side = self._block_px
        return np.stack([row * self.expected.shape[1] + column, row // side * self._blocks[1] + column // side])

    def _sample_indices(self, row: npt.NDArray[np.intp], column: npt.NDArray[np.intp]) -> npt.NDArray[np.intp]:
        """Return the index of pixels in even rows and columns among the samples."""
        return row // STEP_PX * -(-self.expected.shape[1] // STEP_PX) + column // STEP_PX

    def _doubted(self) -> Mask:
        """Return the blocks (n,) near foreground of a frame ago, not 0."""
        return self._nowhere if self._dense is None else self._dense.reshape(-1)

    # --- the expected image

    def _place(self) -> None:
        """Move the background to where the camera looks now, and renew everything."""
        self.shift.place(self.expected.place(self.shift.total))
        self._steep = self._indices(self.shift.row, self.shift.column)
        self._cell_weights = self.expected.cell_weights(self.shift.row, self.shift.column)
        self.expected.renew(slice(0, self.expected.shape[0]), self._today)

    @property
    def _today(self) -> Today:
        light, noise, left_px = now = self.light, self._noise, self.shift.left_px
        if any(a is not b for a, b in zip(now, self._made_of, strict=True)):
            self._made_of, self._made = now, self.expected.today(light, noise, left_px)
        return self._made

    def _renew_next(self, step_s: float) -> None:
        """Renew the next rows."""
        self._since_renewal_s += step_s
        if self._since_renewal_s < TURN_S:
            return
        height = self.expected.shape[0]
        share, self._since_renewal_s = max(1 / BANDS, min(self._since_renewal_s / SWEEP_S, 1.0)), 0.0
        end = min(self._next_row + math.ceil(height * share / STEP_PX) * STEP_PX, height)
        self.expected.renew(slice(self._next_row, end), self._today)
        self._next_row = end % height


FOREGROUND_DISTANCE = 255


class FixedBackground:
    """Answers as :class:`AdaptiveBackground` does, and follows nothing: pixels are background or not."""

    threshold, step_px = FOREGROUND_DISTANCE - 1, 1

    def __init__(self, model: BackgroundModel, settings: BackgroundSettings) -> None:
        self._limits, self._mean = model.limits(settings), model.mean
        typical = float(np.median(np.maximum(model.sigma, np.float32(settings.sigma_floor))))
        channels = 1 if model.mean.ndim == 2 else 3
        self.light, self.noise = Light.unchanged(channels), assumed_noise(typical, channels)

    def follow(self, image: Image, samples: Samples, stamp_ns: int) -> None:
        """Follow nothing."""

    def note_foreground(self, dense: Mask) -> None:
        """Take no notice."""

    def distance(self, image: Image, samples: Samples) -> Mask:
        """Return 0 (H, W) where the image keeps the limits of 6.3, else 255."""
        return self._beyond(image)

    def look(self, image: Image, box: Corners, rows: Rows) -> tuple[Floats, Mask]:
        """Return a part of the background, (h, w) or (h, w, 3), grey levels; and (2, h, w) uint8: 0 where the image
        keeps the limits of 6.3, else 255, and by how many grey levels it differs."""
        top, left, bottom, right = box
        at = slice(top, bottom), slice(left, right)
        change = cv2.absdiff(image[at], cv2.convertScaleAbs(self._mean[at]))
        change = change if change.ndim == 2 else change.max(axis=2)
        return self._mean[at], np.stack([self._beyond(image, at), change])

    def _beyond(self, image: Image, at: tuple[slice, slice] = (slice(None), slice(None))) -> Mask:
        lo, hi = self._limits
        return cv2.bitwise_not(cv2.inRange(image[at], lo[at], hi[at]))
