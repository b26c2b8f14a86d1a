"""Follows by how much the picture of a fixed camera has moved against its background: shift and roll, a few pixels.

A tripod that was touched, a wall that warms, a mount that hums: every edge of the room would become foreground. The
displacement is fitted in every frame, by one robust Gauss-Newton step (:mod:`camera_client.alignment`), which is right
within half a pixel. Larger ones begin from :class:`camera_client.alignment.PictureAlignment`.
"""

from __future__ import annotations

import math
from collections import deque
from statistics import median
from typing import NamedTuple

import cv2
import numpy as np
import numpy.typing as npt

from capture_rig.visibility import MOST_FOLLOWED_SHARE

from ..alignment import FEW_PLACES, FEWEST, gradients, robust_step, steepest
from .kernels import BIN_SIGMAS, HALF_MEDIAN, USUAL_S, median_of

CELLS_ACROSS, IN_CELL = 28, 2  # places: so many in every cell of the picture
# Thresholds: measured by python bench/rooms.py.
LEAST_STEEPNESS = 1.5  # grey levels a pixel
PRIOR_INFORMATION = 30.0  # that the displacement is zero, px^-2: a picture without edges does not move
FOLLOW_PX = 0.1  # a larger displacement is taken over ...
SETTLE_S = 0.2  # ... when it has lasted for so long, the first time at once
DAMPING = 0.5  # slopes are measured over two pixels, which makes fine edges seem to move further than they did
MOST_LEFT_PX = 0.8
RESTLESS = 1.5  # edges that fit worse than in the second before, by such a factor, may have moved at once

Floats = npt.NDArray[np.float32]
STEPS_TO_NEIGHBOURS = [
    np.array(each, np.float32) for each in ([[-1, 1, 0]], [[0, -1, 1]], [[-1], [1], [0]], [[0], [-1], [1]])
]


class Displacement(NamedTuple):
    """How the picture lies against the background: moved right and down, pixels, turned clockwise about its middle."""

    right_px: float = 0.0
    down_px: float = 0.0
    roll_rad: float = 0.0

    def most_px(self, shape: tuple[int, ...]) -> float:
        """Return an upper bound of any pixel's displacement in a picture (H, W)."""
        return math.hypot(self.right_px, self.down_px) + abs(self.roll_rad) * math.hypot(*shape[:2]) / 2

    def plus(self, by: Displacement, times: float = 1.0) -> Displacement:
        """Return the sum with ``times`` another one; displacements are small, so that they add."""
        return Displacement(*(a + times * b for a, b in zip(self, by, strict=True)))

    def moved(self, picture: Floats) -> Floats:
        """Return the background ``picture`` (H, W, C) as the displaced camera sees it: always a new array."""
        if self == Displacement():
            return picture.copy()
        height, width = picture.shape[:2]
        middle = (width - 1) / 2, (height - 1) / 2
        A = np.array(cv2.getRotationMatrix2D(middle, -math.degrees(self.roll_rad), 1.0), float)
        A[:, 2] += self.right_px, self.down_px
        moved = cv2.warpAffine(picture, A, (width, height), flags=cv2.INTER_CUBIC, borderMode=cv2.BORDER_REPLICATE)
        return np.asarray(moved, np.float32).reshape(picture.shape)


def steepness2(picture: Floats) -> Floats:
    """Return the mean squared step (H, W, C) to the neighbours, right and left, and below and above, summed.

    It is what a displacement of a pixel changes a grey level by, squared; unlike a slope it sees lines a pixel wide.
    """
    steps = (cv2.filter2D(picture, -1, kernel, borderType=cv2.BORDER_REPLICATE) for kernel in STEPS_TO_NEIGHBOURS)
    return np.asarray(0.5 * sum(np.square(step) for step in steps), np.float32).reshape(picture.shape)


class Edges(NamedTuple):
    """What is left at the n steep places: picture minus background, and the variance of that by noise, (n, C).

    trust (n,) : 1, less where foreground is likely, 0 where the picture is white.
    """

    rest: Floats
    variance: Floats
    trust: Floats


