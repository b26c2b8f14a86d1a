"""Keeps people's components of a mask, and fills small holes, by the contours of both.

A contour around foreground that touches, also at a corner, is a component; one inside it is a hole, of background that
shares edges. Their areas follow from the contours alone (Pick's theorem).
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import cv2
import numpy as np

from ..background.verdict import HAND, PERSON
from ..frame_source import Mask
from .masks import Box


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


def keep_people(mask: Mask, rule: PeopleRule, things: Mask | None = None) -> Mask:
    """Return a mask (h, w) of 0 and 255 without specks, far small components and small holes.

    Components that lie mostly on ``things`` (h, w), 255 where foreground is hardly a person, are left out unless there
    are no others. What a kept component encloses stays.
    """
    kept = np.zeros_like(mask)
    contours, hierarchy = cv2.findContours(mask, cv2.RETR_CCOMP, cv2.CHAIN_APPROX_NONE)
    if not contours:
        return kept
    inner, points = hierarchy[0, :, 3] >= 0, np.array([len(each) for each in contours])
    most = points**2 / 8 + points / 2 + 1  # that so many can enclose, with their own: specks are not measured
    outer = [contours[k] for k in np.flatnonzero(~inner & (most >= rule.min_area_px)).tolist()]
    large = [each for each in outer if _area(each) >= rule.min_area_px]
    _fill(kept, _people(large, mask, rule, things))
    holes = [contours[k] for k in np.flatnonzero(inner).tolist() if kept[contours[k][0, 0, 1], contours[k][0, 0, 0]]]
    kept = np.asarray(cv2.bitwise_and(kept, mask), np.uint8)
    _fill(kept, [each for each in holes if _area(each, inside=True) < rule.max_hole_px])
    return kept


def _fill(mask: Mask, contours: Sequence[np.ndarray]) -> None:
    for each in contours:  # drawn together, one within another would be left out
        cv2.drawContours(mask, [each], -1, 255, cv2.FILLED)


def _area(contour: np.ndarray, inside: bool = False) -> float:
    """Return how many pixels a contour (n, 1, 2) encloses: with its own, or those ``inside`` alone."""
    if len(contour) == 1:
        return 1.0
    own = len(contour) / 2
    return cv2.contourArea(contour) + 1 + (-own if inside else own)


def _people(large: Sequence[np.ndarray], mask: Mask, rule: PeopleRule, things: Mask | None) -> list[np.ndarray]:
    """Return the contours of the ``large`` components that are people's by their size and place."""
    if not large:
        return []
    boxes = [Box.of_rectangle(cv2.boundingRect(each)) for each in large]
    areas = [_area(each) for each in large]
    clear = [k for k, box in enumerate(boxes) if things is None or not _lies_on(mask, things, box)]
    left = clear or list(range(len(large)))
    largest = max(left, key=lambda k: (areas[k], -boxes[k].top))
    kept = {largest} | {k for k in left if areas[k] * HAND >= PERSON * rule.min_area_px}
    grown = True
    while grown:
        near = {k for k in left if any(_gap2_px(boxes[k], boxes[other]) <= rule.near_px**2 for other in kept)}
        grown, kept = not near <= kept, kept | near
    return [large[k] for k in sorted(kept)]


def _lies_on(mask: Mask, things: Mask, box: Box) -> bool:
    """Whether more than half of the foreground in a component's bounding box lies on ``things``."""
    own = mask[box.slices]
    return 2 * cv2.countNonZero(cv2.bitwise_and(own, things[box.slices])) > cv2.countNonZero(own)


def _gap2_px(a: Box, b: Box) -> int:
    """Return the squared distance between two components' boxes, 0 where they touch or overlap."""
    down, right = max(a.top - b.bottom, b.top - a.bottom, 0), max(a.left - b.right, b.left - a.right, 0)
    return down * down + right * right
