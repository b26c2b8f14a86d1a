"""A straight line through points of which some are phantoms."""

from __future__ import annotations

import numpy as np


def line_through(x: np.ndarray, y: np.ndarray) -> tuple[float, float, float]:
    """Slope and offset of a line through points, and their median distance from it along y.

    Medians over all pairs and points (Theil 1950, Sen 1968): a third of the points may be phantoms.
    """
    first, second = np.triu_indices(len(x), 1)
    slope = np.median((y[second] - y[first]) / (x[second] - x[first]))
    offset = np.median(y - slope * x)
    return float(slope), float(offset), float(np.median(np.abs(y - offset - slope * x)))