class ShiftEstimator:
    """Measures the displacement of frames against the background; time is that of the frames' stamps.

    ``total`` is what the background has been moved by; ``left_px`` the displacement that is left, standard deviation.
    """

    def __init__(self, shape: tuple[int, ...]) -> None:
        self._shape = shape
        self.total, self.left_px = Displacement(), 0.1
        self.row = self.column = np.zeros(0, np.intp)
        self._recent: deque[tuple[float, Displacement]] = deque()
        self._time_s, self._usual = 0.0, 1.0

    def place(self, mean: Floats) -> None:
        """Choose the places of a background (H, W, C): the steepest of every cell."""
        right, down = gradients(np.asarray(cv2.GaussianBlur(mean, (3, 3), 0), np.float32).reshape(mean.shape))
        steepness = np.sqrt((right * right + down * down).sum(axis=2))
        at = self.row, self.column = steepest(steepness, LEAST_STEEPNESS, CELLS_ACROSS, IN_CELL)
        x, y = self.column - (self._shape[1] - 1) / 2, self.row - (self._shape[0] - 1) / 2
        turned = down[at] * x[:, None] - right[at] * y[:, None]
        self._slopes = np.stack([right[at], down[at], turned], axis=-1).astype(np.float32)

    @property
    def measurable(self) -> bool:
        """Whether the background has edges enough."""
        return len(self.row) >= FEW_PLACES

    def misfit(self, edges: Edges) -> float:
        """Return how far the edges lie from the background: a robust standard deviation, in those of noise."""
        distance = np.sqrt((edges.rest * edges.rest / edges.variance).mean(axis=1))
        return HALF_MEDIAN * float(median_of(distance, edges.trust, BIN_SIGMAS))

    def is_restless(self, edges: Edges, step_s: float, first: bool) -> bool:
        """Return whether edges fit suddenly worse than in the second before; in the first frame they may."""
        now = max(self.misfit(edges), 1.0)
        restless = first or now > RESTLESS * self._usual
        self._usual += (1.0 if first else 1 - math.exp(-step_s / USUAL_S)) * (now - self._usual)
        return restless

    def measure(self, edges: Edges, gain: Floats, step_s: float, at_once: bool) -> Displacement:
        """Return the displacement since ``total`` that has lasted, damped; none where that is too small to follow.

        gain (C,) : of the light. at_once : this frame alone counts.
        """
        slopes, lever_px = self._slopes * gain[:, None], math.hypot(*self._shape) / 4
        prior = PRIOR_INFORMATION * np.array([1.0, 1.0, lever_px * lever_px])
        x = robust_step(edges.rest, slopes, edges.variance, edges.trust, prior)
        share = 1.0 if at_once else 1 - math.exp(-step_s / (2 * SETTLE_S))
        self.left_px += share * (min(left_over_px(edges, slopes, x), MOST_LEFT_PX) - self.left_px)
        self._time_s += step_s
        self._recent.append((self._time_s, Displacement(*x.tolist())))
        while len(self._recent) > FEWEST and self._recent[1][0] <= self._time_s - SETTLE_S:
            self._recent.popleft()
        lasts = len(self._recent) >= FEWEST and self._time_s - self._recent[0][0] >= SETTLE_S
        if not (at_once or lasts):
            return Displacement()
        lasting = Displacement(*map(median, zip(*(each for _, each in self._recent), strict=True)))
        if lasting.most_px(self._shape) < FOLLOW_PX:
            return Displacement()
        return Displacement().plus(lasting, DAMPING)

    def move(self, by: Displacement) -> bool:
        """Add a displacement to ``total``; False, and nothing is changed, where that is more than is followed."""
        total = self.total.plus(by)
        if total.most_px(self._shape) > MOST_FOLLOWED_SHARE * self._shape[1]:
            return False
        self.total = total
        self._recent.clear()
        return True


def left_over_px(edges: Edges, slopes: Floats, x: npt.NDArray[np.float64]) -> float:
    """Return the displacement that is left after ``x`` (3,), beyond what noise explains: a robust standard deviation.

    It is that of every place along its steepest channel. slopes (n, C, 3) : as the edges look now.
    """
    steep2 = (slopes[..., :2] ** 2).sum(axis=2)
    place = np.flatnonzero((edges.trust >= 1) & steep2.any(axis=1))
    if not len(place):
        return 0.0
    at = place, steep2[place].argmax(axis=1)
    apparent2 = (edges.rest[at] + slopes[at] @ x) ** 2 / steep2[at]
    left2 = HALF_MEDIAN**2 * np.median(apparent2) - np.median(edges.variance[at] / steep2[at])
    return math.sqrt(max(left2, 0.0))
