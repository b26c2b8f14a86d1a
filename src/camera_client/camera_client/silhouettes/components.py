"""Keeps people's components of a mask, and fills small holes: one compiled pass over its runs.

A run is a stretch of equal pixels of one row. Runs of foreground that touch, also at a corner, are one component; so
are runs of background that share an edge (Rosenfeld and Pfaltz, "Sequential operations in digital picture processing",
J. ACM 1966). What lies to the left of a component's first run encloses it, so that holes, and what is in them, are
known without following any contour.
"""

from __future__ import annotations

from typing import NamedTuple

import cv2
import numpy as np

from capture_rig.kernel import kernel, njit

from ..background.kernels import OPTIONS
from ..background.training_verdict import HAND, PERSON
from ..frame_source import Mask

WORD = 8  # pixels that are tested together
EMPTY_WORD, FULL_WORD = np.uint64(0), np.uint64(0xFFFFFFFFFFFFFFFF)
OUTSIDE = 0  # the component of all background that reaches the mask's border
KEPT, FAR = 1, 2
PERSON_HANDS = PERSON / HAND  # hands, the least area, in a person's


class PeopleRule(NamedTuple):
    """Which components are people's.

    min_area_px : a component counts from this area on, its holes included. near_px : kept are the largest, any other
    that is large enough to be a person, and every one whose bounding box lies so near to a kept one: dark clothes on a
    dark floor cut legs from the trunk, and they must survive. max_hole_px : smaller holes are filled; larger ones stay,
    or the gap between the legs would be lost.
    """

    min_area_px: float
    near_px: float
    max_hole_px: float


