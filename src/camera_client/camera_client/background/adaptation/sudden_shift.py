"""Finds by how much a picture has moved at once: a camera that somebody touched, shift and roll, up to some pixels.

:func:`sudden_shift` compares the places of steepest slope with the picture at every shift within reach, refines the
best one by Gauss-Newton steps that sample the picture anew (Lucas and Kanade 1981), and believes it only when it
explains what has changed in most regions of the picture. A person, a thing that was moved, other lights do not: they
change a part of the picture, or levels without moving edges. What moves slowly is :class:`.shift.ShiftEstimator`'s.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import cv2
import numpy as np
import numpy.typing as npt

from capture_rig.kernel import njit

from ...frame_source import Image
from ..kernels import OPTIONS, robust_shift
from .shift import HOLD, REACH, Displacement

WIDTH_PX = 640.0  # the search goes by pixels of a picture of this width
ROLLS_RAD = (0.0, -0.004, 0.004, -0.008, 0.008)  # a pixel at half of such a picture's corner is 0.004
WORST = 4.0  # squared residual, in those of a displacement by a step of the search, from which a place is not found
MOST_PLACES = 400  # that are searched for
STEPS, CONVERGED_PX = 8, 0.02
SMOOTHED = 0.141  # what a binomial smoothing (1 2 1) / 4 across and down leaves of the variance of noise: (6 / 16)^2
AROUND, DARK_LEVEL, MOST_LIT = 1 / 8, 8.0, 2.0  # share of the width in which lamps light alike; of black places; ratio
LEAST_PX = 0.15  # less is not told from what the slow estimate settles
REGIONS_DOWN, REGIONS_ACROSS = 3, 4
KNOWN = 25.0  # a region knows when what the displacement changes is 5 sigmas of the noise, together
EXPLAINED = 0.5, 1.5  # it agrees when so much of it was seen to change, this way
MOST_RATIO = 2.0  # a place counts no more than this, whatever stands before it
FEW_REGIONS, AGREEING = 4, 0.65  # a person may hide a third of the picture

Floats = npt.NDArray[np.float32]


class Places(NamedTuple):
    """The places (n,) that are compared: rows, columns, and how much each is trusted, 1 or less."""

    row: npt.NDArray[np.intp]
    column: npt.NDArray[np.intp]
    trust: Floats


def sudden_shift(
    picture: Image, background: Floats, variance: float, places: Places, most_px: float
) -> Displacement | None:
    """Return how the ``picture`` (H, W, C) lies against the ``background`` (H, W, C); None where that is not sure.

    background : grey levels under the light of now. variance : of a pixel's noise. most_px : reach of the search.
    """
    known = _smooth_grey(background)
    seen = _lit_alike(_smooth_grey(picture), known)
    slopes = [np.asarray(cv2.Sobel(known, cv2.CV_32F, *d, scale=1 / 8), np.float32) for d in ((1, 0), (0, 1))]
    right, down = (each[places.row, places.column] for each in slopes)
    x = (places.column - (picture.shape[1] - 1) / 2).astype(np.float32)
    y = (places.row - (picture.shape[0] - 1) / 2).astype(np.float32)
    noise = SMOOTHED * variance / picture.shape[2]
    level = known[places.row, places.column]
    found = _search(seen, level, right * right + down * down, noise, places, most_px)
    found = _refined(seen, level, (right, down, down * x - right * y), noise, places, found)
    if found.most_px(picture.shape) < LEAST_PX or math.hypot(*found[:2]) > most_px:
        return None
    back = Displacement(*(-each for each in found))
    predicted = _sampled(known, places, back) - level
    changed = seen[places.row, places.column] - level
    return found if _agreed(predicted, changed, noise, places, picture.shape) else None


def _smooth_grey(image: npt.NDArray) -> Floats:
    grey = image[..., 0] if image.shape[2] == 1 else cv2.transform(image.astype(np.float32), np.full((1, 3), 1 / 3))
    return np.asarray(cv2.GaussianBlur(grey.astype(np.float32), (3, 3), 0), np.float32)


def _lit_alike(seen: Floats, known: Floats) -> Floats:
    """Return the picture (H, W) as bright as the background around every place: other lamps move no edge."""
    side = 2 * round(AROUND * seen.shape[1] / 2) + 1
    bright, wanted = (cv2.blur(each, (side, side)) + DARK_LEVEL for each in (seen, known))
    return np.asarray(seen * np.clip(wanted / bright, 1 / MOST_LIT, MOST_LIT), np.float32)


def _sampled(image: Floats, places: Places, displacement: Displacement) -> Floats:
    """Return the image (n,) where a displacement puts the places."""
    x, y = places.column - (image.shape[1] - 1) / 2, places.row - (image.shape[0] - 1) / 2
    right, down, roll = displacement
    column = (places.column + right - roll * y).astype(np.float32)
    row = (places.row + down + roll * x).astype(np.float32)
    found = cv2.remap(image, column, row, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    return np.asarray(found.reshape(-1), np.float32)


def _search(seen: Floats, level: Floats, steep2: Floats, noise: float, places: Places, most_px: float) -> Displacement:
    """Return the best of all shifts by whole steps, and some rolls."""
    unit = max(1.0, seen.shape[1] / WIDTH_PX)
    shifts = (unit * np.arange(-(most_px // unit), most_px // unit + 1)).astype(np.float32)
    rolls = np.array(ROLLS_RAD, np.float32)
    precision = 1 / (noise + 0.25 * unit * unit * steep2).astype(np.float32)
    some = slice(None, None, -(-len(level) // MOST_PLACES))
    costs = np.zeros((len(rolls), len(shifts), len(shifts)))
    searched = Places(places.row[some], places.column[some], places.trust[some])
    cost_of_shifts(seen, level[some], precision[some], searched, shifts, rolls, WORST, costs)
    roll, down, right = np.unravel_index(np.argmin(costs), costs.shape)
    return Displacement(float(shifts[right]), float(shifts[down]), float(rolls[roll]))


def _refined(
    seen: Floats, level: Floats, slopes: tuple[Floats, ...], noise: float, places: Places, start: Displacement
) -> Displacement:
    """Refine a displacement by Gauss-Newton steps; the picture is sampled anew for each."""
    right, down, turned = (each.reshape(-1, 1) for each in slopes)
    variance, found = np.full((len(level), 1), noise, np.float32), start
    for _ in range(STEPS):
        rest = (_sampled(seen, places, found) - level).reshape(-1, 1)
        step = Displacement(*robust_shift(rest, right, down, turned, variance, places.trust, 1, REACH, HOLD)[:3])
        found = found.further(step)
        if step.most_px(seen.shape) < CONVERGED_PX:
            break
    return found


def _agreed(predicted: Floats, changed: Floats, noise: float, places: Places, shape: tuple[int, ...]) -> bool:
    """Return whether most regions of the picture changed at the places (n,) as the displacement predicts."""
    region = places.row * REGIONS_DOWN // shape[0] * REGIONS_ACROSS + places.column * REGIONS_ACROSS // shape[1]
    bound = MOST_RATIO * np.abs(predicted)
    square, product = predicted**2, predicted * np.clip(changed, -bound, bound)
    whole, share = (np.bincount(region, each, REGIONS_DOWN * REGIONS_ACROSS) for each in (square, product))
    knows = whole > KNOWN * noise
    ratio = share[knows] / whole[knows]
    agreeing = np.count_nonzero((ratio > EXPLAINED[0]) & (ratio < EXPLAINED[1]))
    return bool(knows.sum() >= FEW_REGIONS and agreeing >= AGREEING * knows.sum())


@njit(**OPTIONS)
def cost_of_shifts(seen, level, precision, places, shifts, rolls, worst, costs):  # type: ignore[no-untyped-def]
    """Add up, for each roll and shift, the squared residuals of all places, bounded; what is out of view is the worst.

    seen (H, W) float32; level, precision (n,) float32 : what the ``places`` should show, and 1 / variance of it;
    shifts (m,) float32 px, down and right; rolls (r,) float32 rad. costs (r, m, m) : zeros, written.
    """
    row, column, trust = places
    height, width = seen.shape
    x0, y0 = 0.5 * (width - 1), 0.5 * (height - 1)
    for i in range(len(level)):
        for k in range(len(rolls)):
            x = column[i] - rolls[k] * (row[i] - y0) + 0.5
            y = row[i] + rolls[k] * (column[i] - x0) + 0.5
            for j in range(len(shifts)):
                v = math.floor(y + shifts[j])
                for h in range(len(shifts)):
                    u = math.floor(x + shifts[h])
                    cost = worst
                    if 0 <= v < height and 0 <= u < width:
                        rest = seen[v, u] - level[i]
                        cost = min(rest * rest * precision[i], worst)
                    costs[k, j, h] += trust[i] * cost
