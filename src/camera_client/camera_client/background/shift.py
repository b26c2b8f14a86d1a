"""Measures by how much the picture of a fixed camera has moved against its background: shift and roll, a few pixels.

A tripod that was touched, a wall that warms, a mount that hums: every edge of the room would become foreground. The
displacement is fitted to the steepest places of the picture, in every frame, robustly against what stands before them:
one Gauss-Newton step, within half a pixel. Larger ones begin from :class:`camera_client.alignment`.
"""

from __future__ import annotations

import math
from collections import deque
from statistics import median
from typing import NamedTuple

import cv2
import numpy as np
import numpy.typing as npt

from capture_rig.kernel import njit
from capture_rig.small_matrices import solve_positive
from capture_rig.visibility import MOST_FOLLOWED_SHARE

from ..alignment import strongest
from .kernels import BIN_SIGMAS, HALF_MEDIAN, OPTIONS, USUAL_S, median_of, robust_weights

CELLS_ACROSS, IN_CELL = 28, 2  # steep places: so many in every cell of the picture
STEPS = 4  # of the robust fit
# Thresholds: measured by python bench/rooms.py.
PRIOR_INFORMATION = 30.0  # that the displacement is zero, px^-2: a picture without edges does not move
FOLLOW_PX = 0.1  # a larger displacement is taken over ...
SETTLE_S, SETTLED_SHARE = 0.25, 0.8  # ... when it has lasted for so long, the first time at once
DAMPING = 0.5  # slopes are measured over two pixels, which makes fine edges seem to move further than they did
MOST_LEFT_PX = 0.8
LEFT_S = 2 * SETTLE_S  # time constant of what is left: of what did not last
RESTLESS = 1.5  # edges that fit worse than in the second before, by such a factor, may have moved at once
FEW_PLACES = 40
FEWEST = 3  # frames whose median counts
LEAST_STEEPNESS = 1.5  # grey levels a pixel

Floats = npt.NDArray[np.float32]


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


def gradients(picture: Floats) -> tuple[Floats, Floats]:
    """Return the slopes (H, W, C) to the right and downwards, grey levels a pixel, of a slightly smoothed picture."""
    smooth = cv2.GaussianBlur(picture, (3, 3), 0)
    right, down = (np.asarray(cv2.Sobel(smooth, cv2.CV_32F, *d, scale=1 / 8), np.float32) for d in ((1, 0), (0, 1)))
    return right.reshape(picture.shape), down.reshape(picture.shape)


def steepness2(picture: Floats) -> Floats:
    """Return the mean squared step (H, W, C) to the neighbours, right and left, and below and above, summed.

    It is what a displacement of a pixel changes a grey level by, squared; unlike a slope it sees lines a pixel wide.
    """
    total = np.zeros_like(picture)
    down, right = (0.5 * np.square(np.diff(picture, axis=axis)) for axis in (0, 1))
    total[1:] += down
    total[:-1] += down
    total[:, 1:] += right
    total[:, :-1] += right
    return total


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

    def place(self, right: Floats, down: Floats) -> None:
        """Choose the places: the steepest of every cell of a background with these slopes (H, W, C)."""
        steepness = np.sqrt((right * right + down * down).sum(axis=2))
        self.row, self.column, _ = strongest(steepness, LEAST_STEEPNESS, CELLS_ACROSS, IN_CELL)
        right, down = right[self.row, self.column], down[self.row, self.column]
        x, y = self.column - (self._shape[1] - 1) / 2, self.row - (self._shape[0] - 1) / 2
        self._slopes = np.stack([right, down, (down * x[:, None] - right * y[:, None]).astype(np.float32)])

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
        found = robust_shift(edges.rest, self._slopes * gain, edges.variance, edges.trust, math.hypot(*self._shape) / 4)
        instant, left_px = Displacement(*found[:3]), float(found[3])
        share = 1.0 if at_once else 1 - math.exp(-step_s / LEFT_S)
        self.left_px += share * (min(left_px, MOST_LEFT_PX) - self.left_px)
        self._time_s += step_s
        self._recent.append((self._time_s, instant))
        while len(self._recent) > FEWEST and self._recent[0][0] < self._time_s - SETTLE_S:
            self._recent.popleft()
        lasts = len(self._recent) >= FEWEST and self._time_s - self._recent[0][0] >= SETTLED_SHARE * SETTLE_S
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


