"""Looks at images one by one, and collects the views of a board that are worth calibrating from."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass

import numpy as np

from ..boards.board import Board
from ..boards.detection import find_board
from ..boards.sharpness import blur_px
from ..boards.sighting import Sighting
from .motion import motion_px
from .selection import ViewCollector

NOT_SEEN = "the board is not seen"


@dataclass(frozen=True, eq=False)
class Seen:
    """What an image showed: the sighting, None when the board was not found; ``taken``, or the ``reason`` why not."""

    sighting: Sighting | None
    taken: bool
    reason: str


class BoardWatcher:
    """Feeds the images of ``camera`` into a collector, and counts what became of them.

    ``thorough`` : look longer for the board in each image, for a few pictures that each matter.
    """

    def __init__(self, board: Board, camera: str, collector: ViewCollector, *, thorough: bool = False) -> None:
        self.board, self.camera, self.collector, self.thorough = board, camera, collector, thorough
        self.examined = self.found = 0
        self.reasons: Counter[str] = Counter()

    def see(self, image: np.ndarray, neighbour: np.ndarray | None, moment: int) -> Seen:
        """Look at an image (H, W[, 3]) uint8; ``neighbour`` is the one just before it, if there is one.

        Raises InputError when the images change their size.
        """
        seen = self._look(image, neighbour, moment)
        self.examined += 1
        self.found += seen.sighting is not None
        if not seen.taken:
            self.reasons[seen.reason.partition(":")[0]] += 1
        return seen

    def _look(self, image: np.ndarray, neighbour: np.ndarray | None, moment: int) -> Seen:
        sighting = find_board(image, self.board, camera=self.camera, moment=moment, thorough=self.thorough)
        if sighting is None:
            return Seen(None, False, NOT_SEEN)
        moved = 0.0 if neighbour is None else motion_px(image, neighbour, sighting.pixels)
        offer = self.collector.offer(sighting, blur_px=blur_px(image, sighting), motion_px=moved)
        return Seen(sighting, offer.taken, offer.reason)
