"""Separates floor in shadow from the person, with all cameras together.

A camera sends three kinds of foreground (``capture_rig.mask_levels``): sure pixels; candidates, shadow by their
texture; and attenuated pixels, which are the person unless other cameras contradict. A cast shadow lies on the floor
z = 0, so all cameras that see a place of the floor see it equally attenuated. A leg stands above the floor: its
pixels fall on other floor places in every camera, bright or differently attenuated ones (the planar homography between
views of the floor is that of Khan and Shah, ECCV 2006, who find feet with it). So an attenuated pixel becomes a
candidate when another camera sees its floor place equally attenuated, and no more cameras contradict (bright floor,
another attenuation) than agree; cameras that see the person in front of it are not counted.

A candidate is evidence of floor in shadow, and weak evidence against a body: one camera's vetoes the voxels next to the
floor and counts as unseen higher up, where the other cameras decide; two cameras' veto a voxel at any height.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from capture_rig import Volume
from capture_rig.kernel import kernel
from capture_rig.mask_levels import (
    ATTENUATED_LEVELS,
    CANDIDATE_LEVELS,
    FLOOR_REACH_M,
    SHADOW_CANDIDATE,
    STEPS_OF_CANDIDATE,
    UNCERTAIN,
)

from .bitset import FIRST_BITS, HIGH_BITS, LOW_BITS, lowest_bit
from .carving.pixel_boxes import pixel_projections, project, project_block
from .grid import BRICK_EDGE, BrickVolume, VoxelGrid
from .silhouette_batch import BLIND, SilhouetteBatch
from .views import Box, Masks, RigViews

# Thresholds: chosen by the shadows resolved in the studio's rooms (python bench/rooms.py, "judged").
TOLERANCE = 1  # attenuation steps of a tenth by which agreeing cameras may differ
STRIDE = 3  # every third row and column is tested
FLOOR_M = 0.08  # voxels and cameras lower than this may be floor: soles, and errors of floor and calibration

UNSEEN, EMPTY, CANDIDATE, ATTENUATED, SURE = 0, 1, 2, 3, 4  # kinds of levels
ABOVE_UNCERTAIN = FIRST_BITS * np.uint64(SHADOW_CANDIDATE - UNCERTAIN)  # added to every byte: carries into its high bit

Array = npt.NDArray[np.float64]
Mask = npt.NDArray[np.uint8]


class FloorScene(NamedTuple):
    """Tables of the calibration.

    P (N, 3, 4), metres to pixels; floor (N, 3, 3): pixels to (x, y, 1) on z = 0; low, high (2,): of the floor that may
    lie in shadow, metres; kind (256,) of each level: UNSEEN, EMPTY, CANDIDATE, ATTENUATED or SURE; attenuation (256,
    2): the least and greatest attenuation step that each level may stand for.
    """

    P: Array
    floor: Array
    low: Array
    high: Array
    kind: npt.NDArray[np.int8]
    attenuation: npt.NDArray[np.int8]


def floor_scene(views: RigViews, volume: Volume) -> FloorScene:
    """Compute the tables of a rig's calibration; the floor of a camera that is too low to see it is NaN."""
    centres = [-np.linalg.solve(P[:, :3], P[:, 3]) for P in views.P]
    floor = [
        np.linalg.inv(P[:, [0, 1, 3]]) if centre[2] > FLOOR_M else np.full((3, 3), np.nan)
        for P, centre in zip(views.P, centres, strict=True)
    ]
    kind = np.full(256, SURE, np.int8)
    kind[0], kind[BLIND], kind[UNCERTAIN] = EMPTY, UNSEEN, UNSEEN
    kind[list(CANDIDATE_LEVELS)], kind[list(ATTENUATED_LEVELS)] = CANDIDATE, ATTENUATED
    attenuation = np.zeros((256, 2), np.int8)
    attenuation[list(ATTENUATED_LEVELS)] = np.arange(len(ATTENUATED_LEVELS))[:, None]
    attenuation[list(CANDIDATE_LEVELS)] = STEPS_OF_CANDIDATE
    low, high = volume.low[:2] - FLOOR_REACH_M, volume.high[:2] + FLOOR_REACH_M
    return FloorScene(np.ascontiguousarray(views.P), np.stack(floor), low, high, kind, attenuation)


