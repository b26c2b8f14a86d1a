"""Whether doubt is right: parts of the body that are wrong and called so, right frames in which a part is called."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mocap_packets.fit import GOOD, PART_NAMES, PART_POINTS
from stick_figure.metrics import LARGE_ERROR_M

CLEAR_M = 0.1
"""A frame is clear when all 15 points are nearer to the truth."""


@dataclass(frozen=True, eq=False)
class PartCalls:
    """What a track says of the parts of the body (``PART_NAMES``), frame by frame; an untracked frame says nothing.

    wrong : (F, 5) bool, a point of the part is more than 200 mm off. called : (F, 5) bool, its published state is
    doubtful or lost. clear : (F,) bool, frames with all points known and less than 100 mm off.
    """

    wrong: np.ndarray
    called: np.ndarray
    clear: np.ndarray

    @classmethod
    def of(cls, errors_mm: np.ndarray, parts: np.ndarray) -> PartCalls:
        """Compare errors (F, 15), NaN where unknown, with the states (F, 5) of the parts, empty where unknown."""
        told = (parts.reshape(-1, len(PART_NAMES)) != "").all(axis=1)
        far = errors_mm > 1e3 * LARGE_ERROR_M
        wrong = np.stack([far[:, list(points)].any(axis=1) for points in PART_POINTS], axis=1)
        clear = (errors_mm < 1e3 * CLEAR_M).all(axis=1)
        return cls(wrong & told[:, None], (parts != GOOD) & told[:, None], clear & told)

    @property
    def flagged_of_bad(self) -> float:
        """Share of the wrong parts that are called; NaN without any."""
        return share(self.called[self.wrong])

    @property
    def false_alarms(self) -> float:
        """Share of the clear frames in which any part is called; NaN without any."""
        return share(self.called[self.clear].any(axis=1))


def share(chosen: np.ndarray) -> float:
    """Return the share of the true ones; NaN of nothing."""
    return float(chosen.mean()) if chosen.size else float("nan")
