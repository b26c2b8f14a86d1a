"""Compiled inner loops of :mod:`hull_server.consensus.doubt`: which dark pixels are floor in shadow."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
from numba import njit

from capture_rig.mask_levels import CANDIDATE_LEVELS, DARK_LEVELS

from ..kernel import kernel

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
    table[list(CANDIDATE_LEVELS)], table[list(DARK_LEVELS)] = CANDIDATE, DARK
    return table


def degrees() -> npt.NDArray[np.int8]:
    """The lowest and highest degree (256, 2) of each level, 0 where it has none."""
    table = np.zeros((256, 2), np.int8)
    for degree, level in enumerate(DARK_LEVELS):
        table[level] = degree
    for pair, level in enumerate(CANDIDATE_LEVELS):
        table[level] = 2 * pair, min(2 * pair + 1, len(DARK_LEVELS) - 1)
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
