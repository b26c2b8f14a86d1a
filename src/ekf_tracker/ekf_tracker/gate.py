"""Leaving out points that contradict the prediction, without ever shutting the truth out."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit

from .measurement import POINTS


class Verdict(NamedTuple):
    """accepted, rejected, readmitted (15,) bool, a readmitted point is one of the accepted; how many of each."""

    accepted: np.ndarray
    rejected: np.ndarray
    readmitted: np.ndarray
    used: int
    left_out: int
    returned: int


class InnovationGate:
    """Chi-square gate with a memory.

    A point beyond the threshold is left out; one that has been left out for more than ``patience`` sets in a row is
    readmitted: by then it is the prediction that is wrong. Sets in which the point is not visible do not count.
    """

    def __init__(self, threshold: float, patience: int) -> None:
        self._threshold, self._patience = threshold, patience
        self.rejected_in_a_row = np.zeros(POINTS, dtype=np.int64)

    def judge(self, distances: np.ndarray, visible: np.ndarray) -> Verdict:
        """Squared Mahalanobis distances (15,) of the visible points (15,) against the threshold."""
        return Verdict(*_judge(distances, visible, self._threshold, self._patience, self.rejected_in_a_row))


@njit(cache=True)
def _judge(distances, visible, threshold, patience, rejected_in_a_row):
    accepted, rejected, readmitted = np.zeros(15, np.bool_), np.zeros(15, np.bool_), np.zeros(15, np.bool_)
    for point in range(15):
        if not visible[point]:
            continue
        outlying = distances[point] > threshold
        rejected_in_a_row[point] = rejected_in_a_row[point] + 1 if outlying else 0
        if rejected_in_a_row[point] > patience:
            readmitted[point] = True
            rejected_in_a_row[point] = 0
        rejected[point] = outlying and not readmitted[point]
        accepted[point] = not rejected[point]
    return accepted, rejected, readmitted, accepted.sum(), rejected.sum(), readmitted.sum()
