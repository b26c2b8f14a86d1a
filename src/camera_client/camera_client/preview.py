"""The picture to look at: what the camera sees, with the outline of what it took for the person."""

from __future__ import annotations

import cv2
import numpy as np

from capture_rig.mask_levels import FOREGROUND, SHADOW_CANDIDATE

from .frame_source import Image, Mask

PERSON_BGR, CANDIDATE_BGR = (0, 255, 0), (0, 140, 255)
LINE_PX = 2


def outline(image: Image, mask: Mask) -> Image:
    """The image (H, W[, 3]) at half size, BGR: the person's outline green, that of shadow candidates orange.

    ``mask`` (H, W) is :attr:`camera_client.silhouette.Silhouette.image_mask`, of two or three levels.
    """
    shown = cv2.cvtColor(image, cv2.COLOR_GRAY2BGR) if image.ndim == 2 else image.copy()
    for level, colour in ((SHADOW_CANDIDATE, CANDIDATE_BGR), (FOREGROUND, PERSON_BGR)):
        contours, _ = cv2.findContours(cv2.inRange(mask, level, level), cv2.RETR_LIST, cv2.CHAIN_APPROX_SIMPLE)
        cv2.drawContours(shown, contours, -1, colour, LINE_PX)
    return np.asarray(cv2.resize(shown, None, fx=0.5, fy=0.5, interpolation=cv2.INTER_AREA))
