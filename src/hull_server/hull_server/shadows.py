"""Resolves with all cameras together whether dark pixels are the person or floor in shadow.

A camera sends three kinds of foreground (``capture_rig.mask_levels``): sure pixels; candidates, whose texture says that
they are shadow; and attenuated pixels, which are the person unless other cameras know better. A cast shadow lies on the
floor z = 0, so all cameras that see a place of the floor see it equally attenuated. A leg stands above the floor: its
pixels fall on other floor places in every camera, bright or differently attenuated ones; and above that place on the
ray, all silhouettes agree on a body. So an attenuated pixel is shadow when

1. another camera sees its floor place equally attenuated, and no more cameras contradict (bright floor, another
   attenuation) than agree; cameras that see the person in front of it are not counted;
2. its ray does not meet the hull of all silhouettes higher than ``min_height_m``: that would be a leg in front of it;
3. most attenuated or sure pixels around it are shadow by 1 and 2, as one wrong pixel in one camera cuts the hull.

A candidate is background, unless more cameras contradict than agree and its ray does meet that hull: then it is the
body. The planar homography between views of the floor is that of Khan and Shah (ECCV 2006), who find feet with it. The
constants were chosen with bench/shadow_resolution.py.
"""

from __future__ import annotations

import math
from collections.abc import Collection
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
from numba import njit

from capture_rig import Volume
from capture_rig.kernel import kernel
from capture_rig.mask_levels import ATTENUATED_LEVELS, CANDIDATE_LEVELS, FLOOR_REACH_M

from .level_stack import BLIND, LevelStack, Mask
from .settings import ShadowSettings
from .views import Box, Masks, RigViews

LEAST_CENTRE_Z_M = 0.2  # a camera lower than this sees too little floor
STRIDE = 3  # every third row and column is tested
TOLERANCE = 1  # attenuation steps of a tenth by which two cameras may differ and agree
RAY_STEP_M = 0.06  # a leg is thicker
LEAST_SHARE = 0.6  # of the neighbours must agree

UNSEEN, EMPTY, CANDIDATE, ATTENUATED, SURE = 0, 1, 2, 3, 4  # kinds of levels
YES = 1

Array = npt.NDArray[np.float64]


class ShadowResolver:
    """Resolves silhouettes of several levels into binary ones. One thread at a time: it keeps scratch memory."""

    def __init__(self, views: RigViews, volume: Volume, settings: ShadowSettings) -> None:
        self._views, self._settings = views, settings
        self._stack = LevelStack(views)
        self._scene = floor_scene(views, volume)
        self._floor_px = np.empty((len(views.names), 3))
        height, width = views.seen.shape[1:]
        self._labels = PixelLabels.zeros((0, 0, width, height))

    def resolve(self, masks: Masks, seeing: int, chosen: Collection[str] | None = None) -> dict[str, Mask]:
        """Resolve masks of one instant, of the levels of ``capture_rig.mask_levels``, to masks of 0 and 255.

        ``seeing``: how many cameras must see a voxel. ``chosen``: cameras to resolve, with the help of all; all of them
        unless given. The masks that come in are not written to, and are returned where they are binary. InputError for
        a camera that is not in the rig, and for a mask of the wrong size.
        """
        self._views.present(masks)
        boxes = self._stack.take(masks)
        wanted = masks if chosen is None else {name: mask for name, mask in masks.items() if name in chosen}
        boxes = {name: box for name, box in boxes.items() if name in wanted}
        binary = {name: self._stack.binary(name, mask) if name in boxes else mask for name, mask in wanted.items()}
        if self._settings.enabled:
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
            levels = self._stack.levels
            _resolve(scene, levels, camera, box, (seeing, min_height_m), self._floor_px, self._labels, binary)


class FloorScene(NamedTuple):
    """Tables of the calibration.

    P (N, 3, 4), metres to pixels; centres (N, 3) of the cameras, metres; epipoles (N, N, 3): [j, i] is camera i's
    centre in camera j, homogeneous pixels; floor (N, 3, 3): pixels to (x, y, 1) on z = 0; low, high (3,) the volume,
    metres; kind (256,) of each level: UNSEEN, EMPTY, CANDIDATE, ATTENUATED or SURE; attenuation (256, 2): the least and
    greatest attenuation step that each level may stand for.
    """

    P: Array
    centres: Array
    epipoles: Array
    floor: Array
    low: Array
    high: Array
    kind: npt.NDArray[np.int8]
    attenuation: npt.NDArray[np.int8]


