"""The noise of a camera's pixels: what a sensor, its digitisation and a codec do to an unchanged scene.

Photon transfer (Janesick, "Photon Transfer", SPIE 2007): the variance of a grey level rises in a straight line with the
level, variance = read + slope level, from read noise and photon noise. A codec hides noise where nothing moves, so that
the noise of a decoded background says too little: it is measured again in every frame, on the places that show the
background, where it also holds what a codec, flicker and light that is known inexactly leave.
"""

from __future__ import annotations

import math
from collections import deque
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
from scipy.optimize import nnls

from ..sources.frame_checks import WHITE_LEVEL
from .kernels import HALF_MEDIAN, HIGHEST, STEP_PX, USUAL_S, WITHIN_NOISE
from .light import Light
from .model import NOISIEST, BackgroundModel

# Thresholds: QUANTISATION from rounding, 1/12; else measured by python bench/rooms.py.
QUANTISATION = 1 / 12  # variance of rounding to whole grey levels
LEAST_VARIANCE = 0.35  # of any pixel: rounding of the frame and of what codecs smooth away
MOST_VARIANCE = (WITHIN_NOISE * NOISIEST) ** 2  # a room that seems noisier must not hide a person
LEARNED_BINS, FRAME_BINS = 12, 6  # groups into which pixels are sorted by level
FEW_IN_BIN = 30
TAIL_SHARE, TAIL_SIGMAS = 0.95, 1.96  # share of a normal distribution within these sigmas; codecs change whole blocks
TAIL_ALLOWED = 0.2  # times more is still normal: shadows and things that are not foreground yet
MOST_TAIL = 2.5
NOISE_S = 0.35  # the noise is not measured more often, but for a codec to be known: its time constant is a second
MOST_CORRELATION = 0.6  # beyond, small errors of the colour would count as much as a person

GREY_POWER = sum(weight**2 for weight in (0.299, 0.587, 0.114))  # of a brightness, by BT.601

Floats = npt.NDArray[np.floating]
Pixels = npt.NDArray[np.intp]


class Noise(NamedTuple):
    """Variance of a pixel's grey level in each channel: read + slope level, grey levels squared.

    read, slope (C,) float64. correlation : of two channels' noise: codecs err mostly in brightness.
    spatial_correlation : share that neighbours have in common (:func:`measured_correlation`).
    """

    read: npt.NDArray[np.float64]
    slope: npt.NDArray[np.float64]
    correlation: float = 0.0
    spatial_correlation: float = 0.0

    def variance(self, level: Floats) -> Floats:
        """Return the variance of grey levels (..., C), or of levels without channels for mono images."""
        if len(self.read) == 1:
            return self.read[0] + self.slope[0] * level
        return self.read + self.slope * level

    def of_grey(self) -> Noise:
        """Return the noise of a colour's brightness, in BT.601's weights."""
        share = (self.correlation + (1.0 - self.correlation) * GREY_POWER) / len(self.read)
        read, slope = (np.array([share * sum(each.tolist())]) for each in (self.read, self.slope))
        return self._replace(read=read, slope=slope)

    def sigma(self, level: float) -> float:
        """Return the standard deviation at a grey level, the channels together."""
        return math.sqrt((sum(self.read.tolist()) + level * sum(self.slope.tolist())) / len(self.read))

    @property
    def typical_sigma(self) -> float:
        """Its standard deviation at a middle grey level."""
        return self.sigma(HIGHEST / 2)

    def moved(self, target: Noise, share: float) -> Noise:
        """Return the noise moved by ``share`` of the way to ``target``."""
        return Noise(
            self.read + share * (target.read - self.read),
            self.slope + share * (target.slope - self.slope),
            self.correlation + share * (target.correlation - self.correlation),
        )

    def at_least(self, other: Noise, level: float) -> Noise:
        """Return the noise with each channel replaced by that of ``other`` where it is less at ``level``."""
        less = self.read + self.slope * level < other.read + other.slope * level
        return self._replace(read=np.where(less, other.read, self.read), slope=np.where(less, other.slope, self.slope))


