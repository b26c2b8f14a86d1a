"""Did the board move between two images of a video?"""

from __future__ import annotations

import cv2
import numpy as np

from .parameters import Array

WINDOW_PX, LEVELS = 15, 3
TRACKED_SHARE = 0.5


def motion_px(image: np.ndarray, neighbour: np.ndarray, pixels: Array) -> float:
    """Median distance that the corners ``pixels`` (n, 2) of ``image`` travel to the ``neighbour``, px.

    By optical flow (Lucas & Kanade 1981, pyramids); infinite when half of the corners cannot be found again.
    """
    images = [frame if frame.ndim == 2 else cv2.cvtColor(frame, cv2.COLOR_BGR2GRAY) for frame in (image, neighbour)]
    if images[0].shape != images[1].shape:
        return float("inf")
    corners = pixels.astype(np.float32).reshape(-1, 1, 2)
    first, second = images
    moved, found, _ = cv2.calcOpticalFlowPyrLK(
        first, second, corners, np.empty(0, np.float32), winSize=(WINDOW_PX, WINDOW_PX), maxLevel=LEVELS
    )
    seen = np.ravel(found) == 1
    if moved is None or seen.mean() < TRACKED_SHARE:
        return float("inf")
    return float(np.median(np.hypot(*(moved - corners).reshape(-1, 2)[seen].T)))
