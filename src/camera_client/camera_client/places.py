"""Where in the image something is: boxes around what was marked, and words for them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
import numpy.typing as npt

BRIDGE_OF_HEIGHT = 1 / 30  # what is marked this near to each other is one place
SMALLEST_PLACE = 2e-4  # of the pixels; fewer are marked by chance
MAX_PLACES = 3


@dataclass(frozen=True)
class Place:
    """A box of columns ``left`` to ``right`` and rows ``top`` to ``bottom``, px; ``share`` of the image is marked."""

    left: int
    right: int
    top: int
    bottom: int
    share: float

    def __str__(self) -> str:
        return f"{self.left}..{self.right}, {self.top}..{self.bottom}: {100 * self.share:.1f} %"


def find_places(marked: npt.NDArray[np.bool_], smallest: float = SMALLEST_PLACE, step_px: int = 1) -> list[Place]:
    """Where ``marked`` (h, w) is true, the largest place first.

    smallest : share of the pixels below which a place is left out.
    step_px : ``marked`` has a pixel for each square of so many of the image, whose pixels the boxes are given in.
    """
    mask = marked.astype(np.uint8)
    reach = 2 * round(BRIDGE_OF_HEIGHT * mask.shape[0] / 2) + 1
    together = cv2.morphologyEx(mask, cv2.MORPH_CLOSE, np.ones((reach, reach), np.uint8))
    count, labels, stats, _ = cv2.connectedComponentsWithStats(together)
    pixels = np.bincount(labels[mask > 0], minlength=count)
    places = []
    for label in sorted(range(1, count), key=lambda label: -pixels[label]):
        if pixels[label] < smallest * mask.size:
            break
        x, y, width, height = (step_px * int(n) for n in stats[label][:4])
        places.append(Place(x, x + width - 1, y, y + height - 1, float(pixels[label] / mask.size)))
    return places


def tell_places(places: Sequence[Place], shape: tuple[int, ...]) -> str:
    """ "lower left at 5..43, 70..109: 8.1 %" for the largest of ``places`` in an image of ``shape``."""
    what = ", ".join(f"{_whereabouts(place, shape)} at {place}" for place in places[:MAX_PLACES])
    if len(places) <= MAX_PLACES:
        return what
    return f"{len(places)} places ({100 * sum(place.share for place in places):.1f} %), the largest {what}"


def _whereabouts(place: Place, shape: tuple[int, ...]) -> str:
    """ "lower left" for a box there; thirds of the image."""
    row = ("upper", "", "lower")[min(int(1.5 * (place.top + place.bottom) / shape[0]), 2)]
    column = ("left", "", "right")[min(int(1.5 * (place.left + place.right) / shape[1]), 2)]
    return f"{row} {column}".strip() or "in the middle"
