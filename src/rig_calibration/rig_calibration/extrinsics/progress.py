"""While a board is carried: what is known already, and where to carry it next."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from ..boards.sighting import Sighting
from ..bundle.view_graph import common_moments, groups_of

ENOUGH_SHARED = 12
"""So many moments tie one camera to another."""
ENOUGH_MOMENTS = 40
CELLS = 3
ENOUGH_CELLS = 5
"""Of the 9 cells of its image, a camera should have seen the board in so many."""


@dataclass(frozen=True)
class MotionProgress:
    """moments : those at which two or more cameras saw the board. shared : moments by pair of cameras. groups : of
    cameras that are tied to each other. cells : by camera, in how many of the 9 cells of its image the board was."""

    cameras: tuple[str, ...]
    moments: int
    shared: Mapping[tuple[str, str], int]
    groups: tuple[tuple[str, ...], ...]
    cells: Mapping[str, int]

    @property
    def advice(self) -> str:
        """What to do next; empty when it is enough."""
        if len(self.groups) > 1:
            return self._bring_together()
        if self.moments < ENOUGH_MOMENTS:
            return f"carry on: {self.moments} of {ENOUGH_MOMENTS} moments"
        poorest = min(self.cameras, key=lambda name: (self.cells[name], name))
        if self.cells[poorest] < ENOUGH_CELLS:
            return f"carry the board to more places of {poorest}'s image: near and far, left and right"
        return ""

    def _bring_together(self) -> str:
        """The pair across two groups that has most in common already, else the first of each."""
        first, rest = self.groups[0], [name for group in self.groups[1:] for name in group]
        across = {(a, b): self.shared.get((min(a, b), max(a, b)), 0) for a in first for b in rest}
        (one, other), count = max(across.items(), key=lambda item: item[1])
        shown = f"share {count} of {ENOUGH_SHARED} moments" if count else "share no view"
        return f"{one} and {other} {shown}: carry the board where both see it"


def motion_progress(cameras: Sequence[str], sightings: Sequence[Sighting]) -> MotionProgress:
    """How far the sightings of the carried board tie ``cameras`` together."""
    shared = common_moments(sightings)
    strong = {pair for pair, count in shared.items() if count >= ENOUGH_SHARED}
    links = [Sighting(name, index, *_NOTHING) for index, pair in enumerate(sorted(strong)) for name in pair]
    seen_by: dict[int, set[str]] = {}
    cells: dict[str, set[tuple[int, int]]] = {name: set() for name in cameras}
    for sighting in sightings:
        seen_by.setdefault(sighting.moment, set()).add(sighting.camera)
        column, row = (sighting.pixels.mean(axis=0) / sighting.image_size * CELLS).astype(int).tolist()
        cells[sighting.camera].add((column, row))
    return MotionProgress(
        cameras=tuple(sorted(cameras)),
        moments=sum(len(names) > 1 for names in seen_by.values()),
        shared=shared,
        groups=tuple(groups_of(cameras, links)),
        cells={name: len(found) for name, found in cells.items()},
    )


_NOTHING = (np.empty(0, np.int64), np.empty((0, 2)), (0, 0))
