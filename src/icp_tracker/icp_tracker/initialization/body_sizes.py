"""Prior of a person's sizes given the stature, and the covariance of fitted points from uncertain sizes.

Prior: segment lengths over the stature, and how people differ. Means lie between Drillis & Contini 1966 (in Winter,
fig. 4.1: heights of hip .530, knee .285, ankle .039, chin .870, shoulder .818; forearm and hand .254) and the joint
centres of de Leva 1996 (men, women: vertex to cervicale .140, .140; cervicale to mid-hips .347, .354; upper arm .162,
.159; forearm and hand .264, .251; thigh .243, .212; shank .253, .253). The upper arm is de Leva's alone: that of
Drillis & Contini, .186, begins at the acromion, above the joint. Shoulder joints lie medial of the acromia (biacromial
breadth .259 by Drillis & Contini, about .23 in recent surveys) and hip joints 14 % of the pelvic breadth medial of its
ends (Bell et al. 1990), of which the surveys' values are smaller too. The spreads hold the differences of people and
those of the sources.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from stick_figure.body import Body
from stick_figure.body_surface import LENGTHS, lengths_of
from stick_figure.kinematics import stick_frames
from stick_figure.pose import Pose
from stick_figure.skeleton import (
    HEAD,
    L_CALF,
    L_FOREARM,
    L_THIGH,
    L_UPPER_ARM,
    POINT_STICK,
    R_CALF,
    R_FOREARM,
    R_THIGH,
    R_UPPER_ARM,
)

SIZES = (*LENGTHS, "ankle_height")
"""Order of a vector of sizes (10,), metres: lengths of the sticks (the forearm's to the finger tips), the shoulders'
height above the hips, half the joints' distances, and the ankles' height above the floor."""
HEAD_, TORSO_, RISE, SHOULDER, UPPER_ARM, FOREARM, HIP, THIGH, CALF, ANKLE = range(len(SIZES))
# Thresholds: from Drillis & Contini 1966, de Leva 1996, Bell et al. 1990.
MEAN_OVER_STATURE = np.array([0.138, 0.332, 0.281, 0.110, 0.161, 0.259, 0.064, 0.245, 0.247, 0.039])
SD_OVER_STATURE = np.array([0.009, 0.012, 0.014, 0.011, 0.011, 0.009, 0.008, 0.009, 0.007, 0.004])


def body_of_sizes(sizes_m: np.ndarray) -> Body:
    """Return the stick figure of a vector of sizes (10,), metres; left and right are equal."""
    half_lengths = np.empty(10)
    half_lengths[[0, HEAD]] = sizes_m[[TORSO_, HEAD_]]
    half_lengths[[L_UPPER_ARM, R_UPPER_ARM]] = sizes_m[UPPER_ARM]
    half_lengths[[L_FOREARM, R_FOREARM]] = sizes_m[FOREARM]
    half_lengths[[L_THIGH, R_THIGH]] = sizes_m[THIGH]
    half_lengths[[L_CALF, R_CALF]] = sizes_m[CALF]
    half_torso = 0.5 * sizes_m[TORSO_]
    return Body(
        0.5 * half_lengths, sizes_m[SHOULDER], sizes_m[RISE] / half_torso - 1.0, sizes_m[HIP] / sizes_m[SHOULDER]
    )


def sizes_of_body(body: Body) -> np.ndarray:
    """Return the sizes (10,) of a stick figure, metres: the reverse of :func:`body_of_sizes`, sides averaged."""
    return np.append(lengths_of(body), MEAN_OVER_STATURE[ANKLE] * body.stature)


STATURE_SPREAD_M = 0.09  # standard deviation of adults' statures, from surveys


@dataclass(frozen=True, eq=False)
class BodyEstimate:
    """Sizes of one body with their uncertainty.

    sizes : (10,) m, in the order of SIZES. covariance : (10, 10) m^2.
    """

    sizes: np.ndarray
    covariance: np.ndarray

    @cached_property
    def body(self) -> Body:
        """The stick figure of these sizes."""
        return body_of_sizes(self.sizes)

    @property
    def stature(self) -> float:
        """Height of the crown over the soles, metres."""
        return float(self.sizes[[HEAD_, TORSO_, THIGH, CALF, ANKLE]].sum())

    @property
    def sd(self) -> np.ndarray:
        """(10,) standard deviations of the sizes, metres."""
        return np.sqrt(np.diag(self.covariance))

    def updated(self, row: np.ndarray, value: float, sd: float) -> BodyEstimate:
        """Return the estimate after observing row @ sizes = value, metres; Joseph form, which stays symmetric."""
        P = self.covariance
        gain = P @ row / (row @ P @ row + sd**2)
        rest = np.eye(len(row)) - np.outer(gain, row)
        covariance = rest @ P @ rest.T + sd**2 * np.outer(gain, gain)
        return BodyEstimate(self.sizes + gain * (value - row @ self.sizes), covariance)


def prior_sizes(stature_m: float) -> BodyEstimate:
    """Return a person of whom only the stature is known."""
    return BodyEstimate(MEAN_OVER_STATURE * stature_m, np.diag((SD_OVER_STATURE * stature_m) ** 2))


def sizes_of_stature(stature_m: float, sd_m: float) -> BodyEstimate:
    """Return the sizes of a person of a measured stature, standard deviation ``sd_m``, with people's proportions."""
    wide = np.hypot(sd_m, STATURE_SPREAD_M)
    prior = prior_sizes(stature_m)
    common = np.outer(MEAN_OVER_STATURE, MEAN_OVER_STATURE) * wide**2
    row = np.zeros(len(SIZES))
    row[[HEAD_, TORSO_, THIGH, CALF, ANKLE]] = 1.0
    return BodyEstimate(prior.sizes, prior.covariance + common).updated(row, stature_m, sd_m)


# --- covariance of fitted points from uncertain sizes
#
# A fit puts the model's surface on the body's; the place of a joint along its stick depends on the model's sizes alone.
# So a size that is wrong by d moves its own point by d along its own stick. The sticks beyond it do not move: the rays
# show their surfaces. Left and right of one size err together; each point's covariance is its own.

# point: sizes that place it in the frame of its stick, each as (coordinate axis, size, share of the size's error); the
# torso's centre is half its length from either end
_PLACED_BY = (
    ((2, TORSO_, 0.5),),
    ((2, HEAD_, 1.0),),
    ((2, TORSO_, 0.5),),
    *(((1, SHOULDER, 1.0), (2, RISE, 1.0)),) * 2,
    *(((1, HIP, 1.0), (2, TORSO_, 0.5)),) * 2,
    *(((1, UPPER_ARM, 1.0),),) * 2,
    *(((2, THIGH, 1.0),),) * 2,
    *(((1, FOREARM, 1.0),),) * 2,
    *(((2, CALF, 1.0),),) * 2,
)


def _shares() -> np.ndarray:
    """Return (15, 3, SIZES): variance of a point along its stick's axes per variance of each size."""
    shares = np.zeros((len(_PLACED_BY), 3, len(SIZES)))
    for point, placed_by in enumerate(_PLACED_BY):
        for axis, size, share in placed_by:
            shares[point, axis, size] = share**2
    return shares


_SHARES = _shares()


def covariance_of_sizes(pose: Pose, size_sd_m: np.ndarray) -> np.ndarray:
    """Return the covariance (15, 3, 3) m^2, world, of a pose's points from the deviations (10,) m of the sizes."""
    variances = _SHARES @ size_sd_m**2
    frames = stick_frames(pose)[POINT_STICK]
    return np.asarray((frames * variances[:, None, :]) @ frames.transpose(0, 2, 1))
