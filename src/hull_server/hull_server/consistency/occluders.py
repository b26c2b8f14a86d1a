"""Learns what stands between a camera and the people: where it never shows foreground although the others see a body.

A desk or a pillar is a part of the empty room, so that its camera calls a person behind it background, and cuts them
from the hull for all. The other cameras give it away: their silhouettes are not explained without the volume that this
one denies. What it denies by being wrong about clothes moves with the person; an occluder stays (Guan, Franco and
Pollefeys, "3D occlusion inference from silhouette cues", CVPR 2007). Behind it the camera has no say.
"""

from __future__ import annotations

from typing import NamedTuple

import cv2
import numpy as np
import numpy.typing as npt

from capture_rig.kernel import kernel
from capture_rig.mask_levels import BACKGROUND, FOREGROUND, UNCERTAIN

from ..views import Masks, RigViews
from .silhouette_residuals import ResidualEstimator, Residuals

# Thresholds: judgement; measured by python bench/rooms.py --holes.
LEARNED_S = 1.5  # a cell that hides a body for so long, while the camera shows others of its cells, is an occluder's
TIMES_SHOWN = 4.0  # ... and for so many times as long as it has shown anything
MOST_S = 10.0  # what was learned is forgotten in a quarter of this when the thing is taken away
LEAST_CELLS = np.ones((5, 5), np.uint8)  # 0.1 m: along outlines, single voxels of the coarse grid are denied
LEAST_EXPLAINED = 0.5  # of a camera's foreground: less fits the others' hull where a camera was moved, or sees nobody


class Hidden(NamedTuple):
    """What an occluder hides from a camera: cells (H, W), nonzero where hidden, and the levels (h, w) of its pixels."""

    cells: npt.NDArray[np.uint8]
    levels: npt.NDArray[np.uint8]


class OccluderMap:
    """What stands before each camera of a rig, in the cells of a :class:`ResidualEstimator`. One thread at a time."""

    def __init__(self, views: RigViews, estimator: ResidualEstimator) -> None:
        self._views, self._estimator = views, estimator
        self._hiding_s, self._showing_s = (np.zeros(estimator.cells.shape, np.float32) for _ in range(2))
        self._hidden: dict[int, Hidden] = {}  # of the cameras that anything hides from

    def learn(self, residuals: Residuals, step_s: float) -> None:
        """Learn from the residuals of the estimator's last frame set."""
        explained = residuals.explained_share
        for slot, camera in enumerate(residuals.cameras):
            if explained[slot] < LEAST_EXPLAINED:
                continue
            hiding, showing = self._hiding_s[camera], self._showing_s[camera]
            denied = self._estimator.denied_cells(residuals, slot)
            _add_time(np.float32(step_s), denied, hiding)
            _add_time(np.float32(step_s), self._estimator.cells[camera] == FOREGROUND, showing)
            if not denied.any() and camera not in self._hidden:
                continue
            cells = ((hiding >= LEARNED_S) & (hiding > TIMES_SHOWN * showing)).view(np.uint8)
            cells = np.asarray(cv2.morphologyEx(cells, cv2.MORPH_OPEN, LEAST_CELLS), np.uint8)
            known = self._hidden.pop(camera, None)
            if known is not None and np.array_equal(known.cells, cells):
                self._hidden[camera] = known
            elif cells.any():
                self._hidden[camera] = Hidden(cells, self._levels(camera, cells))

    def applied(self, masks: Masks) -> dict[str, npt.NDArray[np.uint8]]:
        """Return the masks (h, w) of one instant, uncertain where an occluder hides the background."""
        found = dict(masks)
        for camera, hidden in self._hidden.items():
            name = self._views.names[camera]
            if name in found:
                found[name] = np.maximum(found[name], hidden.levels)  # all but background is UNCERTAIN or higher
        return found

    def _levels(self, camera: int, cells: npt.NDArray[np.uint8]) -> npt.NDArray[np.uint8]:
        """Return UNCERTAIN for the pixels (h, w) of a camera's canvas that lie in cells, and see; else BACKGROUND."""
        (width, height), stride = self._views.sizes[camera], self._estimator.stride
        levels = np.zeros((height, width), np.uint8)
        part = cv2.resize(cells, None, fx=stride, fy=stride, interpolation=cv2.INTER_NEAREST)[:height, :width]
        levels[: part.shape[0], : part.shape[1]] = UNCERTAIN * part
        levels[self._views.seen[camera, :height, :width] == 0] = BACKGROUND
        return levels


@kernel
def _add_time(step_s, where, time_s):  # type: ignore[no-untyped-def]
    """Add a step to the times (H, W) of the cells that are positive in ``where``, up to MOST_S."""
    for row in range(time_s.shape[0]):
        times, cells = time_s[row], where[row]
        for column in range(times.size):
            times[column] = min(times[column] + step_s * np.float32(cells[column] > 0), np.float32(MOST_S))
