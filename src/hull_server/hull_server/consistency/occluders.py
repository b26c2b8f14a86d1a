"""Learns static occluders: where a camera never shows foreground although the others see a body.

A desk or a pillar is a part of the empty room, so that its camera takes a person behind it for background, and cuts
them from the hull for all. The other cameras' silhouettes are not explained without the volume that this one vetoes.
Vetoes by errors on clothes move with the person; an occluder stays (Guan, Franco and Pollefeys, "3D occlusion inference
from silhouette cues", CVPR 2007). Behind it the camera's pixels count as unseen.
"""

from __future__ import annotations

import cv2
import numpy as np
import numpy.typing as npt

from capture_rig.kernel import kernel
from capture_rig.mask_levels import BACKGROUND, FOREGROUND, UNCERTAIN

from ..views import Masks, RigViews
from .silhouette_residuals import ResidualEstimator, Residuals

# Thresholds: judgement; measured by python bench/rooms.py --holes.
LEARNED_S = 1.5  # an occluder's cell has hidden a body this long while the camera showed it in other cells
TIMES_SHOWN = 4.0  # ... and this many times as long as it has shown foreground
MOST_S = TIMES_SHOWN * LEARNED_S  # bound of the times, so that a thing that was taken away is forgotten as soon
LEAST_CELLS = np.ones((5, 5), np.uint8)  # 0.1 m: along outlines, single voxels of the coarse grid are denied
LEAST_EXPLAINED = 0.5  # share of a camera's foreground inside the others' hull: less if it was moved or sees nobody


class OccluderMap:
    """What stands before each camera of a rig, in the cells of a :class:`ResidualEstimator`. One thread at a time."""

    def __init__(self, views: RigViews, estimator: ResidualEstimator) -> None:
        self._views, self._estimator = views, estimator
        self._hiding_s, self._showing_s = (np.zeros(estimator.cells.shape, np.float32) for _ in range(2))
        self._hiding = np.zeros(estimator.cells.shape[1:], np.uint8)  # scratch memory
        # of the cameras that anything hides from: cells (H, W), nonzero where hidden; the levels (h, w) of its pixels
        self._hidden: dict[str, tuple[npt.NDArray[np.uint8], npt.NDArray[np.uint8]]] = {}

    def learn(self, residuals: Residuals, step_s: float) -> None:
        """Learn from the residuals of the estimator's last frame set."""
        for slot, camera in enumerate(residuals.cameras):
            if residuals.explained_share[slot] < LEAST_EXPLAINED:
                continue
            denied, cells = self._estimator.denied_cells(residuals, slot), self._estimator.cells[camera]
            times = self._hiding_s[camera], self._showing_s[camera]
            name = self._views.names[camera]
            known = self._hidden.pop(name, None)
            if _learn(np.float32(step_s), denied, cells, *times, self._hiding):
                found = np.asarray(cv2.morphologyEx(self._hiding, cv2.MORPH_OPEN, LEAST_CELLS), np.uint8)
                if known is not None and np.array_equal(known[0], found):
                    self._hidden[name] = known
                elif found.any():
                    self._hidden[name] = found, self._levels(camera, found)

    def applied(self, masks: Masks) -> dict[str, npt.NDArray[np.uint8]]:
        """Return the masks (h, w) of one instant, uncertain where an occluder hides the background."""
        hidden = {name: levels for name, (_, levels) in self._hidden.items() if name in masks}
        # all but background is UNCERTAIN or higher
        return dict(masks) | {name: np.maximum(masks[name], levels) for name, levels in hidden.items()}

    def _levels(self, camera: int, cells: npt.NDArray[np.uint8]) -> npt.NDArray[np.uint8]:
        """Return UNCERTAIN for the pixels (h, w) of a camera's canvas that lie in cells, and see; else BACKGROUND."""
        (width, height), stride = self._views.sizes[camera], self._estimator.stride
        levels = np.zeros((height, width), np.uint8)
        part = cv2.resize(cells, None, fx=stride, fy=stride, interpolation=cv2.INTER_NEAREST)[:height, :width]
        levels[: part.shape[0], : part.shape[1]] = UNCERTAIN * part
        levels[self._views.seen[camera, :height, :width] == 0] = BACKGROUND
        return levels


@kernel
def _learn(step_s, denied, cells, hiding_s, showing_s, hiding):  # type: ignore[no-untyped-def]
    """Add a step to the times (H, W) of the cells that hide, and that show, up to MOST_S; write 1 to ``hiding`` for an
    occluder's cells. Returns whether there are any."""
    any_ = False
    for row in range(cells.shape[0]):
        for column in range(cells.shape[1]):
            shows = np.float32(cells[row, column] == FOREGROUND)
            hides = min(hiding_s[row, column] + step_s * np.float32(denied[row, column]), np.float32(MOST_S))
            shown = min(showing_s[row, column] + step_s * shows, np.float32(MOST_S))
            hiding_s[row, column], showing_s[row, column] = hides, shown
            hiding[row, column] = (hides >= np.float32(LEARNED_S)) & (hides > np.float32(TIMES_SHOWN) * shown)
            any_ |= hiding[row, column] != 0
    return any_
