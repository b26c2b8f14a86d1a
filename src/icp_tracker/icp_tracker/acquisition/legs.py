"""The legs of an upright body: straight, side by side, how far apart."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from .refusal import Refusal
from .robust_line import line_through
from .upright import FEWEST_OF_A_PART, SHINS, Upright

LOW, HIGH, STEP = 0.10, 0.40, 0.025  # heights over the stature between which legs are looked at, and one slice
KNEES = (0.25, 0.45)  # heights over the stature: bent knees and a seat's edge show here
STRIDE, KNEES_AHEAD, DEEPEST = 0.14, 0.13, 0.32  # over the stature
WIDEST = 0.35  # tangent of the largest angle of a leg from the vertical


@dataclass(frozen=True)
class Legs:
    """Both legs' mean line in the body's frame: apart, half their distance on the floor, m; spread, rad, the angle of
    each from the vertical, outwards; slices (k, 2) m, height and width of one leg."""

    apart: float
    spread: float
    slices: np.ndarray

    def apart_at(self, height_m: float) -> float:
        """Half the distance of the legs' lines at a height above the floor, metres."""
        return self.apart - height_m * float(np.tan(self.spread))


def find_legs(body: Upright) -> Legs:
    """The legs' lines. Raises Refusal when they are in stride or bent."""
    H = body.stature
    shins = body.between(*SHINS)
    feet = [
        np.median(shins[side * shins[:, 1] > 0.0], axis=0) for side in (1.0, -1.0) if (side * shins[:, 1] > 0).any()
    ]
    if len(feet) == 2 and abs(feet[0][0] - feet[1][0]) > STRIDE * H:
        raise Refusal(f"feet not side by side: one is {abs(feet[0][0] - feet[1][0]):.2f} m ahead of the other")
    knees = body.between(*KNEES)
    if len(knees) < FEWEST_OF_A_PART:
        raise Refusal("no legs in the hull")
    low, high = np.percentile(knees[:, 0], [4, 96])
    ahead = abs(float(np.median(knees[:, 0]) - np.mean([foot[0] for foot in feet])))
    if high - low > DEEPEST * H or ahead > KNEES_AHEAD * H:
        raise Refusal("legs not straight: sitting, or knees bent?")
    return _lines(body)


def _lines(body: Upright) -> Legs:
    H, slices = body.stature, []
    for low in np.arange(LOW, HIGH, STEP):
        slab = body.between(low, low + STEP)
        if len(slab) >= 2 * FEWEST_OF_A_PART:
            middle = float(np.percentile(slab[:, 1], [2, 98]).mean())
            across = np.abs(slab[:, 1] - middle)
            inner, outer = np.percentile(across, [3, 97])
            slices.append(((low + STEP / 2) * H, 0.5 * (inner + outer), outer - inner + body.pitch / 2))
    if len(slices) < 3:
        raise Refusal("no legs in the hull")
    table = np.array(slices)
    slope, apart, _ = line_through(table[:, 0], table[:, 1])
    if abs(slope) > WIDEST:
        raise Refusal(f"legs too far apart: each by {np.degrees(np.arctan(abs(slope))):.0f} degrees")
    return Legs(apart, float(-np.arctan(slope)), table[:, [0, 2]])
