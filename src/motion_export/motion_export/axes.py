"""Axes of other programs, from ours of REP-103 (x forward, y left, z up)."""

from __future__ import annotations

import numpy as np

Array = np.ndarray

R_ANIMATION_WORLD = np.array([[0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [1.0, 0.0, 0.0]])
"""Animation programs (BVH, glTF): y up, a figure in its rest pose looks along +z, its left is +x."""
R_BIOMECHANICS_WORLD = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]])
"""Biomechanics (OpenSim; Wu & Cavanagh, J. Biomech. 28, 1995): x forward, y up, z right."""


def rotated(R: Array, R_to_from: Array) -> Array:
    """Return rotations (..., 3, 3) expressed in other axes."""
    return R_to_from @ R @ R_to_from.T
