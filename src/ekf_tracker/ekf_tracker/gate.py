"""Leaving out points that contradict the prediction, without ever shutting the truth out."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from .measurement import POINTS


@dataclass(frozen=True, eq=False)
class Verdict:
    """accepted, rejected, readmitted (15,) bool; a readmitted point is one of the accepted."""

    accepted: np.ndarray
    rejected: np.ndarray
    readmitted: np.ndarray


class InnovationGate:
    """Chi-square gate with a memory.

    A point beyond the threshold is left out; one that has been left out for more than ``patience`` sets in a row is
    readmitted: by then it is the prediction that is wrong. Sets in which the point is not visible do not count.
    """

    def __init__(self, threshold: float, patience: int) -> None:
        self._threshold, self._patience = threshold, patience
        self.rejected_in_a_row = np.zeros(POINTS, dtype=int)

    def judge(self, distances: np.ndarray, visible: np.ndarray) -> Verdict:
        """Squared Mahalanobis distances (15,) of the visible points (15,) against the threshold."""
        outlying = visible & (distances > self._threshold)
        self.rejected_in_a_row[visible & ~outlying] = 0
        self.rejected_in_a_row[outlying] += 1
        readmitted = self.rejected_in_a_row > self._patience
        self.rejected_in_a_row[readmitted] = 0
        return Verdict(visible & (~outlying | readmitted), outlying & ~readmitted, readmitted)
