"""Floor shadows told from feet by all cameras together.

A camera sends three kinds of foreground (``capture_rig.mask_levels``): sure; candidates, whose texture says that they
are shadow; and dark pixels, which are the person unless somebody knows better. Somebody may: a cast shadow lies on the
floor z = 0, so that all cameras which see a place of the floor see it equally dark. A leg stands above the floor: its
pixels fall on other floor places in every camera, bright ones or differently dark ones; and above that place on the
ray, all silhouettes agree on a body. So a dark pixel is taken for shadow when

1. another camera sees its floor place equally dark, and no more cameras contradict (bright floor, another darkness)
   than agree; who sees the person in front of it has no say;
2. its ray does not meet the hull of all silhouettes higher than ``min_height_m``: that would be a leg in front of it;
3. most dark or sure pixels around it are shadow by 1 and 2: a hull dies of one wrong pixel in one camera.

A candidate is background, unless more cameras contradict than agree and its ray does meet that hull: then it is body.
The planar homography between views of the floor is that of Khan and Shah (ECCV 2006), who
look for feet with it; here it looks for what is no foot.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import cv2
import numpy as np
import numpy.typing as npt
from numba import njit

from capture_rig import Volume
from capture_rig.mask_levels import ATTENUATED_LEVELS, CANDIDATE_LEVELS, FOREGROUND, SHADOW_CANDIDATE

from .kernel import kernel
from .settings import ShadowSettings
from .views import Masks, RigViews

# --- Compiled inner loops of :mod:`hull_server.shadows`: which dark pixels are floor in shadow.

BLIND = 1  # level of pixels that the camera does not see; no camera client sends it
UNSEEN, EMPTY, CANDIDATE, DARK, SURE = 0, 1, 2, 3, 4  # kinds of levels; from DARK on the person, perhaps
STRIDE = 3  # every third row and column is judged
RAY_STEP_M = 0.06  # a leg is thicker
LEAST_SHARE = 0.6  # of the neighbours must be of one opinion
YES = 1

Array = npt.NDArray[np.float64]
Levels = npt.NDArray[np.uint8]


class Scene(NamedTuple):
    """What does not change from set to set.

    P (N, 3, 4), metres to pixels; centres (N, 3) of the cameras, metres; epipoles (N, N, 3): [j, i] is camera i's
    centre in camera j, homogeneous pixels; floor (N, 3, 3): pixels to (x, y, 1) on z = 0; low, high (3,) the volume,
    metres; kind (256,) of each level: UNSEEN, EMPTY, CANDIDATE, DARK or SURE; degree (256, 2): the lowest and highest
    degree of darkness that each level may stand for.
    """

    P: Array
    centres: Array
    epipoles: Array
    floor: Array
    low: Array
    high: Array
    kind: npt.NDArray[np.int8]
    degree: npt.NDArray[np.int8]


def kinds() -> npt.NDArray[np.int8]:
    """The kind (256,) of each level; levels that nobody sends are SURE."""
    table = np.full(256, SURE, np.int8)
    table[0], table[BLIND] = EMPTY, UNSEEN
    table[list(CANDIDATE_LEVELS)], table[list(ATTENUATED_LEVELS)] = CANDIDATE, DARK
    return table


def degrees() -> npt.NDArray[np.int8]:
    """The lowest and highest degree (256, 2) of each level, 0 where it has none."""
    table = np.zeros((256, 2), np.int8)
    for degree, level in enumerate(ATTENUATED_LEVELS):
        table[level] = degree
    for pair, level in enumerate(CANDIDATE_LEVELS):
        table[level] = 2 * pair, min(2 * pair + 1, len(ATTENUATED_LEVELS) - 1)
    return table


class Verdicts(NamedTuple):
    """What is found, 0 before; one element (h, w) uint8 for every third pixel both ways.

    there : YES for sure and dark pixels. shadow : YES for dark pixels that are floor. doubted : YES for candidates.
    body : YES for candidates that are the person. settled : YES where :func:`settle` was.
    """

    there: Levels
    shadow: Levels
    doubted: Levels
    body: Levels
    settled: Levels


@njit(cache=True, nogil=True, error_model="numpy")
def judge(scene, levels, camera, box, seeing, tolerance, min_height, reach, floor_px, verdicts):
    """Write the ``verdicts`` on the dark pixels and candidates of one camera.

    ``levels`` (N, H, W); ``box`` (left, top, right, bottom) of the pixels to judge; ``floor_px`` (N, 3) is scratch
    memory: the homogeneous pixel of the judged floor place in every camera.
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
                verdicts.doubted[row, column] = YES
            else:
                verdicts.there[row, column] = YES
            if kind == SURE:
                continue
            # where the pixel's ray meets the floor
            w = G[camera, 2, 0] * u + G[camera, 2, 1] * v + G[camera, 2, 2]
            x = (G[camera, 0, 0] * u + G[camera, 0, 1] * v + G[camera, 0, 2]) / w
            y = (G[camera, 1, 0] * u + G[camera, 1, 1] * v + G[camera, 1, 2]) / w
            if not (scene.low[0] - reach < x < scene.high[0] + reach):
                continue
            if not (scene.low[1] - reach < y < scene.high[1] + reach):
                continue
            agree, contradict = _witnesses(scene, levels, camera, level, x, y, tolerance, floor_px)
            if contradict > agree if kind == DARK else contradict <= agree:
                continue  # nothing speaks against the camera's own opinion
            if kind == DARK and agree == 0:
                continue
            on_person = _is_on_the_person(scene, levels, camera, x, y, seeing, min_height, floor_px)
            if kind == DARK and not on_person:
                verdicts.shadow[row, column] = YES
            elif kind == CANDIDATE and on_person:
                verdicts.body[row, column] = YES


