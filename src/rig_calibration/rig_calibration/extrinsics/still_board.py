"""The corners of a board that lies still before a camera, out of several frames: averaged, hands left out."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from ..boards.board import Board
from ..boards.sighting import Sighting

Array = npt.NDArray[np.float64]

SAME_PLACE_PX = 1.0
"""Corners that lie further apart (median over the board) belong to a board, or a camera, that was moved."""
OUTLIER_SDS = 4.0
LEAST_SCATTER_PX = 0.1
"""A corner that strays less than OUTLIER_SDS times this is never an outlier."""
LEAST_SHARE = 1 / 3
"""A corner counts when so many of the frames that agree show it."""
LASTING_PX = 0.05
"""What averaging does not remove: compression, the grid of pixels and the lens err alike in every frame."""


@dataclass(frozen=True, eq=False)
class StillBoard:
    """What one camera's frames say together.

    sighting : the averaged corners. frames : the moments that agree. strays : those that show the board elsewhere.
    """

    sighting: Sighting
    frames: tuple[int, ...]
    strays: tuple[int, ...]


def average_still_board(sightings: Sequence[Sighting], board: Board, *, target: str, moment: int = 0) -> StillBoard:
    """The average of one camera's ``sightings`` of a board that lies still, as a sighting of ``target``.

    The largest group of frames that show the board at the same place is taken, of equal ones the earliest; in it, a
    corner's frames that stray from the median (a hand at its edge) are left out. Needs one sighting or more.
    """
    ordered = sorted(sightings, key=lambda sighting: sighting.moment)
    pixels = _table(ordered, len(board.corners_board), board.half_turn_is_visible)  # (F, N, 2)
    together = _largest_group(pixels)
    chosen = pixels[together]
    mean, count = _mean_without_outliers(chosen)
    ids = np.flatnonzero(count >= max(1.0, LEAST_SHARE * len(chosen)))
    single = float(np.median([ordered[index].sigma_px for index in np.flatnonzero(together)]))
    sigma = float(np.hypot(single / np.sqrt(np.median(count[ids])), LASTING_PX))
    averaged = replace(ordered[0], moment=moment, target=target, ids=ids, pixels=mean[ids], sigma_px=sigma)
    moments = np.array([sighting.moment for sighting in ordered])
    return StillBoard(averaged, tuple(moments[together].tolist()), tuple(moments[~together].tolist()))


def _table(sightings: Sequence[Sighting], corners: int, half_turn_is_visible: bool) -> Array:
    """(F, corners, 2) pixels, NaN where a frame does not show a corner; boards that may be seen either way round are
    counted as the first frame counts them."""
    table = np.full((len(sightings), corners, 2), np.nan)
    for row, sighting in zip(table, sightings, strict=True):
        row[sighting.ids] = sighting.pixels
    if not half_turn_is_visible:
        for row in table[1:]:
            if _distance(row[::-1], table[0]) < _distance(row, table[0]):
                row[:] = row[::-1].copy()
    return table


def _largest_group(pixels: Array) -> npt.NDArray[np.bool_]:
    """(F,) which frames show the board at the place at which most show it."""
    near = np.array([[_distance(one, other) <= SAME_PLACE_PX for other in pixels] for one in pixels])
    return near[near.sum(axis=1).argmax()]


def _distance(one: Array, other: Array) -> float:
    """Median distance, px, of the corners that both show; infinite when they share none."""
    apart = np.linalg.norm(one - other, axis=1)
    apart = apart[np.isfinite(apart)]
    return float(np.median(apart)) if apart.size else float("inf")


def _mean_without_outliers(pixels: Array) -> tuple[Array, Array]:
    """Mean (N, 2) and number of frames (N,) of each corner; median and MAD tell which frames stray."""
    shown = np.isfinite(pixels[..., 0])
    seen = np.flatnonzero(shown.any(axis=0))
    median = np.full(pixels.shape[1:], np.nan)
    median[seen] = np.nanmedian(pixels[:, seen], axis=0)
    apart = np.linalg.norm(pixels - median, axis=2)
    scatter = max(LEAST_SCATTER_PX, 1.4826 * float(np.median(apart[shown])))
    good = shown & (apart <= OUTLIER_SDS * scatter)
    count = good.sum(axis=0)
    mean = np.where(good[..., None], pixels, 0.0).sum(axis=0) / np.maximum(count, 1)[:, None]
    return mean, count.astype(float)
