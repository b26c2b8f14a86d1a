"""The sizes of a body from the hull of its T-pose: what the hull shows, joined with what is known of people.

The hull shows sums of lengths: from floor to crown, from hand to hand, from the floor to the arms. How a sum splits at
a joint inside straight flesh (elbow, knee, neck, hip) only proportions tell. Both are Gaussian here, so the estimate is
one linear update of the prior and comes with its covariance.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from stick_figure.body import Body

from .proportions import (
    ANKLE,
    CALF,
    FOREARM,
    HEAD_,
    HIP,
    MEAN_OVER_STATURE,
    RISE,
    SD_OVER_STATURE,
    SHOULDER,
    SIZES,
    THIGH,
    TORSO_,
    UPPER_ARM,
    body_of_sizes,
)
from .t_pose_shape import TPose

HIP_HEIGHT = float(MEAN_OVER_STATURE[[THIGH, CALF, ANKLE]].sum())
FINGERS_LOST_M = 0.015  # fingers are thinner than a voxel: a hull's arms end before the tips
SHOULDER_BEYOND_CHEST = 0.015  # over the stature: shoulder joints lie outside the trunk's sides at the armpits
# what hulls err by, over the stature
STATURE_SD, ARM_SD, ARM_HEIGHT_SD, CHEST_SD, LEGS_SD = 0.006, 0.009, 0.009, 0.009, 0.010


@dataclass(frozen=True, eq=False)
class BodyEstimate:
    """Sizes of one body with their uncertainty.

    sizes : (10,) m, in the order of :data:`.proportions.SIZES`. covariance : (10, 10) m^2.
    """

    sizes: np.ndarray
    covariance: np.ndarray

    @cached_property
    def body(self) -> Body:
        """The stick figure of these sizes."""
        return body_of_sizes(self.sizes)

    @property
    def sd(self) -> np.ndarray:
        """(10,) standard deviations of the sizes, metres."""
        return np.sqrt(np.diag(self.covariance))


def prior_sizes(stature_m: float) -> BodyEstimate:
    """A person of whom only the stature is known."""
    return BodyEstimate(MEAN_OVER_STATURE * stature_m, np.diag((SD_OVER_STATURE * stature_m) ** 2))


def estimate_body(measured: list[TPose]) -> BodyEstimate:
    """The body that several frame sets of one held T-pose show; medians over the sets."""
    stature = float(np.median([m.stature for m in measured]))
    estimate = prior_sizes(stature)
    for row, value, sd in _observations(measured, stature):
        estimate = _update(estimate, row, value, sd * stature)
    return estimate


def _observations(measured: list[TPose], H: float) -> list[tuple[np.ndarray, float, float]]:
    """What the hull says of the sizes: row (10,), value in metres, standard deviation over the stature."""
    upright = float(np.median([np.cos(m.legs.spread) for m in measured]))
    legs = {THIGH: upright, CALF: upright, ANKLE: 1.0}
    half_width = MEAN_OVER_STATURE[SHOULDER] * H
    stretch, tips, heights = np.median([_arms(m, half_width) for m in measured], axis=0)
    found = [
        # floor to crown
        (_row({HEAD_: 1.0, TORSO_: 1.0, **legs}), H, STATURE_SD),
        # spine to finger tips, along the arm from the shoulder on
        (_row({UPPER_ARM: 1.0, FOREARM: 1.0, SHOULDER: stretch}), stretch * tips + FINGERS_LOST_M, ARM_SD),
        # floor to the arms where they leave the shoulders
        (_row({RISE: 1.0, **legs}), heights, ARM_HEIGHT_SD),
        # the legs' lines at the hips
        (_row({HIP: 1.0}), float(np.median([m.legs.apart_at(HIP_HEIGHT * H) for m in measured])), LEGS_SD),
    ]
    chest = float(np.median([m.chest_half_width for m in measured]))
    if np.isfinite(chest):
        found.append((_row({SHOULDER: 1.0}), chest + SHOULDER_BEYOND_CHEST * H, CHEST_SD))
    return found


def _arms(measured: TPose, half_width: float) -> tuple[float, float, float]:
    """Of both arms on average: length over its share across, distance of the tip from the spine, height at the
    shoulder; metres."""
    arms = measured.arms
    stretch = np.mean([arm.length_from(0.0) / arm.tip for arm in arms])
    heights = np.mean([arm.at(half_width, measured.stature)[1] for arm in arms])
    return float(stretch), float(np.mean([arm.tip for arm in arms])), float(heights)


def _row(entries: dict[int, float]) -> np.ndarray:
    row = np.zeros(len(SIZES))
    for index, value in entries.items():
        row[index] = value
    return row


def _update(estimate: BodyEstimate, row: np.ndarray, value: float, sd: float) -> BodyEstimate:
    """The estimate after observing row @ sizes = value, metres; Joseph form, which stays symmetric."""
    P = estimate.covariance
    gain = P @ row / (row @ P @ row + sd**2)
    rest = np.eye(len(row)) - np.outer(gain, row)
    return BodyEstimate(
        estimate.sizes + gain * (value - row @ estimate.sizes), rest @ P @ rest.T + sd**2 * np.outer(gain, gain)
    )
