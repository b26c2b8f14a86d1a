"""Doubts about a pose as covariance of its points, so that whoever filters them is not misled."""

from __future__ import annotations

import numpy as np

from .evidence import PART_POINTS
from .quality import GOOD, TrackQuality

OUTSIDE_SD_M = 0.15  # a limb that leaves the hull may be anywhere about its place
EVEN_RAYS = 3.0  # lead at which the other pose is believed about three times as much


def with_doubts(
    covariance: np.ndarray, quality: TrackQuality, points_world: np.ndarray, rival_points_world: np.ndarray | None
) -> np.ndarray:
    """The covariance (15, 3, 3) m^2 of points (15, 3) with what is doubtful about them.

    With a rival pose that is a reason for doubt, a point is in one of two places: covariance
    p (1 - p) d d^T, d the way to the other one, p the belief in it. Without one, points of a doubtful part are
    uncertain by OUTSIDE_SD_M.
    """
    widened = covariance.copy()
    for points, state in zip(PART_POINTS, quality.parts, strict=True):
        if state != GOOD and rival_points_world is None:
            widened[list(points)] += OUTSIDE_SD_M**2 * np.eye(3)
    if rival_points_world is not None and quality.rival_lead is not None and quality.state != GOOD:
        p = 1.0 / (1.0 + np.exp(-quality.rival_lead / EVEN_RAYS))
        d = rival_points_world - points_world
        widened += p * (1.0 - p) * d[:, :, None] * d[:, None, :]
    return widened