class PixelLabels(NamedTuple):
    """What is found; one element (h, w) uint8 for every third pixel both ways of a box, 0 before.

    foreground : YES for sure and attenuated pixels. shadow : YES for attenuated pixels that are floor. candidate : YES
    for candidates. body : YES for candidates that are the person. applied : YES where :func:`apply_labels` was.
    """

    foreground: Mask
    shadow: Mask
    candidate: Mask
    body: Mask
    applied: Mask

    @classmethod
    def zeros(cls, box: Box) -> PixelLabels:
        """Labels for a box."""
        left, top, right, bottom = box
        return cls(*np.zeros((len(cls._fields), -(-(bottom - top) // STRIDE), -(-(right - left) // STRIDE)), np.uint8))


def floor_scene(views: RigViews, volume: Volume) -> FloorScene:
    """Compute the tables of a rig's calibration."""
    centres = np.stack([-np.linalg.solve(P[:, :3], P[:, 3]) for P in views.P])
    homogeneous = np.concatenate([centres, np.ones((len(centres), 1))], axis=1)
    floor = [
        np.linalg.inv(P[:, [0, 1, 3]]) if abs(c[2]) > 1e-6 else np.full((3, 3), np.nan)
        for P, c in zip(views.P, centres, strict=True)
    ]
    kind = np.full(256, SURE, np.int8)
    kind[0], kind[BLIND] = EMPTY, UNSEEN
    kind[list(CANDIDATE_LEVELS)], kind[list(ATTENUATED_LEVELS)] = CANDIDATE, ATTENUATED
    attenuation, steps = np.zeros((256, 2), np.int8), len(ATTENUATED_LEVELS)
    attenuation[list(ATTENUATED_LEVELS)] = np.arange(steps)[:, None]
    for pair, level in enumerate(CANDIDATE_LEVELS):
        attenuation[level] = 2 * pair, min(2 * pair + 1, steps - 1)
    return FloorScene(
        P=np.ascontiguousarray(views.P),
        centres=centres,
        epipoles=np.einsum("jab,ib->jia", views.P, homogeneous),
        floor=np.stack(floor),
        low=np.array(volume.low, float),
        high=np.array(volume.high, float),
        kind=kind,
        attenuation=attenuation,
    )


@njit(cache=True, nogil=True, error_model="numpy")
def _resolve(scene, levels, camera, box, limits, floor_px, scratch, mask):
    """Correct one camera's ``mask`` (h, w) of 0 and 255 in a box; limits : cameras that must see a voxel, least height.

    scratch : labels for a whole canvas.
    """
    (left, top, right, bottom), (seeing, min_height) = box, limits
    h, w = (bottom - top + STRIDE - 1) // STRIDE, (right - left + STRIDE - 1) // STRIDE
    foreground, shadow, candidate = scratch.foreground[:h, :w], scratch.shadow[:h, :w], scratch.candidate[:h, :w]
    labels = PixelLabels(foreground, shadow, candidate, scratch.body[:h, :w], scratch.applied[:h, :w])
    for label in labels:
        label[:] = 0
    label_pixels(scene, levels, camera, box, seeing, min_height, floor_px, labels)
    apply_labels(scene.kind, levels[camera], box, labels, mask)


@njit(cache=True, nogil=True, error_model="numpy")
def label_pixels(scene, levels, camera, box, seeing, min_height, floor_px, labels):
    """Write the ``labels`` of one camera's attenuated pixels and candidates by rules 1 and 2.

    ``levels`` (N, H, W); ``box`` (left, top, right, bottom) of the pixels to test; ``floor_px`` (N, 3) is scratch
    memory: the homogeneous pixel of the tested floor place in every camera.
    """
    left, top, right, bottom = box
    G = scene.floor
    for v in range(top, bottom, STRIDE):
        for u in range(left, right, STRIDE):
            level = levels[camera, v, u]
            kind = scene.kind[level]
            if kind < CANDIDATE:
                continue
            row, column = (v - top) // STRIDE, (u - left) // STRIDE
            if kind == CANDIDATE:
                labels.candidate[row, column] = YES
            else:
                labels.foreground[row, column] = YES
            if kind == SURE:
                continue
            # where the pixel's ray meets the floor
            w = G[camera, 2, 0] * u + G[camera, 2, 1] * v + G[camera, 2, 2]
            x = (G[camera, 0, 0] * u + G[camera, 0, 1] * v + G[camera, 0, 2]) / w
            y = (G[camera, 1, 0] * u + G[camera, 1, 1] * v + G[camera, 1, 2]) / w
            if not (scene.low[0] - FLOOR_REACH_M < x < scene.high[0] + FLOOR_REACH_M):
                continue
            if not (scene.low[1] - FLOOR_REACH_M < y < scene.high[1] + FLOOR_REACH_M):
                continue
            if not _is_in_question(scene, levels, camera, level, x, y, floor_px):
                continue
            on_body = _meets_hull(scene, levels, camera, x, y, seeing, min_height, floor_px)
            if kind == ATTENUATED and not on_body:
                labels.shadow[row, column] = YES
            elif kind == CANDIDATE and on_body:
                labels.body[row, column] = YES


@njit(cache=True, nogil=True, error_model="numpy")
def apply_labels(kinds, levels, box, labels, mask):
    """Apply the labels that most neighbours share (rule 3) to ``mask`` (h, w) of 0 and 255, whose levels are
    ``levels``."""
    rows, columns = labels.foreground.shape
    for row in range(rows):
        for column in range(columns):
            if labels.shadow[row, column] | labels.body[row, column] == 0:
                continue
            for r in range(max(row - 1, 0), min(row + 2, rows)):
                for c in range(max(column - 1, 0), min(column + 2, columns)):
                    if labels.applied[r, c]:
                        continue
                    labels.applied[r, c] = YES
                    shadow = _most(labels.shadow, labels.foreground, r, c)
                    body = _most(labels.body, labels.candidate, r, c)
                    _write(kinds, levels, box, (r, c), (shadow, body), mask)


@kernel
def _write(kinds, levels, box, place, label, mask):
    """Write one label (shadow, body) to the square of pixels that it stands for."""
    (left, top, right, bottom), (row, column), (shadow, body) = box, place, label
    for v in range(top + STRIDE * row, min(top + STRIDE * (row + 1), bottom)):
        for u in range(left + STRIDE * column, min(left + STRIDE * (column + 1), right)):
            kind = kinds[levels[v, u]]
            if shadow and kind == ATTENUATED:
                mask[v, u] = 0
            elif body and kind == CANDIDATE:
                mask[v, u] = 255


@kernel
def _most(found, among, row, column):
    """Check that LEAST_SHARE of the 3 x 3 neighbours that are ``among`` are ``found``."""
    yes, total = 0, 0
    for r in range(max(row - 1, 0), min(row + 2, found.shape[0])):
        for c in range(max(column - 1, 0), min(column + 2, found.shape[1])):
            yes += found[r, c]
            total += among[r, c]
    return yes > LEAST_SHARE * total


@kernel
def _is_in_question(scene, levels, camera, own, x, y, floor_px):
    """Check whether the other cameras' view of a floor place speaks against the kind of level ``own`` (rule 1).

    The person (attenuated) is in question when a camera agrees that it is floor so attenuated, and no more contradict;
    shadow (a candidate) when more contradict than agree. Cameras that can change nothing any more are not asked.
    """
    attenuated, cameras = scene.kind[own] == ATTENUATED, len(levels)
    agree, contradict, left = 0, 0, cameras - 1
    for other in range(cameras):
        if other == camera:
            continue
        left -= 1
        P, f = scene.P[other], floor_px[other]
        for k in range(3):
            f[k] = P[k, 0] * x + P[k, 1] * y + P[k, 3]
        level = _level_of(levels[other], f[0], f[1], f[2])
        kind = scene.kind[level]
        if kind == EMPTY:
            contradict += 1
        elif kind in (CANDIDATE, ATTENUATED):
            more = scene.attenuation[level, 0] - scene.attenuation[own, 1] > TOLERANCE
            less = scene.attenuation[own, 0] - scene.attenuation[level, 1] > TOLERANCE
            if more or less:
                contradict += 1
            else:
                agree += 1
        if contradict > agree + left if attenuated else contradict + left <= agree:
            return False
    return agree > 0 or not attenuated


@kernel
def _meets_hull(scene, levels, camera, x, y, seeing, min_height, floor_px):
    """Check whether the ray from floor point (x, y) to the camera meets the hull of the others above ``min_height``."""
    dx, dy, cz = scene.centres[camera, 0] - x, scene.centres[camera, 1] - y, scene.centres[camera, 2]
    start, end = min_height / cz, min(scene.high[2] / cz, 1.0)
    start, end = _clip(x, dx, scene.low[0], scene.high[0], start, end)
    start, end = _clip(y, dy, scene.low[1], scene.high[1], start, end)
    step = RAY_STEP_M / math.sqrt(dx * dx + dy * dy + cz * cz)
    t, vetoed_by = start, 0
    while t <= end:
        if vetoed_by != camera:  # most places are vetoed by the camera that vetoed the one before
            ends = floor_px[vetoed_by], scene.epipoles[vetoed_by, camera]
            t = _first_without_veto(levels[vetoed_by], scene.kind, ends, t, end, step)
            if t > end:
                return False
        vetoed_by = _vetoed_by(scene, levels, camera, floor_px, t, seeing, vetoed_by)
        if vetoed_by < 0:
            return True
        t += step
    return False


@kernel
def _first_without_veto(levels, kinds, ends, t, end, step):
    """Return the first of the places t, t + step, ... that one camera (H, W) does not veto, or one beyond the end.

    ends : homogeneous pixels (3,) of the floor place and of the camera whose ray it is.
    """
    (f0, f1, f2), (e0, e1, e2) = (ends[0][0], ends[0][1], ends[0][2]), (ends[1][0], ends[1][1], ends[1][2])
    while t <= end:
        s = 1.0 - t
        kind = kinds[_level_of(levels, s * f0 + t * e0, s * f1 + t * e1, s * f2 + t * e2)]
        if kind not in (EMPTY, CANDIDATE):
            return t
        t += step
    return t


@kernel
def _clip(origin, direction, low, high, start, end):
    """Clip start .. end to where origin + t direction lies between low and high."""
    if abs(direction) < 1e-9:
        return (start, end) if low <= origin <= high else (1.0, 0.0)
    t0, t1 = (low - origin) / direction, (high - origin) / direction
    return max(start, min(t0, t1)), min(end, max(t0, t1))


@kernel
def _vetoed_by(scene, levels, camera, floor_px, t, seeing, first):
    """Return a camera that has no foreground at share ``t`` of the way to the camera, tried from ``first`` on.

    -1 when all others that see it have foreground there, and enough see it; ``camera`` when too few see it.
    """
    count, other = 1, first
    for _ in range(len(levels)):
        if other != camera:
            kind = scene.kind[_level_at(scene, levels, other, camera, floor_px, t)]
            if kind in (EMPTY, CANDIDATE):
                return other
            if kind != UNSEEN:
                count += 1
        other = other + 1 if other + 1 < len(levels) else 0
    return -1 if count >= seeing else camera


@kernel
def _level_at(scene, levels, other, camera, floor_px, t):
    """Return the level in camera ``other`` at share ``t`` of the way from the floor place to ``camera``."""
    e, f, s = scene.epipoles[other, camera], floor_px[other], 1.0 - t
    return _level_of(levels[other], s * f[0] + t * e[0], s * f[1] + t * e[1], s * f[2] + t * e[2])


@kernel
def _level_of(levels, x, y, depth):
    """Return the level (H, W) of a homogeneous pixel; BLIND behind the camera and outside its canvas."""
    if depth <= 0.0:
        return BLIND
    per_depth = 1.0 / depth
    u, v = math.floor(x * per_depth + 0.5), math.floor(y * per_depth + 0.5)
    if not (0.0 <= u < levels.shape[1] and 0.0 <= v < levels.shape[0]):
        return BLIND
    return int(levels[np.uint64(v), np.uint64(u)])
