"""Decides with a neighbourhood what a pixel alone cannot: the likelihood ratio, smoothed along the picture's edges.

A pixel of the person that is as bright as the wall behind it says nothing; those around it do. Every pixel's squared
distance from the background, z^2 / 2, is the logarithm of a likelihood ratio but for a constant. It is averaged over
the neighbourhood, but not across edges of the difference between image and background: there one thing ends and another
begins (recursive filter of Gastal and Oliveira, "Domain transform for edge-aware image and video processing", SIGGRAPH
2011). Averaging does not let correlated errors, of a codec or of the light, count as often as there are pixels.
"""

from __future__ import annotations

import math

import cv2
import numpy as np
import numpy.typing as npt
from numba import njit

from ..background.kernels import OPTIONS, SCALE
from ..background.noise import Noise
from ..frame_source import Mask

REACH_OF_HEIGHT = 0.012  # standard deviation of the neighbourhood: half of a forearm
EDGE_SIGMAS = 8.0  # a step of the difference of so many sigmas of the noise counts as a distance of the whole reach
CLEAR = 2.4  # times the least evidence is as sure as a pixel can be: a bright speck must not outvote its surroundings
PASSES = 2
TYPICAL_SAMPLES = 1000
STEP_TABLE = 256
STEPS_PER_SIGMA = 8.0


class EvidenceFilter:
    """Smooths squared distances along edges, and decides. Not for two threads at a time."""

    def __init__(self, height: int) -> None:
        """``height`` : of the whole image, pixels."""
        reach = REACH_OF_HEIGHT * height
        steps = np.arange(STEP_TABLE) / STEPS_PER_SIGMA
        length = 1 + reach / EDGE_SIGMAS * steps
        first = reach * math.sqrt(3) * 2 ** (PASSES - 1) / math.sqrt(4**PASSES - 1)
        self._table = np.exp(-math.sqrt(2) * length / first).astype(np.float32)

    def decide(
        self,
        distance: Mask,
        image: Mask,
        expected: npt.NDArray[np.float32],
        noise: Noise,
        spill: npt.NDArray[np.float32] | None = None,
    ) -> Mask:
        """Return (h, w) uint8: 255 where the neighbourhood is foreground, else 0.

        distance (h, w) uint8 : SCALE z^2. image, expected (h, w[, 3]) : the part of the frame, and of the background.
        spill (h, w) : standard deviation of a codec's errors, None without one.
        """
        height, width = distance.shape
        sigma = noise.sigma(typical_level(expected))
        least = 0.5 * least_squared_distance(sigma, noise.correlation, len(noise.read))
        most = min(int(2 * SCALE * CLEAR * least), 255)
        rest = cv2.subtract(image, expected, dtype=cv2.CV_32F).reshape(height, -1)
        evidence: np.ndarray = np.empty((height, width), np.float32)
        across, down = np.zeros((2, height, width), np.uint8)
        weigh_pixels(distance, most, rest, np.zeros((0, 0), np.float32) if spill is None else spill, evidence)
        steps_between(rest, np.float32(STEPS_PER_SIGMA / sigma), across, down)
        # what is taken over from a neighbour in the first pass; in the second, of half the reach, the square of it
        along, below = cv2.LUT(cv2.transpose(across), self._table), cv2.LUT(down, self._table)
        for number in range(PASSES):
            if number:
                along, below = cv2.multiply(along, along), cv2.multiply(below, below)
            turned = cv2.transpose(evidence)
            smooth_columns(turned, along)
            evidence = cv2.transpose(turned)
            smooth_columns(evidence, below)
        return (evidence > np.float32(least)).view(np.uint8) * np.uint8(255)  # np.where takes fifty times as long


