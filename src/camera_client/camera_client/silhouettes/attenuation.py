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
from .evidence import Scene
from .shadows import enlarged, floor_pixels
from .texture import halve

RATIO_SCALE = 200.0  # grey levels that stand for an unchanged brightness: steps of half a percent
ALIGNMENT_PX = 2


class AttenuationMarker:
    """Writes into a silhouette how dark everything is that may be floor in shadow (``capture_rig.mask_levels``).

    A single camera cannot tell a dark sock from the shadow beside it. Several can: shadow lies on the floor, where all
    cameras see the same place equally dark. So every shadow candidate, and every pixel of the person whose ray meets
    the floor, says how bright it is, as a share of what the background was, in few steps. Brightness is the mean of
    2 x 2 pixels, of colours with BT.601's weights: wider windows would mix legs with the shadow beside them.
    """

    def __init__(self, camera: CameraModel, volume: Volume | None = None) -> None:
        """``volume``: the capture volume; pixels whose ray meets the floor far from it stay the person."""
        self._floor = floor_pixels(camera, volume, FLOOR_REACH_M)
        steps = [attenuation_step(ratio / RATIO_SCALE) for ratio in range(256)]
        attenuated = [FOREGROUND if step is None else ATTENUATED_LEVELS[step] for step in steps]
        candidate = [SHADOW_CANDIDATE if step is None else candidate_level(step) for step in steps]
        self._levels = np.array([attenuated, candidate], np.uint8)

    def mark(self, scene: Scene, person: Mask, candidates: Mask) -> Mask:
        """Return the levels (h, w) of ``person`` and ``candidates``, both 0 or 255; what is both is the person."""
        grey = scene.grey
        seen, there = halve(grey.image.astype(np.float32)), np.maximum(halve(grey.expected), 1)
        ratio = np.minimum(np.float32(RATIO_SCALE) * seen / there + np.float32(0.5), 255).astype(np.uint8)
        attenuated, candidate = (enlarged(cv2.LUT(ratio, table), 2, person.shape) for table in self._levels)
        on_floor = np.where(self._floor[scene.at] > 0, attenuated, np.uint8(FOREGROUND))
        return np.where(person > 0, on_floor, cv2.bitwise_and(candidate, candidates))
