"""Where the person's outline runs: at half contrast, not where the background ends."""

from __future__ import annotations

import cv2
import numpy as np

from .frame_source import Image, Mask

_CROSS = np.array([[0, 1, 0], [1, 1, 1], [0, 1, 0]], np.uint8)


def trim_rim(person: Mask, image: Image, mean: Image, least_share: float) -> Mask:
    """``person`` (h, w) without pixels of its rim that are mostly background.

    A pixel on the edge is a blend, and lens, codec and noise filter spread it over its neighbours; a background test
    that notices a few grey levels calls all of it foreground, and everybody gets a pixel wider all around. So a pixel
    that touches the background stays only if it differs from it by ``least_share`` of the largest difference around.
    ``image`` and ``mean`` (h, w[, 3]) uint8: the same part of the frame, and of the background.
    """
    difference = cv2.absdiff(image, mean)
    if difference.ndim == 3:
        blue, green, red = cv2.split(difference)
        difference = cv2.max(cv2.max(blue, green), red)
    difference = cv2.bitwise_and(difference, person)
    inside = cv2.erode(person, _CROSS, borderType=cv2.BORDER_CONSTANT, borderValue=255)
    wanted = cv2.convertScaleAbs(cv2.dilate(difference, _CROSS), alpha=least_share)
    return cv2.bitwise_or(inside, cv2.bitwise_and(person, cv2.compare(difference, wanted, cv2.CMP_GE)))
