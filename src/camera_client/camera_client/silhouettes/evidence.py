"""Decides with a neighbourhood what a pixel alone cannot: the likelihood ratio, smoothed along the picture's edges.

A pixel of the person that is as bright as the wall behind it says nothing; those around it do. Every pixel's squared
distance from the background, z^2 / 2, is the logarithm of a likelihood ratio but for a constant. It is averaged over
the neighbourhood, but not across edges of the difference between image and background: there one thing ends and another
begins (recursive filter of Gastal and Oliveira, "Domain transform for edge-aware image and video processing", SIGGRAPH
2011). Averaging does not let correlated errors, of a codec or of the light, count as often as there are pixels.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

import cv2
import numpy as np
import numpy.typing as npt

from capture_rig.kernel import njit

from ..background.kernels import OPTIONS, SCALE
from ..background.noise import Noise
from ..frame_source import Image, Mask
from .masks import Spans

# Thresholds: the threshold itself follows from the likelihood ratio; else measured by python bench/rooms.py.
REACH_OF_HEIGHT = 0.012  # standard deviation of the neighbourhood: half of a forearm
EDGE_SIGMAS = 8.0  # a step of the difference of so many sigmas of the noise counts as a distance of the whole reach
CLEAR = 2.4  # times the least evidence is as sure as a pixel can be: a bright speck must not outvote its surroundings
PASSES = 2  # each way; the second one's reach is half of the first's
TYPICAL_SAMPLES = 1000
STEP_TABLE = 256
STEPS_PER_SIGMA = 8.0


@dataclass(frozen=True, eq=False)
class Scene:
    """A part of a frame, and what the background looks like there now.

    image (h, w[, 3]) uint8; expected (h, w[, 3]) float32, grey levels; change (h, w) uint8 : whole grey levels between
    them in the channel that differs most. noise : of a pixel. at : rows and columns of the part, which begins at
    multiples of the tests' ``alignment_px`` and ends there or where the image ends.
    """

    image: Image
    expected: npt.NDArray[np.float32]
    change: Mask
    noise: Noise
    at: tuple[slice, slice]

    @cached_property
    def codec_sigma(self) -> npt.NDArray[np.float32] | None:
        """Standard deviation (h, w) of a codec's errors, None without one."""
        return codec_error_sigma(self.change, self.noise)

    @cached_property
    def sigma(self) -> float:
        """The noise's standard deviation at the part's typical brightness, grey levels."""
        return self.noise.sigma(self.grey.level)

    @cached_property
    def level(self) -> float:
        """The median grey level of about a thousand pixels of a mono part."""
        every = max(1, math.isqrt(self.expected.size // TYPICAL_SAMPLES))
        return float(np.median(self.expected[every // 2 :: every, every // 2 :: every]))

    @cached_property
    def grey(self) -> Scene:
        """The same of one weighted sum of the channels."""
        if self.image.ndim == 2:
            return self
        image = np.asarray(cv2.cvtColor(self.image, cv2.COLOR_BGR2GRAY), np.uint8)
        expected = np.asarray(cv2.cvtColor(self.expected, cv2.COLOR_BGR2GRAY), np.float32)
        return replace(self, image=image, expected=expected, noise=self.noise.of_grey())


class Part(NamedTuple):
    """A scene around all foreground. distance (h, w) uint8 : of :func:`..background.kernels.compare_box`; spans : what
    of each row and column is looked at."""

    scene: Scene
    distance: Mask
    spans: Spans


class EvidenceFilter:
    """Smooths squared distances along edges, and decides. Not for two threads at a time."""

    def __init__(self, height: int) -> None:
        """``height`` : of the whole image, pixels."""
        reach = REACH_OF_HEIGHT * height
        steps = np.arange(STEP_TABLE) / STEPS_PER_SIGMA
        length = 1 + reach / EDGE_SIGMAS * steps
        first = reach * math.sqrt(3) * 2 ** (PASSES - 1) / math.sqrt(4**PASSES - 1)
        self._table = np.exp(-math.sqrt(2) * length / first).astype(np.float32)

    def decide(self, part: Part) -> Mask:
        """Return (h, w) uint8: 255 where the neighbourhood is foreground, else 0."""
        scene, distance, (rows, columns) = part
        height, width = distance.shape
        least = least_evidence(scene.sigma, scene.noise)
        most = min(int(2 * SCALE * CLEAR * least), 255)
        evidence: np.ndarray = np.zeros((height, width), np.float32)
        across, down = np.zeros((2, height, width), np.uint8)
        errors = np.zeros((0, 0), np.float32) if scene.codec_sigma is None else scene.codec_sigma
        channels = len(scene.noise.read)
        weigh_pixels(distance, most, scene.change, errors, channels, rows, evidence)
        grey = scene.grey
        steps_between(grey.image, grey.expected, np.float32(STEPS_PER_SIGMA / grey.sigma), rows, across, down)
        # what is taken over from a neighbour in the first pass; in the second, of half the reach, its square. Down and
        # across, then across and down, so that the picture is turned but twice
        along, below = cv2.LUT(cv2.transpose(across), self._table), cv2.LUT(down, self._table)
        smooth_columns(evidence, below, rows)
        turned = cv2.transpose(evidence)
        smooth_columns(turned, along, columns)
        smooth_columns(turned, cv2.multiply(along, along), columns)
        evidence = cv2.transpose(turned)
        smooth_columns(evidence, cv2.multiply(below, below), rows)
        return np.asarray(cv2.inRange(evidence, least, math.inf), np.uint8)


def least_evidence(sigma: float, noise: Noise) -> float:
    """Return the evidence z^2 / 2 from which a pixel with ``sigma`` grey levels of noise is rather foreground.

    The background is normal with ``sigma`` grey levels a channel, correlated between channels; the foreground may have
    any of 256 levels: z^2 / 2 = sum over channels of log(256 / (sqrt(2 pi) sigma)) - log(det R) / 2.
    """
    correlation, channels = noise.correlation, len(noise.read)
    determinant = (1 - correlation) ** (channels - 1) * (1 + (channels - 1) * correlation)
    return channels * math.log(256 / (math.sqrt(2 * math.pi) * sigma)) - 0.5 * math.log(determinant)


@njit(**OPTIONS, crops=True)
def weigh_pixels(distance, most, change, codec_sigma, channels, rows, evidence):  # type: ignore[no-untyped-def]
    """Write each pixel's own ``evidence`` (h, w) float32, z^2 / 2, with a codec's errors added to the noise's variance.

    distance (h, w) uint8 : SCALE z^2 by the noise alone, of which no more than ``most`` counts. change (h, w) uint8 :
    image minus background, of the channel that differs most. codec_sigma (h, w) float32 : of those errors in each
    channel, or (0, 0). rows (h, 2) : spans; the rest stays.
    """
    scale, half = np.float32(0.5 / SCALE), np.float32(0.5 * channels)
    for y in range(len(distance)):
        first, end = rows[y, 0], rows[y, 1]  # slices, so that the compiler does eight pixels at a time
        to, own = evidence[y][first:end], distance[y][first:end]
        for x in range(len(to)):
            to[x] = np.float32(min(np.int64(own[x]), most)) * scale
        if codec_sigma.size == 0:
            continue
        differs, error = change[y][first:end], codec_sigma[y][first:end]
        for x in range(len(to)):
            by_codec = np.float32(differs[x]) * np.float32(differs[x]) * half
            to[x] = to[x] * by_codec / max(by_codec + to[x] * error[x] * error[x], np.float32(1e-6))


@njit(**OPTIONS, crops=True)
def steps_between(image, expected, scale, rows, across, down):  # type: ignore[no-untyped-def]
    """Write the step of the difference from each pixel to the one left of it, and above it: uint8, 255 at most.

    image (h, w) uint8, expected (h, w) float32 : of their difference. scale : what it is multiplied by; rows (h, 2) :
    spans; across, down (h, w) uint8, whose first column and row stay, and everything outside of ``rows``.
    """
    height, width = across.shape
    rest, most = np.zeros((2, width), np.float32), np.float32(255)
    for y in range(height):
        row, first, end = rest[y % 2], rows[y, 0], rows[y, 1]
        seen, level = image[y], expected[y]
        for x in range(width):
            row[x] = (np.float32(seen[x]) - level[x]) * scale
        begin = max(first, 1)
        own, left, out = row[begin:end], row[begin - 1 : max(end - 1, 0)], across[y][begin:end]
        for x in range(len(out)):
            out[x] = np.uint8(min(abs(own[x] - left[x]), most))
        if y > 0:
            own, above, out = row[first:end], rest[1 - y % 2][first:end], down[y][first:end]
            for x in range(len(out)):
                out[x] = np.uint8(min(abs(own[x] - above[x]), most))


@njit(**OPTIONS)
def smooth_columns(values, weight, rows):  # type: ignore[no-untyped-def]
    """Smooth each column of ``values`` (h, w) float32 in place, down and back.

    weight (h, w) float32 : how much of the value above each pixel is taken over. rows (h, 2) : spans; what lies outside
    of them stays.
    """
    height = len(values)
    for y in range(1, height):
        _blend_row(values[y - 1], weight[y], rows[y, 0], rows[y, 1], values[y])
    for y in range(height - 2, -1, -1):
        _blend_row(values[y + 1], weight[y + 1], rows[y, 0], rows[y, 1], values[y])


@njit(**OPTIONS)
def _blend_row(values, weight, first, end, out):  # type: ignore[no-untyped-def]
    other, share, own = values[first:end], weight[first:end], out[first:end]
    for x in range(len(own)):
        own[x] += share[x] * (other[x] - own[x])


# --- a codec's errors beside what it had to draw anew
#
# A codec draws an empty room once, and well; but where somebody comes, the blocks around them are drawn anew, coarsely:
# the background beside a person differs from what it was by a share of the contrast within the block. That a codec is
# there shows in its noise, which is as coarse as its blocks (``Noise.spatial_correlation``).

# Thresholds: BLOCK_REACH_PX from the blocks of codecs; else measured by python bench/rooms.py, test_camera_codecs.py.
BLOCK_REACH_PX = 8  # a block of brightness: JPEG, MPEG-4, H.264; colour's are twice as wide, but hardly seen beyond
OF_CONTRAST = 0.12  # of the contrast, standard deviation 2 to 8 px beside people through bench/rooms.py's codecs
FINE_GRAIN = 0.2  # light and displacements that are known inexactly have as much
COLOUR_SHARE = 0.5  # of the errors' standard deviation is left when their brightness is taken away (same bench)


def codec_error_sigma(change: Mask, noise: Noise) -> npt.NDArray[np.float32] | None:
    """Return the standard deviation (h, w) float32 of a codec's errors beside what changed; None without a codec.

    change (h, w) uint8 : grey levels between frame and background.
    """
    if noise.spatial_correlation <= FINE_GRAIN:
        return None
    around = cv2.dilate(change, np.ones((2 * BLOCK_REACH_PX + 1, 2 * BLOCK_REACH_PX + 1), np.uint8))
    share = OF_CONTRAST * (noise.spatial_correlation - FINE_GRAIN) / (1 - FINE_GRAIN)
    return np.asarray(around * np.float32(share), np.float32)