def assumed_noise(sigma: float, channels: int) -> Noise:
    """Return noise of one standard deviation at every level."""
    return Noise(np.full(channels, sigma**2), np.zeros(channels))


def learned_noise(model: BackgroundModel) -> Noise:
    """Return the noise that the frames of the empty room showed."""
    channels = model.channels
    every = max(1, model.mean.size // channels // 20000)
    level = model.mean.reshape(-1, channels)[::every].astype(float)
    variance = model.sigma.reshape(-1, channels)[::every].astype(float) ** 2
    return Noise(*_fit(level, variance, LEARNED_BINS))


def measured_noise(level: Floats, rest: Floats, foreground_known: bool = True) -> Noise | None:
    """Return the noise in a frame: ``rest`` (n, C) is by how much pixels that show the background differ from it.

    level (n, C) : grey levels of the background. foreground_known : the pixels are known to show it; if not, the tails
    are not looked at. None when there are too few pixels to tell.
    """
    if len(level) < 4 * FEW_IN_BIN:
        return None
    channels = level.shape[1]
    noise = Noise(*_fit(level, (HALF_MEDIAN * rest) ** 2, FRAME_BINS))
    scaled = rest / np.sqrt(noise.variance(level))
    if foreground_known:
        beyond = float(np.quantile(np.abs(scaled), TAIL_SHARE, method="nearest")) / TAIL_SIGMAS - TAIL_ALLOWED
        tail2 = min(max(beyond, 1.0), MOST_TAIL) ** 2
        noise = Noise(noise.read * tail2, noise.slope * tail2)
    if channels == 1:
        return noise
    total = np.abs(scaled.sum(axis=1), dtype=np.float32)
    together = (HALF_MEDIAN * float(np.median(total))) ** 2  # channels (1 + (channels - 1) rho)
    rho = (together / channels - 1) / (channels - 1)
    return noise._replace(correlation=float(np.clip(rho, 0.0, MOST_CORRELATION)))


def _fit(level: Floats, square: Floats, bins: int) -> tuple[npt.NDArray[np.float64], npt.NDArray[np.float64]]:
    """Fit read and slope (C,), neither of them negative, by the medians of the squares (n, C) over pixels of similar
    level (n, C)."""
    order = np.array_split(np.argsort(level.sum(axis=1), kind="stable"), bins)
    parts = [part for part in order if len(part) >= FEW_IN_BIN] or [np.arange(len(level))]
    x = np.array([level[part].mean(axis=0) for part in parts], float)
    y = np.array([np.median(square[part].astype(np.float32), axis=0) for part in parts], float)
    weight = 1 / np.maximum(y, LEAST_VARIANCE)
    lines = [
        nnls(w[:, None] * np.stack([np.ones_like(a), a], axis=1), w * b)[0]
        for a, b, w in zip(x.T, y.T, weight.T, strict=True)
    ]
    read, slope = np.array(lines).T
    return np.clip(read + QUANTISATION, LEAST_VARIANCE, MOST_VARIANCE), slope


# --- how coarse it is: a sensor's noise is as fine as its pixels, a codec's as coarse as its blocks

# Thresholds: NEAR_PX, FAR_PX from demosaicing and the blocks of codecs; else measured by python bench/rooms.py.
NEAR_PX, FAR_PX = 2, 16  # demosaicing reaches less far than the one; no block of a codec as far as the other
LEAST_CHANGE = 0.02  # grey levels squared: less is the same picture again
TAIL_OF_MEDIAN = 9.0  # squared differences beyond so many medians are cut off
FEW = 100  # samples
PASSING = 2.0  # times as coarse as what changes at most: codecs that predict frames spread noise less than they keep it
OPPONENT = np.array([[1 / 3, 1, 0], [1 / 3, -1, -1], [1 / 3, 0, 1]], np.float32)  # BGR: brightness, B - G, R - G


def measured_correlation(own: Floats, near: Floats, far: Floats) -> float | None:
    """Return which share of the noise neighbours have in common, on average over brightness and differences of colours.

    own, near, far (n, C) : differences of pixels from what they were, and of those NEAR_PX and FAR_PX to their right;
    what is common to all three, as light, counts little. None when too little differs to tell.
    """
    if len(own) < FEW:
        return None
    if own.shape[1] == 3:
        own, near, far = (each @ OPPONENT for each in (own, near, far))
    most = TAIL_OF_MEDIAN * np.maximum(np.median((own - far) ** 2, axis=0), LEAST_VARIANCE)
    near2, far2 = (np.minimum((own - each) ** 2, most).mean(axis=0) for each in (near, far))
    if (far2 < LEAST_CHANGE).any():
        return None
    return float(np.clip(1 - near2 / far2, 0.0, 1.0).mean())


# --- in every frame


def samples_index(row: Pixels, column: Pixels, width: int) -> Pixels:
    """Return the index of pixels in even rows and columns of a picture of this width among its samples."""
    return row // STEP_PX * -(-width // STEP_PX) + column // STEP_PX


class NoiseEstimator:
    """Measures the noise on what shows the background; it is never less than when the room was empty.

    noise : now. learned : of the empty room, None where it was assumed, not measured.
    """

    def __init__(self, model: BackgroundModel, sigma_floor: float, row: Pixels, column: Pixels) -> None:
        """``row``, ``column`` (n,) : of the pixels that are measured, even. sigma_floor : grey levels."""
        self.learned = learned_noise(model) if model.provenance.frames > 1 else None
        self.noise = self.learned or assumed_noise(model.provenance.mean_noise, model.channels)
        self._least = self.learned or assumed_noise(sigma_floor, model.channels)
        self._at = samples_index(row, column, model.shape[1])
        columns = np.minimum(column, model.shape[1] - 1 - FAR_PX) + np.array([[0], [NEAR_PX], [FAR_PX]])
        self._near_and_far = samples_index(row, columns, model.shape[1])
        self._since_s = 0.0
        self._spatial_correlation: float | None = None
        self._before: tuple[Floats, npt.NDArray[np.bool_]] | None = None
        self._passing: deque[float] = deque(maxlen=2)

    def update(
        self,
        samples: npt.NDArray[np.uint8],
        expected: Floats,
        light: Light,
        rest: Floats,
        doubted: npt.NDArray[np.uint8] | None,
        step_s: float,
    ) -> None:
        """Take a frame, ``step_s`` after the one before.

        samples (C, h, w) : of it; expected (C, h w) : their levels, without the light's gain and offset. rest (n, C) :
        by how much the measured pixels differ. doubted (n,) : 0 where they show the background, None while nothing is
        known of the foreground.
        """
        self._since_s += step_s
        if self._since_s < (NOISE_S / 3 if self._spatial_correlation is None else NOISE_S):
            return
        level = expected[:, self._at].T * light.gain
        sure = np.asarray((level + rest < WHITE_LEVEL).all(axis=1))
        if doubted is not None:
            sure &= doubted == 0
        seen = samples.reshape(len(samples), -1).T[self._near_and_far].astype(np.float32)
        self._update_correlation(seen, seen - expected.T[self._near_and_far] * light.gain - light.offset, sure)
        found = measured_noise(level[sure], rest[sure], foreground_known=doubted is not None)
        if found is None:
            return
        found = found.at_least(self._least, float(np.median(level[sure])))
        share = 1 - math.exp(-self._since_s / USUAL_S)
        self.noise = self.noise.moved(found, share)._replace(spatial_correlation=self._spatial_correlation or 0.0)
        self._since_s = 0.0

    def _update_correlation(self, seen: Floats, rest: Floats, sure: npt.NDArray[np.bool_]) -> None:
        """Take a frame; seen, rest (3, n, C) : grey levels of the pixels, near and far, and by how much they differ."""
        before, self._before = self._before, (seen, sure)
        if before is None:
            return
        found = measured_correlation(*rest[:, sure])
        passing = measured_correlation(*(seen - before[0])[:, sure & before[1]])
        self._passing.append(1.0 if passing is None else passing)  # only codecs show the same picture again
        if found is not None and len(self._passing) == self._passing.maxlen:
            found, known = min(found, PASSING * min(self._passing)), self._spatial_correlation
            share = 1 - math.exp(-self._since_s / USUAL_S)
            self._spatial_correlation = found if known is None else known + share * (found - known)
