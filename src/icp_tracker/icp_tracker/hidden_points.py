"""Covariance of reference points that the rig does not show: as wide as the lengths that lead to them are uncertain.

A foot outside the pictures is where the seen part of the leg points, at the end of a calf whose length was perhaps
never seen. The fit's own covariance knows the pose's part of this; the lengths' part is added here, along each stick
from the last joint that is seen.
"""

from __future__ import annotations

import numpy as np

from capture_rig.sight import Sight

from .acquisition.body_sizes import CALF, FOREARM, HEAD_, THIGH, UPPER_ARM

CHAINS: tuple[tuple[tuple[int, ...], tuple[int, ...]], ...] = (
    ((2, 1), (HEAD_,)),
    ((3, 7, 11), (UPPER_ARM, FOREARM)),
    ((4, 8, 12), (UPPER_ARM, FOREARM)),
    ((5, 9, 13), (THIGH, CALF)),
    ((6, 10, 14), (THIGH, CALF)),
)
"""Reference points from the trunk outwards, and the sizes of the sticks between them."""
DIRECTION_SD = 0.5  # rad, of a stick of which nothing is seen: about a joint's free range to either side


def widen_hidden(
    covariance: np.ndarray,
    points_world: np.ndarray,
    supported: np.ndarray,
    sizes_covariance: np.ndarray | None,
    sight: Sight | None,
) -> np.ndarray:
    """Return the covariance (15, 3, 3) m^2 of points (15, 3) m, larger where the rig does not show them.

    supported (15,) bool : points whose sticks data bear on; of the others the direction is not known either.
    sizes_covariance (10, 10) : of the body's sizes, m^2, in their order; None for a body whose sizes were given.
    """
    hidden = None if sight is None else sight.unseen_cells.at(points_world)
    if hidden is None or not hidden.any():
        return covariance
    wide = covariance.copy()
    for points, sizes in CHAINS:
        more = np.zeros((3, 3))
        for near, far, size in zip(points[:-1], points[1:], sizes, strict=True):
            if not hidden[far]:
                more[:] = 0.0
                continue
            stick = points_world[far] - points_world[near]
            length = float(np.linalg.norm(stick))
            along = stick / max(length, 1e-9)
            if sizes_covariance is not None:
                more += sizes_covariance[size, size] * np.outer(along, along)
            if not supported[far]:
                more += (DIRECTION_SD * length) ** 2 * (np.eye(3) - np.outer(along, along))
            wide[far] += more
    return wide
