"""Views of a board out of one camera's footage."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from capture_rig.errors import InputError
from rig_calibration.boards.board import Board
from rig_calibration.intrinsics.selection import LEAST_VIEWS, ViewCollector
from rig_calibration.intrinsics.views import MIN_VIEWS
from rig_calibration.intrinsics.watching import BoardWatcher

from .footage import CameraFootage

MOST_EXAMINED = 400  # frames of a video in which the board is looked for
FEW_PICTURES = 60  # so many stills were chosen by a person, each for a reason: all are used
MOST_THOROUGH = 100  # ... and once more, longer in each, where it is hardly found
DIAGNOSED = 4  # images that are looked at for another board

Progress = Callable[[BoardWatcher], None]  # called after every image that was examined


def watch_footage(footage: CameraFootage, board: Board, model: str, progress: Progress | None = None) -> BoardWatcher:
    """Look for ``board`` in the footage's images, evenly chosen where there are very many; where it is hardly found,
    once more, longer in each image.

    Raises InputError when too few show it, naming the board that was there instead, if there was one.
    """
    count = footage.count
    few = not footage.is_video and count <= FEW_PICTURES
    watcher = BoardWatcher(board, footage.name, ViewCollector(board, model=model, every=few), thorough=few)
    missed: list[np.ndarray] = []
    _watch(watcher, footage, max(1, count // MOST_EXAMINED), missed, progress)
    if not few and len(watcher.collector) < LEAST_VIEWS:
        watcher.thorough = True
        _watch(watcher, footage, max(1, count // MOST_THOROUGH), [], progress)
    _require_views(watcher, missed)
    return watcher


def _watch(
    watcher: BoardWatcher, footage: CameraFootage, stride: int, missed: list[np.ndarray], progress: Progress | None
) -> None:
    """Every ``stride``-th image, until it is enough; a few of those without the board into ``missed``."""
    before: np.ndarray | None = None
    for index, (moment, image) in enumerate(footage):
        if index % stride == 0:
            seen = watcher.see(image, before if footage.is_video else None, moment)
            if seen.sighting is None:
                _remember(missed, image, watcher.examined - watcher.found)
            if progress is not None:
                progress(watcher)
            if footage.is_video and watcher.collector.enough:
                return
        before = image


def _remember(missed: list[np.ndarray], image: np.ndarray, count: int) -> None:
    """Keep a few images without the board, spread over the footage."""
    if len(missed) < DIAGNOSED:
        missed.append(image)
    elif count & (count - 1) == 0:  # powers of two
        missed[count.bit_length() % DIAGNOSED] = image


def _require_views(watcher: BoardWatcher, missed: list[np.ndarray]) -> None:
    if len(watcher.collector) >= MIN_VIEWS:
        return
    from rig_calibration.boards.diagnosis import diagnose_board

    other = next((text for text in (diagnose_board(image, watcher.board) for image in missed) if text), "")
    counted = ", ".join(f"{count} {reason}" for reason, count in watcher.reasons.most_common())
    raise InputError(
        f"{len(watcher.collector)} of {watcher.examined} images show the board usably ({counted})"
        + (f"; {other}" if other else ""),
        where=watcher.camera,
        remedy="Name the board that was filmed; film it sharp, well lit and whole, 20 or more views.",
    )
