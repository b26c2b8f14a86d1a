"""Writes into a silhouette how dark everything is that may be floor in shadow: several cameras can tell, one cannot."""

from __future__ import annotations

import numpy as np

from capture_rig.camera import CameraModel
from capture_rig.kernel import njit
from capture_rig.mask_levels import (
    ATTENUATED_LEVELS,
    FLOOR_REACH_M,
    FOREGROUND,
    SHADOW_CANDIDATE,
    attenuation_step,
    candidate_level,
)
from capture_rig.rig import Volume

from ..background.kernels import OPTIONS
from ..frame_source import Mask
from .evidence import Scene
from .shadows import floor_pixels

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
        grey, levels = scene.grey, person.copy()
        mark_attenuation(grey.image, grey.expected, person, candidates, self._floor[scene.at], self._levels, levels)
        return levels


@njit(**OPTIONS, crops=True)
def mark_attenuation(image, expected, person, candidates, floor, levels, out):  # type: ignore[no-untyped-def]
    """Write levels into ``out`` (h, w) at candidates and where the person may be floor, by 2 x 2 pixels' brightness.

    image (h, w) uint8, expected (h, w) float32, the part's first row and column being even; person, candidates, floor
    (h, w) uint8 : not 0. levels (2, 256) : of the person and of candidates, RATIO_SCALE times as bright as expected.
    """
    height, width = person.shape
    wanted = np.empty(width, np.uint8)
    for y in range(0, height, ALIGNMENT_PX):
        z = min(y + 1, height - 1)
        above, below = candidates[y], candidates[z]
        for x in range(width):
            wanted[x] = above[x] | below[x] | (person[y, x] & floor[y, x]) | (person[z, x] & floor[z, x])
        for x in range(0, width, ALIGNMENT_PX):
            w = min(x + 1, width - 1)
            if wanted[x] | wanted[w] == 0:
                continue
            seen = np.float32(image[y, x]) + np.float32(image[y, w]) + np.float32(image[z, x]) + np.float32(image[z, w])
            there = max(expected[y, x] + expected[y, w] + expected[z, x] + expected[z, w], np.float32(4))
            ratio = int(min(np.float32(RATIO_SCALE) * seen / there + np.float32(0.5), np.float32(255)))
            for v, u in ((y, x), (y, w), (z, x), (z, w)):
                if person[v, u]:
                    out[v, u] = levels[0, ratio] if floor[v, u] else FOREGROUND
                elif candidates[v, u]:
                    out[v, u] = levels[1, ratio]
