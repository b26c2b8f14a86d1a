"""Learns what stands between a camera and the people: where it never shows foreground although the others see a body.

A desk or a pillar is a part of the empty room, so that its camera calls a person behind it background, and cuts them
from the hull for all. The other cameras give it away: their silhouettes are not explained without the volume that this
one denies. What it denies by being wrong about clothes moves with the person; an occluder stays (Guan, Franco and
Pollefeys, "3D occlusion inference from silhouette cues", CVPR 2007). Behind it the camera has no say.
"""

from __future__ import annotations

import cv2
import numpy as np
import numpy.typing as npt

from capture_rig.mask_levels import BACKGROUND, UNCERTAIN

from ..views import Masks, RigViews
from .silhouette_residuals import ResidualEstimator, Residuals

# Thresholds: judgement; measured by python bench/rooms.py --holes.
LEARNED_S = 1.5  # a cell that hides a body for so long, while the camera shows others of its cells, is an occluder's
TIMES_SHOWN = 4.0  # ... and for so many times as long as it has shown anything
MOST_S = 10.0  # what was learned is forgotten in a quarter of this when the thing is taken away
LEAST_CELLS = np.ones((5, 5), np.uint8)  # 0.1 m: along outlines, single voxels of the coarse grid are denied
LEAST_EXPLAINED = 0.5  # of a camera's foreground: less fits the others' hull where a camera was moved, or sees nobody


class OccluderMap:
    """What stands before each camera of a rig, in the cells of a :class:`ResidualEstimator`. One thread at a time."""

    def __init__(self, views: RigViews, estimator: ResidualEstimator) -> None:
        self._views, self._estimator = views, estimator
        self._hiding_s, self._showing_s = (np.zeros(estimator.labels.shape, np.float32) for _ in range(2))
        self._hidden: dict[int, npt.NDArray[np.bool_]] = {}  # pixels (h, w) of the cameras that have any

    def learn(self, residuals: Residuals, step_s: float) -> None:
        """Learn from the residuals of the estimator's last frame set."""
        explained = residuals.explained_share
        for slot, camera in enumerate(residuals.cameras):
            if explained[slot] < LEAST_EXPLAINED:
                continue
            hiding, showing = self._hiding_s[camera], self._showing_s[camera]
            showing += np.float32(step_s) * (self._estimator.labels[camera] > 0)
            denied = self._estimator.denied_cells(residuals, slot)
            if not denied.any() and camera not in self._hidden:
                continue
            hiding += np.float32(step_s) * denied
            np.minimum(hiding, MOST_S, out=hiding)
            np.minimum(showing, MOST_S, out=showing)
            cells = (hiding >= LEARNED_S) & (hiding > TIMES_SHOWN * showing)
            self._hidden.pop(camera, None)
            cells = cv2.morphologyEx(cells.view(np.uint8), cv2.MORPH_OPEN, LEAST_CELLS) > 0
            if cells.any():
                self._hidden[camera] = self._pixels(camera, cells)

    def applied(self, masks: Masks) -> dict[str, npt.NDArray[np.uint8]]:
        """Return the masks (h, w) of one instant, uncertain where an occluder hides the background."""
        found = dict(masks)
        for camera, hidden in self._hidden.items():
            name = self._views.names[camera]
            if name in found:
                mask = found[name].copy()
                mask[hidden & (mask == BACKGROUND)] = UNCERTAIN
                found[name] = mask
        return found

    def _pixels(self, camera: int, cells: npt.NDArray[np.bool_]) -> npt.NDArray[np.bool_]:
        """Return the pixels (h, w) of a camera's canvas that lie in cells, and see."""
        (width, height), stride = self._views.sizes[camera], self._estimator.stride
        full = cv2.resize(cells.view(np.uint8), None, fx=stride, fy=stride, interpolation=cv2.INTER_NEAREST)
        pixels = np.zeros((height, width), np.uint8)
        part = full[:height, :width]
        pixels[: part.shape[0], : part.shape[1]] = part
        return (pixels > 0) & (self._views.seen[camera, :height, :width] > 0)
