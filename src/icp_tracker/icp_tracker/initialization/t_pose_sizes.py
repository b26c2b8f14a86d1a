"""Update of a person's sizes by the hull of a T-pose.

The hull shows sums of lengths: from floor to crown, from hand to hand, from the floor to the arms. The split of a sum
at a joint inside a straight limb (elbow, knee, neck, hip) is left to proportions. Both are Gaussian here, so each sum
is one linear update. Directions of limbs and their voxels are taken from the body that was fitted to the T-pose.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from .body_sizes import (
    ANKLE,
    CALF,
    FOREARM,
    HEAD_,
    HIP,
    MEAN_OVER_STATURE,
    RISE,
    SHOULDER,
    THIGH,
    TORSO_,
    UPPER_ARM,
    BodyEstimate,
)

# Over the stature: thresholds measured by python bench/people.py --first-pose (rms against claimed standard deviation).
SHOWN_SD = 0.009  # standard deviation of a measured sum
ARMS_FROM, INNER_TO = 0.20, 0.32  # distances from the spine: beyond the first only arms are left, the second: elbow
NEAR_LINE = 0.05  # ahead of the arm's line, or behind
LEGS, ARMPIT, TRUNK_TO = (0.10, 0.40), (-0.105, -0.065), 0.16  # heights of legs, of the chest from the arms'; its side
SHOULDER_BEYOND_CHEST = 0.015  # shoulder joints lie outside the trunk's sides at the armpits
FINGERS_LOST_M = 0.015  # fingers are thinner than a voxel: a hull's arms end before the tips
FEWEST_VOXELS = 8  # of a part: a sum with fewer, behind a desk or in a torn hull, is not observed
ARMS = ((1.0, 3, 11), (-1.0, 4, 12))  # left or right, and points: shoulder and hand


def with_t_pose(estimate: BodyEstimate, points_world: np.ndarray, voxels: np.ndarray, pitch: float) -> BodyEstimate:
    """Return the sizes, given the points (15, 3) of a body that was fitted to a T-pose, and the hull's voxels (m, 3) of
    an edge ``pitch``; world, metres, from the floor up."""
    x, y = (points_world[3] - points_world[4])[:2]
    axes = np.array([[y, x, 0.0], [-x, y, 0.0], [0.0, 0.0, np.hypot(x, y)]]) / np.hypot(x, y)  # ahead, left, up
    neck = points_world[2] * [1.0, 1.0, 0.0]
    points, local = ((part - neck) @ axes for part in (points_world, voxels))
    sd = SHOWN_SD * estimate.stature
    for sizes, value in _sums(points, local, estimate.stature, pitch):
        row = np.zeros(len(estimate.sizes))
        row[list(sizes)] = list(sizes.values())
        estimate = estimate.updated(row, value, sd)
    return estimate


def _sums(points: np.ndarray, local: np.ndarray, H: float, pitch: float) -> Iterator[tuple[dict[int, float], float]]:
    """Yield the sums of sizes that the hull shows, with each size's factor, and their values, metres; of limbs the mean
    of the visible sides."""
    shoulder, hip_height, ahead, across, up = MEAN_OVER_STATURE[SHOULDER] * H, points[5:7, 2].mean(), *local.T
    reaches, heights, aparts, uprights, stretches = [], [], [], [], []
    for side, *ends in ARMS:
        root, hand = points[ends] * [1.0, side, 1.0]
        dx, dy, dz = hand - root
        out = side * across - ARMS_FROM * H
        on_line = np.abs(ahead - root[0] - (side * across - root[1]) * dx / dy) < NEAR_LINE * H
        arm = (out > 0.0) & on_line & (up > LEGS[1] * H)
        inner = arm & (side * across < INNER_TO * H)
        if np.count_nonzero(inner) >= FEWEST_VOXELS:
            stretches.append(np.linalg.norm(hand - root) / dy)
            reaches.append(np.percentile(side * across[arm], 99.5) + pitch / 2)
            at_shoulder = up[inner] - (side * across[inner] - shoulder) * dz / dy
            heights.append(0.5 * (np.percentile(at_shoulder, 2) + np.percentile(at_shoulder, 98)))
        leg = (side * across > 0.0) & (up > LEGS[0] * H) & (up < LEGS[1] * H)
        if np.count_nonzero(leg) >= FEWEST_VOXELS:
            slope, offset = np.polyfit(up[leg], side * across[leg], 1)
            aparts.append(offset + slope * hip_height)
            uprights.append(1.0 / np.hypot(1.0, slope))
    if not (heights and aparts):  # too little is seen of arms or legs: proportions alone
        return
    stretch, upright, height = (float(np.mean(values)) for values in (stretches, uprights, heights))
    yield {HEAD_: 1.0, TORSO_: 1.0, THIGH: upright, CALF: upright, ANKLE: 1.0}, H
    yield {UPPER_ARM: 1.0, FOREARM: 1.0, SHOULDER: stretch}, stretch * float(np.mean(reaches)) + FINGERS_LOST_M
    yield {RISE: 1.0, THIGH: upright, CALF: upright, ANKLE: 1.0}, height
    yield {HIP: 1.0}, float(np.mean(aparts))
    chest = across[(up > height + ARMPIT[0] * H) & (up < height + ARMPIT[1] * H) & (np.abs(across) < TRUNK_TO * H)]
    if len(chest) >= FEWEST_VOXELS:
        yield {SHOULDER: 1.0}, 0.5 * (np.ptp(np.percentile(chest, [2, 98])) + pitch / 2) + SHOULDER_BEYOND_CHEST * H