@njit(**OPTIONS)
def robust_shift(rest, slopes, variance, trust, lever_px):  # type: ignore[no-untyped-def]
    """Fit rest = -slopes' (dx, dy, roll) by iteratively reweighted least squares: by how much the picture moved.

    rest, variance (n, C) float32: residuals, and the noise's variance. slopes (3, n, C) float32 : how much they change
    for a pixel to the right, downwards, and a radian clockwise about the middle. trust (n,) float32. lever_px : how far
    from the middle a roll shows, half of the picture about. Gives dx, dy, roll, and the displacement that is left, a
    robust standard deviation in pixels.
    """
    A, factor, b, x = np.empty((3, 3)), np.empty((3, 3)), np.empty(3), np.zeros(3)
    left, distance, robust = np.empty(rest.shape), np.empty(len(rest), np.float32), np.empty(len(rest))
    _residuals(rest, slopes, variance, x, left, distance)
    for _ in range(STEPS):
        robust_weights(distance, trust, BIN_SIGMAS, robust)
        A[:], b[:] = 0.0, 0.0
        A[0, 0] = A[1, 1] = PRIOR_INFORMATION
        A[2, 2] = PRIOR_INFORMATION * lever_px * lever_px
        _add_normal_equations(rest, slopes, variance, robust, A, b)
        if not solve_positive(A, b, factor, x):
            x[:] = 0.0
        _residuals(rest, slopes, variance, x, left, distance)
    return x[0], x[1], x[2], _displacement_left(left, slopes, variance, trust)


@njit(**OPTIONS)
def _residuals(rest, slopes, variance, x, left, distance):  # type: ignore[no-untyped-def]
    """Write what is ``left`` (n, C) after a displacement x, and its ``distance`` (n,) from 0, standard deviations."""
    n, channels = rest.shape
    for i in range(n):
        total = 0.0
        for c in range(channels):
            left[i, c] = rest[i, c] + slopes[0, i, c] * x[0] + slopes[1, i, c] * x[1] + slopes[2, i, c] * x[2]
            total += left[i, c] * left[i, c] / variance[i, c]
        distance[i] = np.sqrt(total / channels)


@njit(**OPTIONS)
def _add_normal_equations(rest, slopes, variance, robust, A, b):  # type: ignore[no-untyped-def]
    """Add all residuals to the lower triangle of A x = b."""
    for i in range(rest.shape[0]):
        for c in range(rest.shape[1]):
            w = robust[i] / variance[i, c]
            for j in range(3):
                pull = w * slopes[j, i, c]
                b[j] -= pull * rest[i, c]
                for k in range(j + 1):
                    A[j, k] += pull * slopes[k, i, c]


@njit(**OPTIONS)
def _displacement_left(left, slopes, variance, trust):  # type: ignore[no-untyped-def]
    """Return how far the picture still lies from the background, along the slope of each place's steepest channel,
    beyond what noise explains: a robust standard deviation in pixels."""
    n, channels = left.shape
    apparent, noise, clear = np.zeros(n, np.float32), np.zeros(n, np.float32), np.zeros(n, np.float32)
    for i in range(n):
        most, steepest = 0.0, 0
        for c in range(channels):
            steep2 = slopes[0, i, c] * slopes[0, i, c] + slopes[1, i, c] * slopes[1, i, c]
            if steep2 > most:
                most, steepest = steep2, c
        if trust[i] >= 1.0 and most > 0.0:
            clear[i], apparent[i] = 1.0, abs(left[i, steepest]) / np.sqrt(most)
            noise[i] = np.sqrt(variance[i, steepest] / most)
    left_px, noise_px = HALF_MEDIAN * median_of(apparent, clear, 0.01), median_of(noise, clear, 0.01)
    return np.sqrt(max(left_px * left_px - noise_px * noise_px, 0.0))
