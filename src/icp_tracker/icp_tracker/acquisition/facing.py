"""Which of the two directions across the arms' axis is forward.

Toes lie ahead of the ankles, and the head lies ahead of the shoulders. Each lead is an observation with a mean and a
spread among people; their log-likelihood ratios for "forward" against "backward" add up.
"""

from __future__ import annotations

import numpy as np

from .arms import Arm
from .upright import FEET_TO, FEWEST_OF_A_PART, Upright

SHIN = (0.10, 0.22)  # heights over the stature
FOOT_HALF_WIDTH, FOOT_REACH = 0.04, 0.17  # over the stature: a foot is 0.055 wide and 0.152 long (Drillis & Contini)
# over the stature: how far the middle of a foot lies ahead of the shin, how far the head ahead of the arms; both +-
FOOT_LEAD, FOOT_LEAD_SD = 0.040, 0.020
HEAD_LEAD, HEAD_LEAD_SD = 0.015, 0.017
LONG_FOOT = 0.20  # longer than a foot in a hull: a shadow on the floor, which is seldom symmetrical
HEAD_FROM, SHOULDER = 0.90, 0.10  # over the stature


def facing(body: Upright, arms: tuple[Arm, Arm]) -> float:
    """Log-likelihood ratio that the body's x axis points forward and not backward."""
    H = body.stature
    shins = body.between(*SHIN)
    halves = [shins[side * shins[:, 1] > 0.0, :2] for side in (1.0, -1.0)]
    shoulders = float(np.mean([arm.at(SHOULDER * H, H)[0] for arm in arms]))
    ankles = [np.median(half, axis=0) for half in halves if len(half) >= FEWEST_OF_A_PART]
    return evidence_of_feet(body, ankles) + evidence_of_head(body, shoulders)


def evidence_of_feet(body: Upright, ankles: list[np.ndarray]) -> float:
    """Log-likelihood ratio from the feet, given where the ankles (2,) are, ahead and across in the body's frame."""
    H, evidence = body.stature, 0.0
    feet = body.between(-1.0, FEET_TO)[:, :2]
    for ankle in ankles:
        ahead, across = (feet - ankle).T
        foot = ahead[(np.abs(across) < FOOT_HALF_WIDTH * H) & (np.abs(ahead) < FOOT_REACH * H)]
        if len(foot) >= FEWEST_OF_A_PART:
            heel, toe = np.percentile(foot, [3, 97])
            sd = FOOT_LEAD_SD * H + max(0.0, toe - heel - LONG_FOOT * H)
            evidence += _log_ratio(0.5 * (heel + toe), FOOT_LEAD * H, sd)
    return evidence


def evidence_of_head(body: Upright, shoulders_ahead_m: float) -> float:
    """Log-likelihood ratio from the head, given how far ahead in the body's frame the shoulders are."""
    H = body.stature
    head = body.between(HEAD_FROM, 2.0)
    head = head[np.abs(head[:, 1]) < SHOULDER * H]
    if len(head) < FEWEST_OF_A_PART:
        return 0.0
    return _log_ratio(float(np.median(head[:, 0])) - shoulders_ahead_m, HEAD_LEAD * H, HEAD_LEAD_SD * H)


def _log_ratio(lead: float, expected: float, sd: float) -> float:
    """Of a lead that is Gaussian about +``expected`` forwards and about -``expected`` backwards."""
    return 2.0 * lead * expected / sd**2
