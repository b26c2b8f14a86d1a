"""What the person with the board wants to see: the corners that were found, and what is covered so far."""

from __future__ import annotations

import cv2
import numpy as np

from rig_calibration.intrinsics.coverage import Coverage
from rig_calibration.intrinsics.watching import Seen

TAKEN, FOUND, COVERED = (60, 220, 60), (40, 160, 255), (90, 160, 60)  # BGR
DEPTH = 0.25  # how strongly covered cells are tinted
TEXT_HEIGHT_SHARE = 0.035


def draw_preview(image: np.ndarray, seen: Seen, coverage: Coverage, advice: str) -> np.ndarray:
    """The image (H, W[, 3]) as BGR with covered cells tinted, corners marked, and a line of advice."""
    picture = cv2.cvtColor(image, cv2.COLOR_GRAY2BGR) if image.ndim == 2 else image.copy()
    height, width = picture.shape[:2]
    cells = cv2.resize(coverage.cells.astype(np.uint8), (width, height), interpolation=cv2.INTER_NEAREST) > 0
    tint = np.array(COVERED, float) * DEPTH
    picture[cells] = (picture[cells] * (1 - DEPTH) + tint).astype(np.uint8)
    if seen.sighting is not None:
        colour, radius = TAKEN if seen.taken else FOUND, max(2, width // 200)
        for x, y in np.rint(seen.sighting.pixels).astype(int):
            cv2.circle(picture, (int(x), int(y)), radius, colour, max(1, radius // 2))
    _write(picture, advice or "enough", 1)
    _write(picture, "taken" if seen.taken else seen.reason, 2)
    return picture


def _write(picture: np.ndarray, text: str, line: int) -> None:
    """A line of text from the bottom, readable on any ground."""
    height, width = picture.shape[:2]
    scale = TEXT_HEIGHT_SHARE * height / 22
    needed = cv2.getTextSize(text, cv2.FONT_HERSHEY_SIMPLEX, scale, 1)[0][0]
    scale *= min(1.0, 0.97 * width / max(needed, 1))
    place = (int(0.01 * width), int(height - (line - 0.6) * 1.6 * TEXT_HEIGHT_SHARE * height))
    for colour, thickness in (((0, 0, 0), 4), ((255, 255, 255), 1)):
        cv2.putText(picture, text, place, cv2.FONT_HERSHEY_SIMPLEX, scale, colour, thickness, cv2.LINE_AA)