def keep_people(mask: Mask, rule: PeopleRule) -> Mask:
    """Return a mask (h, w) of 0 and 255 without specks, far small components and small holes."""
    height, width = mask.shape
    if width % WORD or not mask.flags.c_contiguous:
        padded = np.zeros((height, -(-width // WORD) * WORD), np.uint8)
        padded[:, :width] = mask
        mask = padded
    kept = np.zeros((height, width), np.uint8)
    most = height * (width + 1) + 1
    runs, found = np.empty((4, most), np.int32), np.empty((8, most), np.int32)
    select_components(mask.view(np.uint64), rule, runs, found, kept)
    return kept


def components_on(mask: Mask, places: Mask) -> Mask:
    """Return the components of a mask (h, w) that lie mostly on ``places`` (h, w); all of 0 and 255."""
    count, labels = cv2.connectedComponents(mask, connectivity=8)
    inside = cv2.bitwise_and(mask, places).ravel()
    mostly = 2 * np.bincount(labels.ravel(), inside, count) > np.bincount(labels.ravel(), mask.ravel(), count)
    return np.where(mostly[labels], np.uint8(255), np.uint8(0))


@njit(**OPTIONS, crops=True)
def select_components(words, rule, runs, found, kept):  # type: ignore[no-untyped-def]
    """Write 255 into ``kept`` (h, w), zeros before, where people's components are.

    words (h, n) uint64 : the mask, eight pixels each, zeros beyond its width. runs (4, m), found (8, m) int32 : work
    space, of h (w + 1) + 1 columns.
    """
    row, begin, end, root = runs[0], runs[1], runs[2], runs[3]
    solid, area, outer, state = found[0], found[1], found[2], found[3]  # of a component in the place of its first run
    box = found[4:]
    count = _find_runs(words, kept.shape[1], row, begin, end, solid)
    _join_runs(count, kept.shape, row, begin, end, solid, root)
    for k in range(count):
        root[k] = root[root[k]]
        own = root[k]
        if own == k:
            area[k], state[k] = 0, 0
            box[0, k], box[1, k], box[2, k], box[3, k] = row[k], begin[k], row[k], end[k]
            outer[k] = root[k - 1] if k > 0 and row[k - 1] == row[k] else OUTSIDE
        area[own] += end[k] - begin[k]
        box[1, own], box[2, own], box[3, own] = min(box[1, own], begin[k]), row[k] + 1, max(box[3, own], end[k])
    for k in range(count - 1, OUTSIDE, -1):
        if root[k] == k and outer[k] != OUTSIDE:
            area[outer[k]] += area[k]
    _choose(count, solid, root, found, rule)
    # downwards: what a kept component encloses stays; small holes in it are filled, with all that is in them
    for k in range(1, count):
        if root[k] != k:
            continue
        around = outer[k]
        if solid[k]:
            if around != OUTSIDE and state[outer[around]]:
                state[k] = 1
        else:
            beyond = outer[around]
            filled = state[around] and area[k] < rule.max_hole_px
            state[k] = 1 if filled or (beyond != OUTSIDE and state[beyond]) else 0
    for k in range(1, count):
        if state[root[k]]:
            for x in range(begin[k], end[k]):
                kept[row[k], x] = 255


@kernel
def _find_runs(words, width, row, begin, end, solid):  # type: ignore[no-untyped-def]
    """Write all runs, row by row from left to right, after the one that stands for the outside; return their number.

    row, begin, end (m,) int32 : where they are, the end excluded. solid (m,) : 1 of foreground, 0 of background.
    """
    row[OUTSIDE], begin[OUTSIDE], end[OUTSIDE], solid[OUTSIDE] = -1, 0, 0, 0
    count = 1
    for y in range(len(words)):
        line, colour, start = words[y], np.int32(0), 0
        for w in range(len(line)):
            word = line[w]
            if word == (FULL_WORD if colour else EMPTY_WORD):
                continue
            for bit in range(WORD):
                now = np.int32((word >> np.uint64(8 * bit)) & np.uint64(1))
                x = WORD * w + bit
                if now == colour or x >= width:
                    continue
                if x > start:
                    row[count], begin[count], end[count], solid[count] = y, start, x, colour
                    count += 1
                colour, start = now, x
        row[count], begin[count], end[count], solid[count] = y, start, width, colour
        count += 1
    return count


@kernel
def _join_runs(count, shape, row, begin, end, solid, root):  # type: ignore[no-untyped-def]
    """Write into ``root`` (m,) a run before each one in its component, whose own is the component's first."""
    height, width = shape
    root[OUTSIDE] = OUTSIDE
    above = 1  # the first run of the row above that may touch the next one
    for k in range(1, count):
        root[k] = k
        border = row[k] == 0 or row[k] == height - 1 or begin[k] == 0 or end[k] == width
        if border and not solid[k]:
            root[k] = OUTSIDE
        if row[k] == 0:
            continue
        while row[above] < row[k] - 1 or (row[above] == row[k] - 1 and end[above] < begin[k]):
            above += 1
        other = above
        while row[other] == row[k] - 1 and begin[other] <= end[k]:
            touches = solid[k] or (begin[other] < end[k] and end[other] > begin[k])  # background not at a corner
            if solid[other] == solid[k] and touches:
                a, b = _first(root, other), _first(root, k)
                root[max(a, b)] = min(a, b)
            other += 1


@kernel
def _first(root, k):  # type: ignore[no-untyped-def]
    """Return the first run of a component."""
    while root[k] != k:
        root[k] = root[root[k]]
        k = root[k]
    return k


@kernel
def _choose(count, solid, root, found, rule):  # type: ignore[no-untyped-def]
    """Write 1 into the state of the components that are people's by their size and place.

    found : the work space of :func:`select_components`.
    """
    area, state, box, largest = found[1], found[3], found[4:], OUTSIDE
    for k in range(1, count):
        if root[k] != k or not solid[k] or area[k] < rule.min_area_px:
            continue
        state[k] = KEPT if area[k] >= PERSON_HANDS * rule.min_area_px else FAR
        if largest == OUTSIDE or area[k] > area[largest]:
            largest = k
    if largest == OUTSIDE:
        return
    state[largest] = KEPT
    near = True
    while near:
        near = False
        for k in range(1, count):
            if root[k] != k or state[k] != FAR:
                continue
            for other in range(1, count):
                if root[other] == other and state[other] == KEPT and _gap2_px(box, k, other) <= rule.near_px**2:
                    state[k], near = KEPT, True
                    break
    for k in range(1, count):
        state[k] = KEPT if root[k] == k and state[k] == KEPT else 0


@kernel
def _gap2_px(box, a, b):  # type: ignore[no-untyped-def]
    """Return the squared distance between two components' boxes, 0 where they touch or overlap."""
    down = max(box[0, a] - box[2, b], box[0, b] - box[2, a], 0)
    right = max(box[1, a] - box[3, b], box[1, b] - box[3, a], 0)
    return down * down + right * right
