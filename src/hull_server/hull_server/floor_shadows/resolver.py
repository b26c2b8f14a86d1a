"""Resolver of the silhouettes of one instant: corrects each camera's mask by the labels of its uncertain pixels."""

from __future__ import annotations

import numpy as np

from capture_rig import Volume
from capture_rig.kernel import njit

from ..settings import ShadowSettings
from ..silhouette_batch import Mask, SilhouetteBatch
from ..views import Box, Masks, RigViews
from .labels import STRIDE, PixelLabels, apply_labels
from .rules import label_pixels
from .scene import floor_scene

# Thresholds: chosen with shadow_resolution.py among the benches of commit d6079d2.
LEAST_CENTRE_Z_M = 0.2  # a camera lower than this sees too little floor


class ShadowResolver:
    """Resolves silhouettes of several levels into binary ones. One thread at a time: it keeps scratch memory."""

    def __init__(self, views: RigViews, volume: Volume, settings: ShadowSettings) -> None:
        self._views, self._settings = views, settings
        self._stack = SilhouetteBatch(views)
        self._scene = floor_scene(views, volume)
        self._floor_px = np.empty((len(views.names), 3))
        self._bodies = np.zeros((len(views.names), 4), np.int64)
        height, width = views.seen.shape[1:]
        self._labels = PixelLabels.zeros((0, 0, width, height))

    def resolve(self, masks: Masks, seeing: int) -> dict[str, Mask]:
        """Resolve masks of one instant, of the levels of ``capture_rig.mask_levels``, to masks of 0 and 255.

        ``seeing``: how many cameras must see a voxel. The masks that come in are not written to, and are returned where
        they are binary. InputError for a camera that is not in the rig, and for a mask of the wrong size.
        """
        self._views.present(masks)
        boxes = self._stack.take(masks)
        binary = {name: self._stack.binary(name, mask) if name in boxes else mask for name, mask in masks.items()}
        if self._settings.enabled:
            self._stack.write_body_boxes(self._bodies)
            for name, box in boxes.items():
                self._resolve(self._views.number[name], box, seeing, binary[name])
        return binary

    def boxes(self, masks: Masks) -> dict[str, Box]:
        """Return a box for each mask, of those resolved last, that holds its foreground."""
        return {name: self._stack.shown(name) for name in masks}

    def _resolve(self, camera: int, box: Box, seeing: int, binary: Mask) -> None:
        """Correct the camera's ``binary`` mask within the box."""
        min_height_m, scene = self._settings.min_height_m, self._scene
        if scene.centres[camera, 2] > max(min_height_m, LEAST_CENTRE_Z_M):
            batch = self._stack.levels, self._bodies
            _resolve(scene, batch, camera, box, (seeing, min_height_m), self._floor_px, self._labels, binary)


@njit(cache=True, nogil=True, error_model="numpy")
def _resolve(scene, batch, camera, box, limits, floor_px, scratch, mask):
    """Correct one camera's ``mask`` (h, w) of 0 and 255 in a box; limits : cameras that must see a voxel, least height.

    batch : levels of all cameras, and a box for each of what may be the person; scratch : labels for a whole canvas.
    """
    (left, top, right, bottom), (seeing, min_height), (levels, bodies) = box, limits, batch
    h, w = (bottom - top + STRIDE - 1) // STRIDE, (right - left + STRIDE - 1) // STRIDE
    foreground, shadow, candidate = scratch.foreground[:h, :w], scratch.shadow[:h, :w], scratch.candidate[:h, :w]
    body, undecided, applied = scratch.body[:h, :w], scratch.undecided[:h, :w], scratch.applied[:h, :w]
    labels = PixelLabels(foreground, shadow, candidate, body, undecided, applied)
    for label in labels:
        label[:] = 0
    label_pixels(scene, levels, bodies, camera, box, seeing, min_height, floor_px, labels)
    apply_labels(scene.kind, levels[camera], box, labels, mask)