class ShadowResolver:
    """Finds which attenuated pixels may be shadow, and clears shadows' voxels. Each method on one thread at a time."""

    def __init__(self, views: RigViews, volume: Volume, grid: VoxelGrid) -> None:
        self._views = views
        self._batch = SilhouetteBatch(views.seen)
        self._scene = floor_scene(views, volume)
        self._projections = pixel_projections(views, grid)
        self._layers = max(0, math.ceil((FLOOR_M - grid.origin[2]) / grid.voxel_size - 0.5))

    def resolve(self, masks: Masks) -> dict[str, Mask]:
        """Return masks of one instant, of the levels of ``capture_rig.mask_levels``, their attenuated pixels that may
        be shadow as SHADOW_CANDIDATE.

        The masks that come in are not written to.
        """
        self._views.present(masks)
        resolved = dict(masks)
        graded = [self._batch.load(camera, masks.get(name)) for camera, name in enumerate(self._views.names)]
        for camera in np.flatnonzero(graded):
            name = self._views.names[camera]
            resolved[name] = masks[name].copy()
            mark_shadows(self._scene, self._batch.levels, camera, self._batch.box[camera], resolved[name])
        return resolved

    def boxes(self, masks: Masks) -> dict[str, Box]:
        """Return a box for each mask, of those resolved last, that holds all but background."""
        boxes = zip(self._views.names, self._batch.box.tolist(), strict=True)
        return {name: (left, top, right, bottom) for name, (left, top, right, bottom) in boxes if name in masks}

    def without_shadows(self, volume: BrickVolume, masks: Masks) -> BrickVolume:
        """Return a hull without the voxels of which two cameras have a candidate, or one next to the floor."""
        index, leaves = volume.index, volume.leaves.copy()
        shape = np.array(volume.grid.brick_shape, np.int64)
        once, twice = np.zeros_like(leaves), np.zeros_like(leaves)
        for name, mask in masks.items():
            camera = self._views.number[name]
            _add_candidates(index, leaves, shape, self._projections, camera, np.ascontiguousarray(mask), once, twice)
        _clear_candidates(index, leaves, shape, self._layers, once, twice)
        filled = leaves.any(axis=1)
        return BrickVolume(volume.grid, index[filled], leaves[filled])


@kernel
def mark_shadows(scene, levels, camera, box, mask):  # type: ignore[no-untyped-def]
    """Write SHADOW_CANDIDATE to the attenuated pixels of one camera's ``mask`` (h, w) that may be floor in shadow.

    levels (N, H, W) : of all cameras. box : left, top, right, bottom of the pixels to test.
    """
    for v in range(box[1], min(box[3], mask.shape[0]), STRIDE):
        for u in range(box[0], min(box[2], mask.shape[1]), STRIDE):
            if scene.kind[levels[camera, v, u]] == ATTENUATED and _is_shadow(scene, levels, camera, u, v):
                _replace_attenuated(scene.kind, mask[v : v + STRIDE, u : u + STRIDE])


@kernel
def _replace_attenuated(kind, square):  # type: ignore[no-untyped-def]
    """Write SHADOW_CANDIDATE to the attenuated pixels of a square."""
    for j in range(square.shape[0]):
        for i in range(square.shape[1]):
            if kind[square[j, i]] == ATTENUATED:
                square[j, i] = SHADOW_CANDIDATE


