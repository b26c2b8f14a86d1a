"""How thick a person's limbs are, measured on the hull of the T-pose: factors on the flesh of an average build.

Arms are measured by their vertical thickness and legs by their width, which cameras around the body see from the side;
a hull's depth is not believed. A factor that no person has is refused, limb by limb.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from stick_figure.body import Body
from stick_figure.skeleton import (
    L_CALF,
    L_FOREARM,
    L_THIGH,
    L_UPPER_ARM,
    R_CALF,
    R_FOREARM,
    R_THIGH,
    R_UPPER_ARM,
    STICK_AXIS,
)

from ..flesh import TORSO_CAPSULES, Flesh
from .arms import Arm
from .proportions import ANKLE, MEAN_OVER_STATURE
from .t_pose_shape import TPose

THINNEST, THICKEST = 0.65, 1.6  # factors beyond these are nobody's
FEWEST_PIECES = 2
UPPER_ARM_PART, FOREARM_PART, CALF_PART, THIGH_PART = (0.3, 0.9), (0.1, 0.6), (0.3, 0.85), (0.25, 0.9)
# the sparse samples of a thin arm seldom hold both its top and its bottom: take a large one of the pieces
ARM_QUANTILE, LEG_QUANTILE = 75.0, 50.0


@dataclass(frozen=True)
class FleshSizes:
    """Thickness over that of an average build; 1 where the hull did not tell. ``measured`` names what it told."""

    upper_arm: float = 1.0
    forearm: float = 1.0
    thigh: float = 1.0
    calf: float = 1.0
    trunk: float = 1.0
    measured: tuple[str, ...] = ()

    def by_name(self) -> dict[str, float]:
        """What the hull told, as a body file keeps it."""
        return {name: float(getattr(self, name)) for name in self.measured}

    @classmethod
    def of(cls, thickness: Mapping[str, float]) -> FleshSizes:
        """From a body file's thickness."""
        return cls(**thickness, measured=tuple(thickness))

    def on(self, flesh: Flesh) -> Flesh:
        """The flesh with these thicknesses; the trunk grows to the sides too."""
        factor = np.ones(10)
        factor[[L_UPPER_ARM, R_UPPER_ARM]], factor[[L_FOREARM, R_FOREARM]] = self.upper_arm, self.forearm
        factor[[L_THIGH, R_THIGH]], factor[[L_CALF, R_CALF]] = self.thigh, self.calf
        factor[0] = self.trunk
        start, end = flesh.start.copy(), flesh.end.copy()
        start[:TORSO_CAPSULES, 1] *= self.trunk
        end[:TORSO_CAPSULES, 1] *= self.trunk
        return flesh._replace(start=start, end=end, radii=flesh.radii * factor[flesh.stick][:, None])


def measure_flesh(measured: list[TPose], body: Body) -> FleshSizes:
    """The thickness of the limbs of ``body``, whose T-pose several frame sets show."""
    flesh = Flesh.of(body)
    arm = np.concatenate([_along_arm(side, body) for m in measured for side in m.arms])
    leg = np.concatenate([m.legs.slices for m in measured])
    knee = MEAN_OVER_STATURE[ANKLE] * body.stature + body.lengths[L_CALF]
    leg = np.column_stack([knee - leg[:, 0], leg[:, 1]])
    limbs = {  # pieces, where the stick starts on their scale, the stick, the part of it, the quantile
        "upper_arm": (arm, 0.0, L_UPPER_ARM, UPPER_ARM_PART, ARM_QUANTILE),
        "forearm": (arm, body.lengths[L_UPPER_ARM], L_FOREARM, FOREARM_PART, ARM_QUANTILE),
        "calf": (leg, 0.0, L_CALF, CALF_PART, LEG_QUANTILE),
        "thigh": (leg, -body.lengths[L_THIGH], L_THIGH, THIGH_PART, LEG_QUANTILE),
    }
    found = {
        name: _factor(pieces, start, body.lengths[stick], part, flesh, (stick, quantile))
        for name, (pieces, start, stick, part, quantile) in limbs.items()
    }
    found["trunk"] = _trunk(measured, flesh)
    return FleshSizes.of({name: float(value) for name, value in found.items() if THINNEST <= value <= THICKEST})


def _along_arm(arm: Arm, body: Body) -> np.ndarray:
    """(k, 2) of one arm: distance from the shoulder along the arm, and thickness; metres."""
    stretch = arm.length_from(0.0) / arm.tip
    return np.column_stack([(arm.thickness[:, 0] - body.half_shoulder_width) * stretch, arm.thickness[:, 1]])


def _factor(
    pieces: np.ndarray, start: float, length: float, part: tuple[float, float], flesh: Flesh, limb: tuple[int, float]
) -> float:
    """A quantile of the thickness of pieces (k, 2) over the flesh's, NaN with too few of them.

    start : where the stick starts on the pieces' scale, metres. part : of the stick, which of them count. limb : the
    stick and the quantile, per cent.
    """
    (stick, quantile), along = limb, (pieces[:, 0] - start) / length
    here = (along > part[0]) & (along < part[1])
    if np.count_nonzero(here) < FEWEST_PIECES:
        return float("nan")
    radius = _radii_along(flesh, stick, along[here] * length)
    return float(np.percentile(0.5 * pieces[here, 1] / radius, quantile))


def _radii_along(flesh: Flesh, stick: int, places: np.ndarray) -> np.ndarray:
    """Radius (k,) of the flesh at places (k,) along a stick, metres: between the ends of its capsules, linear."""
    mine, axis = flesh.stick == stick, STICK_AXIS[stick]
    ends = np.abs(np.concatenate([flesh.start[mine, axis], flesh.end[mine, axis]]))
    order = np.argsort(ends)
    return np.interp(places, ends[order], flesh.radii[mine].T.ravel()[order])


def _trunk(measured: list[TPose], flesh: Flesh) -> float:
    """The chest's width below the armpits over the flesh's; NaN where it was not seen."""
    return float(np.median([m.chest_half_width for m in measured])) / (flesh.start[0, 1] + flesh.radii[0, 0])