@njit(cache=True, nogil=True, error_model="numpy")
def settle(kinds, levels, box, verdicts, mask):
    """Apply the verdicts that most neighbours share to ``mask`` (h, w) of 0 and 255, whose levels are ``levels``.

    Returns how many dark pixels became background, and how many candidates the person.
    """
    rows, columns = verdicts.there.shape
    shadow_px, body_px = 0, 0
    for row in range(rows):
        for column in range(columns):
            if verdicts.shadow[row, column] | verdicts.body[row, column] == 0:
                continue
            for r in range(max(row - 1, 0), min(row + 2, rows)):
                for c in range(max(column - 1, 0), min(column + 2, columns)):
                    if verdicts.settled[r, c]:
                        continue
                    verdicts.settled[r, c] = YES
                    shadow = _most(verdicts.shadow, verdicts.there, r, c)
                    body = _most(verdicts.body, verdicts.doubted, r, c)
                    removed, added = _apply(kinds, levels, box, r, c, shadow, body, mask)
                    shadow_px, body_px = shadow_px + removed, body_px + added
    return shadow_px, body_px


@kernel
def _apply(kinds, levels, box, row, column, shadow, body, mask):
    """Write one verdict on the square of pixels that it stands for; how many were removed and added."""
    left, top, right, bottom = box
    removed, added = 0, 0
    for v in range(top + STRIDE * row, min(top + STRIDE * (row + 1), bottom)):
        for u in range(left + STRIDE * column, min(left + STRIDE * (column + 1), right)):
            kind = kinds[levels[v, u]]
            if shadow and kind == DARK:
                mask[v, u] = 0
                removed += 1
            elif body and kind == CANDIDATE:
                mask[v, u] = 255
                added += 1
    return removed, added


@kernel
def _most(found, among, row, column):
    """Whether LEAST_SHARE of the 3 x 3 neighbours that are ``among`` are ``found``."""
    yes, all_of_them = 0, 0
    for r in range(max(row - 1, 0), min(row + 2, found.shape[0])):
        for c in range(max(column - 1, 0), min(column + 2, found.shape[1])):
            yes += found[r, c]
            all_of_them += among[r, c]
    return yes > LEAST_SHARE * all_of_them


