"""Writes into a silhouette how dark everything is that may be floor in shadow: several cameras can tell, one cannot."""

from __future__ import annotations

import cv2
import numpy as np

from capture_rig.camera import CameraModel
from capture_rig.mask_levels import (
    ATTENUATED_LEVELS,
    FLOOR_REACH_M,
    FOREGROUND,
    SHADOW_CANDIDATE,
    attenuation_step,
    candidate_level,
)
from capture_rig.rig import Volume

from ..frame_source import Mask
from .masks import Box
from .shadows import Scene, enlarged, floor_pixels, halve

RATIO_SCALE = 200.0  # grey levels that stand for an unchanged brightness: steps of half a percent
ALIGNMENT_PX = 2


class AttenuationMarker:
    """Writes into a silhouette how dark everything is that may be floor in shadow (``capture_rig.mask_levels``).

    A single camera cannot tell a dark sock from the shadow beside it. Several can: shadow lies on the floor, where all
    cameras see the same place equally dark. So every shadow candidate, and every pixel of the person whose ray meets
    the floor, says how bright it is, as a share of what the background was, in few steps. Brightness is the mean
    of 2 x 2 pixels and of the channels: wider windows would mix legs with the shadow beside them.
    """

    def __init__(self, camera: CameraModel, volume: Volume | None = None) -> None:
        """``volume``: the capture volume; pixels whose ray meets the floor far from it stay the person."""
        self._floor = floor_pixels(camera, volume, FLOOR_REACH_M)
        steps = [attenuation_step(ratio / RATIO_SCALE) for ratio in range(256)]
        self._attenuated = np.array([FOREGROUND if s is None else ATTENUATED_LEVELS[s] for s in steps], np.uint8)
        self._candidate = np.array([SHADOW_CANDIDATE if s is None else candidate_level(s) for s in steps], np.uint8)

    def mark(self, scene: Scene, person: Mask, candidates: Mask) -> Mask:
        """Return the levels (h, w) of ``person`` and ``candidates``, both 0 or 255; what is both is the person."""
        ambiguous = cv2.bitwise_and(person, self._floor[scene.at])
        levels = person.copy()
        inner = Box.around(cv2.bitwise_or(ambiguous, candidates))
        if inner.empty:
            return levels
        inner = inner.grown(2 * ALIGNMENT_PX, person.shape, ALIGNMENT_PX)
        part = inner.slices
        ratio, shape = _brightness(scene.grey.part(inner)), levels[part].shape
        cv2.copyTo(enlarged(cv2.LUT(ratio, self._candidate), 2, shape), candidates[part], levels[part])
        levels = cv2.max(levels, person)
        cv2.copyTo(enlarged(cv2.LUT(ratio, self._attenuated), 2, shape), ambiguous[part], levels[part])
        return levels


def _brightness(grey: Scene) -> np.ndarray:
    """Return the brightness of halved pixels (uint8): RATIO_SCALE times what it is when the room is empty."""
    background = np.maximum(halve(grey.expected), np.float32(1.0))
    return cv2.convertScaleAbs(cv2.divide(halve(grey.image).astype(np.float32), background, scale=RATIO_SCALE))
