"""The background of a fixed camera as it looks now: learned once, followed in light, noise and displacement.

:meth:`AdaptiveBackground.follow` is the recipe for each frame: estimate the light, register the picture, measure the
noise that is left, and renew the expected image, some rows at a time. A person in view does not matter to any of them:
the fits are robust, and what was foreground a frame ago counts little.
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
from .expected_image import Corners, ExpectedImage, Floats, Rows, Samples
from .fixed import FixedBackground
from .kernels import BLOCK_PX, HIGHEST, SCALE, STEP_PX, USUAL_S, gather_residuals, gather_samples
from .light import FIELD_ACROSS, FIELD_DOWN, Light, LightEstimator
from .model import BackgroundModel
from .noise import Noise, NoiseEstimator, samples_index
from .shift import Displacement, Edges, ShiftEstimator

# Thresholds: measured by python bench/rooms.py; SAMPLES from the error of a mean, 1/sqrt(n): with 1500, 4000 or 6000
# two men in a laboratory are tracked 5 to 15 mm worse (--lab), the noise's correlation being measured lower
SAMPLES = 3000  # on a regular grid: the light to a thousandth
BANDS, SWEEP_S = 8, 0.25  # all rows of the expected image are renewed in so many turns: light's field takes as long
TURN_S = SWEEP_S / BANDS  # a turn: the displacement is not measured more often
MOST_STEPS = 6  # of a displacement that is taken over at once, each damped


class AdaptiveBackground:
    """Follows one camera's background. One thread at a time; equal frames give equal bytes.

    lights, shift, expected : what was measured in the last frame, of light, displacement and clipped pixels.
    """

    step_px = STEP_PX

    def __init__(
        self, model: BackgroundModel, settings: BackgroundSettings, aligner: PictureAlignment | None = None
    ) -> None:
        """``aligner`` : of the model's mean; without one only displacements of a pixel are followed."""
        height, width = model.shape[:2]
        step = max(1, math.isqrt(height * width // SAMPLES))
        rows, columns = np.meshgrid(
            *(np.arange(step // 2, n, step) // STEP_PX * STEP_PX for n in (height, width)), indexing="ij"
        )
        row, column = rows.reshape(-1), columns.reshape(-1)
        self._noises = NoiseEstimator(model, settings.sigma_floor, row, column)
        self.expected = ExpectedImage(model, self._noises.learned, settings.sigma_floor)
        channels = self.expected.shape[2]
        self.threshold = min(round(SCALE * float(chdtri(channels, settings.risk))), int(HIGHEST) - 1)
        cell = row * FIELD_DOWN // height * FIELD_ACROSS + column * FIELD_ACROSS // width
        self.lights = LightEstimator(cell, channels)
        self._sampled = np.stack([samples_index(row, column, width), self._block_index(row, column)])
        self.shift, self._aligner = ShiftEstimator((height, width)), aligner
        self._doubted: Mask = np.zeros(-(-height // BLOCK_PX) * -(-width // BLOCK_PX), np.uint8)
        self._foreground_known = False
        self._last_ns: int | None = None
        self._since_shift_s = self._since_renewal_s = 0.0
        self._next_row = 0
        self._place()

    @property
    def light(self) -> Light:
        """The light now."""
        return self.lights.light

    @property
    def noise(self) -> Noise:
        """The noise now."""
        return self._noises.noise

    # --- background subtraction

    def distance(self, image: Image, samples: Samples) -> Mask:
        """Return how far every ``step_px``-th pixel is from the background: min(255, SCALE z^2), (h, w) uint8."""
        return self.expected.distance(samples, self._today)

    def compare(self, image: Image, box: Corners, rows: Rows) -> tuple[Floats, Mask]:
        """Return a part of the background as it looks now, (h, w) or (h, w, 3), grey levels; and (2, h, w) uint8 how
        far the image is from it: min(255, SCALE z^2), and grey levels. ``rows`` : what is looked at."""
        return self.expected.compare(image, box, self._today, rows)

    def add_foreground(self, dense: Mask) -> None:
        """Take the blocks of this frame (one pixel each, not 0 where foreground is): they count little in the next."""
        self._doubted = np.asarray(cv2.dilate(dense, np.ones((3, 3), np.uint8)).reshape(-1), np.uint8)
        self._foreground_known = True

    # --- following

    def update(self, image: Image, samples: Samples, stamp_ns: int) -> None:
        """Take one frame (H, W) or (H, W, 3) of ``stamp_ns``, and its samples, into account."""
        first = self._last_ns is None
        step_s = USUAL_S if self._last_ns is None else (stamp_ns - self._last_ns) * 1e-9
        step_s, self._last_ns = min(max(step_s, 0.0), USUAL_S), stamp_ns
        picture = image.reshape(self.expected.shape)
        # illumination compensation
        rest = self._fit_light(samples, step_s)
        # registration: a camera that was touched has moved at once
        self._since_shift_s += step_s
        measured = self.shift.measurable and self._since_shift_s >= TURN_S
        edges = self._edges(picture) if measured else None
        touched = (
            edges is not None
            and self.shift.is_restless(edges, self._since_shift_s, first)
            and self._align(picture, edges)
        )
        if touched:
            self.lights.rollback()
            rest, edges = self._fit_light(samples, step_s), self._edges(picture)
        # noise model
        doubted = self._doubted[self._sampled[1]] if self._foreground_known else None
        self._noises.update(samples, self.expected.samples[0], self.light, rest, doubted, step_s)
        # registration: a displacement that lasts, by Gauss-Newton steps; without a cause, one at a time
        for _ in range(MOST_STEPS):
            if edges is None or not self._update_shift(picture, edges, touched or first):
                break
            if first:
                self._fit_light(samples, step_s)
            edges = self._edges(picture)
        self._renew(step_s)

    def _fit_light(self, seen: Samples, step_s: float) -> Floats:
        """Return what is left of the samples (n, C), grey levels."""
        channels, n = len(seen), self._sampled.shape[1]
        samples, trust = np.empty((3, channels, n), np.float32), np.empty(n, np.float32)
        gather_samples(seen.reshape(channels, -1), *self.expected.samples, self._sampled, self._doubted, samples, trust)
        return self.lights.update(samples, trust, step_s).T

    # --- registration

    def _edges(self, picture: Image) -> Edges:
        """Return what is left at the steep places under the light and noise of now."""
        at, channels = self._steep, self.expected.shape[2]
        out, trust = np.empty((2, at.shape[1], channels), np.float32), np.empty(at.shape[1], np.float32)
        pixels, mean, excess = (each.reshape(-1, channels) for each in (picture, *self.expected.displaced[:2]))
        now = np.array([self.light.gain, self.light.offset, self.noise.read, self.noise.slope])
        field = self._cell_weights @ self.light.field.reshape(-1, channels)
        gather_residuals(pixels, mean, excess, field, at, self._doubted, now, out, trust)
        return Edges(out[0], out[1], trust)

    def _update_shift(self, picture: Image, edges: Edges, at_once: bool) -> bool:
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
        found = self._aligner.align(image, self._aligner.turn_of(*total), search=False)
        if found is None:
            return False
        since = Displacement(*self._aligner.displacement_of(found.turn_rad)).plus(total, -1.0)
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

    def _place(self) -> None:
        """Move the background to where the camera looks now, and renew everything."""
        self.shift.place(*self.expected.place(self.shift.total))
        row, column = self.shift.row, self.shift.column
        self._steep = np.stack([row * self.expected.shape[1] + column, self._block_index(row, column)])
        self._cell_weights = self.expected.cell_weights(row, column)
        self._renew_all()

    def _block_index(self, row: npt.NDArray[np.intp], column: npt.NDArray[np.intp]) -> npt.NDArray[np.intp]:
        return row // BLOCK_PX * -(-self.expected.shape[1] // BLOCK_PX) + column // BLOCK_PX

    # --- the expected image

    def _renew_all(self) -> None:
        self._today = self.expected.today(self.light, self.noise, self.shift.left_px)
        self.expected.renew(slice(0, self.expected.shape[0]), self._today)

    def _renew(self, step_s: float) -> None:
        """Renew the next rows, or all when the light was switched."""
        self._today = self.expected.today(self.light, self.noise, self.shift.left_px)
        height = self.expected.shape[0]
        if self.light.switched:
            self.expected.renew(slice(0, height), self._today)
        self._since_renewal_s += step_s
        if self._since_renewal_s < TURN_S:
            return
        share, self._since_renewal_s = max(1 / BANDS, min(self._since_renewal_s / SWEEP_S, 1.0)), 0.0
        end = min(self._next_row + math.ceil(height * share / STEP_PX) * STEP_PX, height)
        self.expected.renew(slice(self._next_row, end), self._today)
        self._next_row = end % height


Background = AdaptiveBackground | FixedBackground
