"""People who are not average: longer or shorter arms and legs at the same stature."""

from __future__ import annotations

import numpy as np

from capture_rig.errors import InputError
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
    TORSO,
)

ARMS, LEGS = [L_UPPER_ARM, R_UPPER_ARM, L_FOREARM, R_FOREARM], [L_THIGH, R_THIGH, L_CALF, R_CALF]
LEAST, GREATEST = 0.85, 1.15


def person_of(stature_m: float, arms: float = 1.0, legs: float = 1.0) -> Body:
    """A body of this standing height, m, with arms and legs so many times as long as the average's.

    The torso takes up what the legs leave of the stature. Raises InputError for proportions that are nobody's.
    """
    for name, factor in (("arms", arms), ("legs", legs)):
        if not LEAST <= factor <= GREATEST:
            raise InputError(
                f"{name} {factor:g} times as long as the average's are not a person's",
                remedy=f"Give {LEAST} to {GREATEST}.",
            )
    average = Body.from_stature(stature_m)
    halves = average.half_lengths.copy()
    halves[ARMS] *= arms
    halves[LEGS] *= legs
    longer = 2.0 * float(np.sum(halves[[L_THIGH, L_CALF]] - average.half_lengths[[L_THIGH, L_CALF]]))
    halves[TORSO] -= 0.5 * longer
    return Body(halves, average.half_shoulder_width, average.shoulder_height_ratio, average.hip_width_ratio)