@kernel
def _is_shadow(scene, levels, camera, u, v):  # type: ignore[no-untyped-def]
    """Check whether another camera sees the floor place of a camera's pixel equally attenuated, and no more contradict
    it."""
    floor, low, high, own = scene.floor[camera], scene.low, scene.high, levels[camera, v, u]
    w = floor[2, 0] * u + floor[2, 1] * v + floor[2, 2]
    x = (floor[0, 0] * u + floor[0, 1] * v + floor[0, 2]) / w
    y = (floor[1, 0] * u + floor[1, 1] * v + floor[1, 2]) / w
    if not (low[0] < x < high[0] and low[1] < y < high[1]):
        return False
    agree, contradict = 0, 0
    for other in range(levels.shape[0]):
        level = BLIND if other == camera else _level_of(levels[other], scene.P[other], x, y)
        kind = scene.kind[level]
        if kind == EMPTY:
            contradict += 1
        elif kind in (CANDIDATE, ATTENUATED):
            more = scene.attenuation[level, 0] - scene.attenuation[own, 1] > TOLERANCE
            less = scene.attenuation[own, 0] - scene.attenuation[level, 1] > TOLERANCE
            contradict += more or less
            agree += not (more or less)
    return agree > 0 and agree >= contradict


@kernel
def _level_of(levels, P, x, y):  # type: ignore[no-untyped-def]
    """Return the level (H, W) of a floor place; BLIND behind the camera P (3, 4) and outside its canvas."""
    depth = P[2, 0] * x + P[2, 1] * y + P[2, 3]
    if depth <= 0.0:
        return BLIND
    x, y = P[0, 0] * x + P[0, 1] * y + P[0, 3], P[1, 0] * x + P[1, 1] * y + P[1, 3]
    u, v = math.floor(x / depth + 0.5), math.floor(y / depth + 0.5)
    if not (0.0 <= u < levels.shape[1] and 0.0 <= v < levels.shape[0]):
        return BLIND
    return int(levels[np.uint64(v), np.uint64(u)])


@kernel
def _add_candidates(index, leaves, bricks, projections, camera, mask, once, twice):  # type: ignore[no-untyped-def]
    """Add the voxels whose pixel in one camera's mask (h, w) is a candidate to ``once``, from there to ``twice``.

    index (k,), leaves, once, twice (k, 8) : of a BrickVolume. bricks (3,) : of the grid. projections (N, 3, 4) : voxels
    to pixels.
    """
    (height, width), words, last = mask.shape, mask.view(np.uint64), BRICK_EDGE - 1
    for row in range(index.size):
        brick = np.int64(index[row])
        x0, y0 = brick % bricks[0] * BRICK_EDGE, brick // bricks[0] % bricks[1] * BRICK_EDGE
        z0 = brick // (bricks[0] * bricks[1]) * BRICK_EDGE
        high = (x0 + last, y0 + last, z0 + last)
        u0, v0, u1, v1, _ = project_block(projections[camera], (x0, y0, z0), high, (width, height))
        if not _any_candidate(words[v0:v1, u0 // 8 : (u1 + 7) // 8]):
            continue
        for layer in range(BRICK_EDGE):
            left, candidates = leaves[row, layer], np.uint64(0)
            while left:
                bit = lowest_bit(left)
                left &= left - np.uint64(1)
                u, v, _ = project(projections, camera, x0 + (bit & 7), y0 + (bit >> 3), z0 + layer)
                on_canvas = u >= 0 and v >= 0 and u < width and v < height
                if on_canvas and UNCERTAIN < mask[int(v), int(u)] <= SHADOW_CANDIDATE:
                    candidates |= np.uint64(1) << np.uint64(bit)
            twice[row, layer] |= once[row, layer] & candidates
            once[row, layer] |= candidates


@kernel
def _any_candidate(words):  # type: ignore[no-untyped-def]
    """Check whether any pixel of (h, w / 8) is a candidate."""
    found = np.uint64(0)
    for row in range(words.shape[0]):
        for word in words[row]:
            found |= (word & LOW_BITS) + ABOVE_UNCERTAIN & ~word
    return found & HIGH_BITS != 0


@kernel
def _clear_candidates(index, leaves, bricks, layers, once, twice):  # type: ignore[no-untyped-def]
    """Clear the voxels of ``twice``, and in the lowest ``layers`` those of ``once``."""
    for row in range(index.size):
        z0 = np.int64(index[row]) // (bricks[0] * bricks[1]) * BRICK_EDGE
        for layer in range(BRICK_EDGE):
            denied = once[row, layer] if z0 + layer < layers else twice[row, layer]
            leaves[row, layer] &= ~denied