def typical_level(expected: npt.NDArray[np.float32]) -> float:
    """Return the median grey level of about a thousand pixels of a part (h, w[, 3])."""
    every = max(1, math.isqrt(expected.shape[0] * expected.shape[1] // TYPICAL_SAMPLES))
    return float(np.median(expected[every // 2 :: every, every // 2 :: every]))


def least_squared_distance(sigma: float, correlation: float, channels: int) -> float:
    """Return z^2 at which background and foreground are equally likely.

    The background is normal with ``sigma`` grey levels a channel, correlated between channels; the foreground may have
    any of 256 levels: z^2 / 2 = sum over channels of log(256 / (sqrt(2 pi) sigma)) - log(det R) / 2.
    """
    determinant = (1 - correlation) ** (channels - 1) * (1 + (channels - 1) * correlation)
    return 2 * channels * math.log(256 / (math.sqrt(2 * math.pi) * sigma)) - math.log(determinant)


@njit(**OPTIONS)
def weigh_pixels(distance, most, rest, spill, evidence):  # type: ignore[no-untyped-def]
    """Write each pixel's own ``evidence`` (h, w) float32, z^2 / 2, with a codec's errors added to the noise's variance.

    distance (h, w) uint8 : SCALE z^2 by the noise alone, of which no more than ``most`` counts. rest (h, w C) float32 :
    image minus background, of which the channel counts that differs most. spill (h, w) float32 : standard deviation of
    the errors in each channel, or (0, 0).
    """
    height, width = distance.shape
    channels = rest.shape[1] // width
    change, scale = np.empty(width, np.float32), np.float32(0.5 / SCALE)
    half = np.float32(0.5 * channels)
    for y in range(height):
        to, own = evidence[y], distance[y]
        for x in range(width):
            to[x] = np.float32(min(np.int64(own[x]), most)) * scale
        if spill.size == 0:
            continue
        row, error = rest[y], spill[y]
        if channels == 1:
            for x in range(width):
                change[x] = abs(row[x])
        else:
            for x in range(width):
                change[x] = max(max(abs(row[3 * x]), abs(row[3 * x + 1])), abs(row[3 * x + 2]))
        for x in range(width):
            by_spill = change[x] * change[x] * half
            to[x] = to[x] * by_spill / max(by_spill + to[x] * error[x] * error[x], np.float32(1e-6))


@njit(**OPTIONS)
def steps_between(rest, scale, across, down):  # type: ignore[no-untyped-def]
    """Write the largest step of any channel from each pixel to the one left of it, and above it: uint8, 255 at most.

    rest (h, w C) float32, scale : what it is multiplied by; across, down (h, w) uint8, whose first column and row stay.
    """
    height, width = across.shape
    channels = rest.shape[1] // width
    step = np.zeros(rest.shape[1], np.float32)
    for y in range(height):
        row = rest[y]
        for k in range(channels, len(row)):
            step[k] = abs(row[k] - row[k - channels]) * scale
        _write_largest(step, 1, across[y])
        if y == 0:
            continue
        above = rest[y - 1]
        for k in range(len(row)):
            step[k] = abs(row[k] - above[k]) * scale
        _write_largest(step, 0, down[y])


@njit(**OPTIONS)
def _write_largest(step, first, out):  # type: ignore[no-untyped-def]
    """Write the largest of each pixel's channels, 255 at most, from the pixel ``first`` on."""
    most = np.float32(255)
    if len(step) == len(out):
        for x in range(first, len(out)):
            out[x] = np.uint8(min(step[x], most))
    else:
        for x in range(first, len(out)):
            out[x] = np.uint8(min(max(max(step[3 * x], step[3 * x + 1]), step[3 * x + 2]), most))


@njit(**OPTIONS)
def smooth_columns(values, weight):  # type: ignore[no-untyped-def]
    """Smooth each column of ``values`` (h, w) float32 in place, down and back.

    weight (h, w) float32 : how much of the value above each pixel is taken over.
    """
    height = len(values)
    for y in range(1, height):
        above, row, share = values[y - 1], values[y], weight[y]
        for x in range(len(row)):
            row[x] += share[x] * (above[x] - row[x])
    for y in range(height - 2, -1, -1):
        below, row, share = values[y + 1], values[y], weight[y + 1]
        for x in range(len(row)):
            row[x] += share[x] * (below[x] - row[x])