@kernel
def _witnesses(scene, levels, camera, own, x, y, tolerance, floor_px):
    """How many other cameras see that place of the floor as dark as level ``own`` is, and how many see it otherwise."""
    agree, contradict = 0, 0
    for other in range(len(levels)):
        if other == camera:
            continue
        for k in range(3):
            floor_px[other, k] = scene.P[other, k, 0] * x + scene.P[other, k, 1] * y + scene.P[other, k, 3]
        level = _level_at(scene, levels, other, camera, floor_px, 0.0)
        kind = scene.kind[level]
        if kind == EMPTY:
            contradict += 1
        elif kind in (CANDIDATE, DARK):
            darker = scene.degree[level, 0] - scene.degree[own, 1] > tolerance
            lighter = scene.degree[own, 0] - scene.degree[level, 1] > tolerance
            if darker or lighter:
                contradict += 1
            else:
                agree += 1
    return agree, contradict


@kernel
def _is_on_the_person(scene, levels, camera, x, y, seeing, min_height, floor_px):
    """Whether the ray from the camera to floor point (x, y) meets the hull of all silhouettes above ``min_height``."""
    dx, dy, cz = scene.centres[camera, 0] - x, scene.centres[camera, 1] - y, scene.centres[camera, 2]
    start, end = min_height / cz, min(scene.high[2] / cz, 1.0)
    start, end = _within(x, dx, scene.low[0], scene.high[0], start, end)
    start, end = _within(y, dy, scene.low[1], scene.high[1], start, end)
    step = RAY_STEP_M / math.sqrt(dx * dx + dy * dy + cz * cz)
    t, vetoed_by = start, 0
    while t <= end:
        vetoed_by = _vetoed_by(scene, levels, camera, floor_px, t, seeing, vetoed_by)
        if vetoed_by < 0:
            return True
        t += step
    return False


@kernel
def _within(origin, direction, low, high, start, end):
    """The part of start .. end in which origin + t direction lies between low and high."""
    if abs(direction) < 1e-9:
        return (start, end) if low <= origin <= high else (1.0, 0.0)
    t0, t1 = (low - origin) / direction, (high - origin) / direction
    return max(start, min(t0, t1)), min(end, max(t0, t1))


