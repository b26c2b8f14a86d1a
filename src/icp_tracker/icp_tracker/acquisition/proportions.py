"""What is known of a person's sizes before measuring them: segment lengths over the stature, and how people differ.

Means lie between Drillis & Contini 1966 (in Winter, fig. 4.1: heights of hip .530, knee .285, ankle .039, chin .870,
shoulder .818; upper arm .186, forearm and hand .254) and the joint centres of de Leva 1996 (men, women: vertex to
cervicale .140, .140; cervicale to mid-hips .347, .354; upper arm .162, .159; forearm and hand .264, .251; thigh .243,
.212; shank .253, .253). Shoulder joints lie medial of the acromia (biacromial breadth .259 by Drillis & Contini,
about .23 in recent surveys) and hip joints 14 % of the pelvic breadth medial of its ends (Bell et al. 1990), of which
the surveys' values are smaller too. The spreads hold what people differ by and what those sources do.
"""

from __future__ import annotations

import numpy as np

from stick_figure.body import Body
from stick_figure.skeleton import HEAD, L_CALF, L_FOREARM, L_THIGH, L_UPPER_ARM, R_CALF, R_FOREARM, R_THIGH, R_UPPER_ARM

SIZES = (
    "head",
    "torso",
    "shoulder_rise",
    "half_shoulder_width",
    "upper_arm",
    "forearm",
    "half_hip_width",
    "thigh",
    "calf",
    "ankle_height",
)
"""Order of a vector of sizes (10,), metres: lengths of the sticks (the forearm's to the finger tips), the shoulders'
height above the hips, half the joints' distances, and the ankles' height above the floor."""
HEAD_, TORSO_, RISE, SHOULDER, UPPER_ARM, FOREARM, HIP, THIGH, CALF, ANKLE = range(len(SIZES))
MEAN_OVER_STATURE = np.array([0.138, 0.332, 0.281, 0.110, 0.167, 0.259, 0.064, 0.245, 0.247, 0.039])
SD_OVER_STATURE = np.array([0.009, 0.012, 0.014, 0.011, 0.011, 0.009, 0.008, 0.009, 0.007, 0.004])


def body_of_sizes(sizes_m: np.ndarray) -> Body:
    """The stick figure of a vector of sizes (10,), metres; left and right are equal."""
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
    """The vector of sizes (10,) of a stick figure, metres: the reverse of :func:`body_of_sizes`, sides averaged."""
    sizes, lengths = np.empty(len(SIZES)), body.lengths
    sizes[[TORSO_, HEAD_]] = lengths[[0, HEAD]]
    sizes[UPPER_ARM] = lengths[[L_UPPER_ARM, R_UPPER_ARM]].mean()
    sizes[FOREARM] = lengths[[L_FOREARM, R_FOREARM]].mean()
    sizes[THIGH], sizes[CALF] = lengths[[L_THIGH, R_THIGH]].mean(), lengths[[L_CALF, R_CALF]].mean()
    sizes[RISE] = (1.0 + body.shoulder_height_ratio) * body.half_lengths[0]
    sizes[SHOULDER] = body.half_shoulder_width
    sizes[HIP] = body.hip_width_ratio * body.half_shoulder_width
    sizes[ANKLE] = MEAN_OVER_STATURE[ANKLE] * body.stature
    return sizes
