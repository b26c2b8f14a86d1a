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
STEP_TABLE = 256
STEPS_PER_SIGMA = 8.0


class EvidenceFilter:
    """Smooths squared distances along edges, and decides. Not for two threads at a time."""

    def __init__(self, height: int) -> None:
        """``height`` : of the whole image, pixels."""
        reach = REACH_OF_HEIGHT * height
        steps = np.arange(STEP_TABLE) / STEPS_PER_SIGMA
        length = 1 + reach / EDGE_SIGMAS * steps
        self._tables = np.stack(
            [
                np.exp(-math.sqrt(2) * length / (reach * math.sqrt(3) * 2 ** (PASSES - i) / math.sqrt(4**PASSES - 1)))
                for i in range(1, PASSES + 1)
            ]
        ).astype(np.float32)

    def decide(self, distance: Mask, image: Mask, expected: npt.NDArray[np.float32], noise: Noise) -> Mask:
        """Return (h, w) uint8: 255 where the neighbourhood is foreground, else 0.

        distance (h, w) uint8 : SCALE z^2. image, expected (h, w[, 3]) : the part of the frame, and of the background.
        """
        height, width = distance.shape
        sigma = noise.sigma(float(np.median(expected[::4, ::4])))
        least = 0.5 * least_squared_distance(sigma, noise.correlation, len(noise.read))
        evidence = np.minimum(distance, np.uint8(min(2 * SCALE * CLEAR * least, 255))).astype(np.float32)
        evidence *= np.float32(0.5 / SCALE)
        rest = cv2.subtract(image, expected, dtype=cv2.CV_32F).reshape(height, -1)
        across, down = np.zeros((2, height, width), np.uint8)
        steps_between(rest, np.float32(STEPS_PER_SIGMA / sigma), across, down)
        steps_across = cv2.transpose(across)
        for table in self._tables:
            turned = cv2.transpose(evidence)
            smooth_columns(turned, cv2.LUT(steps_across, table))
            evidence = cv2.transpose(turned)
            smooth_columns(evidence, cv2.LUT(down, table))
        return np.where(evidence > np.float32(least), np.uint8(255), np.uint8(0))


def least_squared_distance(sigma: float, correlation: float, channels: int) -> float:
    """Return z^2 at which background and foreground are equally likely.

    The background is normal with ``sigma`` grey levels a channel, correlated between channels; the foreground may have
    any of 256 levels: z^2 / 2 = sum over channels of log(256 / (sqrt(2 pi) sigma)) - log(det R) / 2.
    """
    determinant = (1 - correlation) ** (channels - 1) * (1 + (channels - 1) * correlation)
    return 2 * channels * math.log(256 / (math.sqrt(2 * math.pi) * sigma)) - math.log(determinant)


@njit(**OPTIONS)
def steps_between(rest, scale, across, down):  # type: ignore[no-untyped-def]
    """Write the largest step of any channel from each pixel to the one left of it, and above it: uint8, 255 at most.

    rest (h, w C) float32, scale : what it is multiplied by; across, down (h, w) uint8, whose first column and row stay.
    """
    height, width = across.shape
    channels = rest.shape[1] // width
    for y in range(height):
        row, to = rest[y], across[y]
        if channels == 1:
            for x in range(1, width):
                to[x] = np.uint8(min(abs(row[x] - row[x - 1]) * scale, np.float32(255)))
        else:
            for x in range(1, width):
                k = channels * x
                most = abs(row[k] - row[k - 3])
                most = max(most, abs(row[k + 1] - row[k - 2]))
                most = max(most, abs(row[k + 2] - row[k - 1]))
                to[x] = np.uint8(min(most * scale, np.float32(255)))
        if y == 0:
            continue
        above, to = rest[y - 1], down[y]
        if channels == 1:
            for x in range(width):
                to[x] = np.uint8(min(abs(row[x] - above[x]) * scale, np.float32(255)))
        else:
            for x in range(width):
                k = channels * x
                most = abs(row[k] - above[k])
                most = max(most, abs(row[k + 1] - above[k + 1]))
                most = max(most, abs(row[k + 2] - above[k + 2]))
                to[x] = np.uint8(min(most * scale, np.float32(255)))


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