@kernel
def _vetoed_by(scene, levels, camera, floor_px, t, seeing, first):
    """Who has no foreground at share ``t`` of the way from the floor place to the camera, asked from ``first`` on.

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
    """The level that camera ``other`` has at share ``t`` of the way from the floor place to ``camera``.

    BLIND behind the camera and outside its canvas.
    """
    e, s = scene.epipoles, 1.0 - t
    depth = s * floor_px[other, 2] + t * e[other, camera, 2]
    if depth <= 0.0:
        return BLIND
    per_depth = 1.0 / depth
    u = math.floor((s * floor_px[other, 0] + t * e[other, camera, 0]) * per_depth + 0.5)
    v = math.floor((s * floor_px[other, 1] + t * e[other, camera, 1]) * per_depth + 0.5)
    if not (0.0 <= u < levels.shape[2] and 0.0 <= v < levels.shape[1]):
        return BLIND
    return int(levels[other, int(v), int(u)])


LEAST_CENTRE_Z_M = 0.2  # a camera lower than this sees no floor worth judging

Mask = npt.NDArray[np.uint8]


@dataclass(frozen=True, eq=False)
class Resolved:
    """Masks without doubt, and how much of it there was.

    masks : (h, w) uint8 of each camera, 0 or 255; the very array that came in where it held nothing else.
    shadow_px, body_px : dark pixels that turned out to be shadow, and candidates that turned out to be body.
    """

    masks: dict[str, Mask]
    shadow_px: int
    body_px: int


class ShadowResolver:
    """Turns silhouettes with doubt into binary ones. Not for two threads at a time: it keeps scratch memory."""

    def __init__(self, views: RigViews, volume: Volume, settings: ShadowSettings) -> None:
        self._views, self._settings = views, settings
        self._blind = np.where(views.seen > 0, np.uint8(0), np.uint8(BLIND))
        self._levels = np.full_like(views.seen, BLIND)
        self._scene = _scene(views, volume)
        self._floor_px = np.empty((len(views.names), 3))

    def resolve(self, masks: Masks, seeing: int) -> Resolved:
        """Masks of one instant, of the levels of ``capture_rig.mask_levels``, to masks of 0 and 255.

        ``seeing``: how many cameras must see a voxel. The masks that come in are not written to. InputError for a
        camera that is not in the rig, and for a mask of the wrong size.
        """
        self._views.present(masks)
        doubtful = {
            name: cv2.boundingRect(where)
            for name, mask in sorted(masks.items())
            if cv2.countNonZero(where := _between(mask, CANDIDATE_LEVELS[0], ATTENUATED_LEVELS[-1]))
        }
        binary = {name: binary_mask(mask) if name in doubtful else mask for name, mask in masks.items()}
        if not doubtful or not self._settings.enabled:
            return Resolved(binary, 0, 0)
        self._stack(masks)
        shadow_px = body_px = 0
        for name, (x, y, width, height) in doubtful.items():
            shadow, body = self._judge(
                self._views.names.index(name), (x, y, x + width, y + height), seeing, binary[name]
            )
            shadow_px, body_px = shadow_px + shadow, body_px + body
        return Resolved(binary, shadow_px, body_px)

    def _stack(self, masks: Masks) -> None:
        """All masks in one array; pixels of absent cameras, and those that a camera does not see, are blind."""
        for index, name in enumerate(self._views.names):
            if name not in masks:
                self._levels[index] = BLIND
                continue
            width, height = self._views.sizes[index]
            own = self._levels[index, :height, :width]
            cv2.bitwise_or(masks[name], self._blind[index, :height, :width], dst=own)

    def _judge(self, camera: int, box: tuple[int, int, int, int], seeing: int, binary: Mask) -> tuple[int, int]:
        """Correct the camera's ``binary`` mask within the box (left, top, right, bottom): pixels removed, and added."""
        settings, scene = self._settings, self._scene
        if scene.centres[camera, 2] <= max(settings.min_height_m, LEAST_CENTRE_Z_M):
            return 0, 0
        left, top, right, bottom = box
        shape = -(-(bottom - top) // STRIDE), -(-(right - left) // STRIDE)
        verdicts = Verdicts(*np.zeros((len(Verdicts._fields), *shape), np.uint8))
        judge(
            scene,
            self._levels,
            camera,
            box,
            seeing,
            settings.tolerance,
            settings.min_height_m,
            settings.reach_m,
            self._floor_px,
            verdicts,
        )
        shadow_px, body_px = settle(scene.kind, self._levels[camera], box, verdicts, binary)
        return shadow_px, body_px


def _between(mask: Mask, low: int, high: int) -> Mask:
    """255 at pixels of these levels, ends included."""
    return np.asarray(cv2.inRange(mask, low, high), np.uint8)  # type: ignore[call-overload]


def binary_mask(mask: Mask) -> Mask:
    """The mask in 0 and 255: candidates are background, dark pixels the person."""
    return np.asarray(cv2.threshold(mask, SHADOW_CANDIDATE, FOREGROUND, cv2.THRESH_BINARY)[1], np.uint8)


def _scene(views: RigViews, volume: Volume) -> Scene:
    centres = np.stack([-np.linalg.solve(P[:, :3], P[:, 3]) for P in views.P])
    homogeneous = np.concatenate([centres, np.ones((len(centres), 1))], axis=1)
    floor = np.stack(
        [
            np.linalg.inv(P[:, [0, 1, 3]]) if abs(c[2]) > 1e-6 else np.full((3, 3), np.nan)
            for P, c in zip(views.P, centres, strict=True)
        ]
    )
    return Scene(
        P=np.ascontiguousarray(views.P),
        centres=centres,
        epipoles=np.einsum("jab,ib->jia", views.P, homogeneous),
        floor=floor,
        low=np.array(volume.low, float),
        high=np.array(volume.high, float),
        kind=kinds(),
        degree=degrees(),
    )
