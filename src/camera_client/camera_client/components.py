"""Which parts of a raw mask belong to the person: the largest one and its neighbours, never the largest alone."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from .frame_source import Mask


@dataclass(frozen=True, eq=False)
class _Part:
    """An outer contour with its area in pixels and its bounding box (x, y, w, h)."""

    contour: np.ndarray
    area_px: float
    box: tuple[int, int, int, int]


def keep_person(mask: Mask, min_area_px: float, near_px: float, max_hole_px: float) -> Mask:
    """Mask (H, W) without specks, far components and small holes.

    A component counts from ``min_area_px`` on. Kept are the largest, and every one whose bounding box lies within
    ``near_px`` of a kept one: dark clothes on a dark floor cut legs from the trunk, and they must survive. Holes
    below ``max_hole_px`` are filled; larger ones stay, or the gap between the legs would be lost.
    """
    contours, hierarchy = cv2.findContours(mask, cv2.RETR_CCOMP, cv2.CHAIN_APPROX_NONE)
    if not contours:
        return np.zeros_like(mask)
    is_outer = hierarchy.reshape(-1, 4)[:, 3] < 0
    parts = _parts([c for c, outer in zip(contours, is_outer, strict=True) if outer], min_area_px)
    kept = np.zeros_like(mask)
    cv2.drawContours(kept, [part.contour for part in _near_the_largest(parts, near_px)], -1, 255, cv2.FILLED)
    cv2.bitwise_and(kept, mask, dst=kept)
    holes = [c for c, outer in zip(contours, is_outer, strict=True) if not outer and _hole_area_px(c) < max_hole_px]
    holes = [hole for hole in holes if kept[hole.reshape(-1, 2)[0, 1], hole.reshape(-1, 2)[0, 0]]]
    cv2.drawContours(kept, holes, -1, 255, cv2.FILLED)
    return kept


def majority(mask: Mask, side_px: int) -> Mask:
    """The median filter of a mask of 0 and 255, as a box filter: several times faster, and equal for odd sides."""
    if side_px <= 1:
        return mask
    mean = cv2.blur(mask, (side_px, side_px), borderType=cv2.BORDER_REPLICATE)
    return cv2.threshold(mean, 127, 255, cv2.THRESH_BINARY)[1]


def majority_count(side_px: int) -> int:
    """A pixel that survives the filter has so many pixels of foreground in one 8 x 8 block that its window meets.

    The window lies in four blocks at most, which leaves (side^2 + 1) / 8 for one of them; fewer at the image's border,
    where a pixel also stands for its neighbours outside: in the corner, (side + 1) / 2 of them outvote all others.
    """
    return side_px // 2 + 1


def _parts(outers: list[np.ndarray], min_area_px: float) -> list[_Part]:
    """Components of at least ``min_area_px``, the largest first (ties: in the order found, so deterministic)."""
    large = [(_outer_area_px(c), c) for c in outers]
    large = [(area, contour) for area, contour in large if area >= min_area_px]
    parts = [_Part(contour, area, tuple(cv2.boundingRect(contour))) for area, contour in large]  # type: ignore[arg-type]
    return sorted(parts, key=lambda part: -part.area_px)


def _near_the_largest(parts: list[_Part], near_px: float) -> list[_Part]:
    kept, waiting = parts[:1], parts[1:]
    frontier = kept
    while frontier and waiting:
        frontier = [part for part in waiting if any(_gap_px(part.box, other.box) <= near_px for other in frontier)]
        waiting = [part for part in waiting if part not in frontier]
        kept = kept + frontier
    return kept


def _gap_px(a: tuple[int, int, int, int], b: tuple[int, int, int, int]) -> float:
    """Distance between two boxes (x, y, w, h), 0 where they touch or overlap."""
    dx = max(a[0] - (b[0] + b[2]), b[0] - (a[0] + a[2]), 0)
    dy = max(a[1] - (b[1] + b[3]), b[1] - (a[1] + a[3]), 0)
    return float(np.hypot(dx, dy))


def _outer_area_px(contour: np.ndarray) -> float:
    """Pixels within an outer contour, border included: Pick's theorem, A + B / 2 + 1."""
    return cv2.contourArea(contour) + len(contour) / 2 + 1


def _hole_area_px(contour: np.ndarray) -> float:
    """Pixels of a hole, whose contour runs on the foreground around it: Pick's theorem, A - B / 2 + 1."""
    return cv2.contourArea(contour) - len(contour) / 2 + 1
