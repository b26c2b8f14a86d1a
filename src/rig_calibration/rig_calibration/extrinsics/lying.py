"""When does a carried board lie on the floor? When a person says, or where nothing was ever below its plane."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence

import numpy as np
import numpy.typing as npt

from capture_rig.errors import InputError

from ..boards.sighting import Sighting
from .moments import group_by_moment, way_px

Array = npt.NDArray[np.float64]

BELOW_M = 0.03
"""So far may another board's corner, or a camera, lie below the plane of a board on the floor (noise, a soft floor)."""
STRAYS_PERCENT = 1.0
"""Of all corners, so many may lie lower still: poses go wrong now and then."""
RISES_M = 0.10
"""So far above that plane, at least, the board must have been carried: two boards in one plane tell no floor."""
SAME_PLACE_M = 0.01
"""A board whose corners all stay within this rests."""


RESTS_PX = 0.5
"""A board whose corners stay within this (median, in every camera) from one moment to the next rests."""


def resting_around(sightings: Iterable[Sighting], moment: int) -> tuple[int, ...]:
    """``moment`` and those right before and after it at which the board rests, as far as the cameras saw it.

    Raises InputError when no camera saw the board at ``moment``.
    """
    groups = group_by_moment(sightings)
    if moment not in groups:
        raise InputError(
            f"no camera shows the board in frame {moment}",
            remedy=f"Name a frame that does, of {_ranges(list(groups))}.",
        )
    moments = list(groups)
    here = moments.index(moment)
    first = last = here
    while first > 0 and _rests(groups[moments[first - 1]], groups[moment]):
        first -= 1
    while last + 1 < len(moments) and _rests(groups[moments[last + 1]], groups[moment]):
        last += 1
    return tuple(moments[first : last + 1])


def find_lying(
    T_reference_board: Mapping[int, Array], corners_board: Array, centres_reference: Sequence[Array]
) -> tuple[int, ...]:
    """The moments, ascending, at which the board lies on the floor, at one place.

    A moment counts when no corner of any other moment, and no camera, lies below the board's plane. Of the places where
    it does, the one where the board rested longest, of equal ones the last. ``corners_board`` (n, 3); centres (3,).
    Raises InputError when there is no such moment.
    """
    moments = sorted(T_reference_board)
    poses = np.array([T_reference_board[moment] for moment in moments])
    corners = np.einsum("mij,nj->mni", poses[:, :3, :3], corners_board) + poses[:, None, :3, 3]
    everything = np.concatenate([corners.reshape(-1, 3), np.reshape(centres_reference, (-1, 3))])
    candidates = [m for m in range(len(moments)) if _supports(poses[m], everything, corners)]
    if not candidates:
        raise InputError(
            "at no moment does the carried board lie on the floor: each time it was elsewhere below that plane",
            remedy="Lay it on the floor at the end and say when (--floor-at last or --floor-at FRAME), give pictures "
            "of it on the floor (--floor), or do without a floor (--floor-at none).",
        )
    resting = {m: _at_same_place(corners, m) for m in candidates}
    longest = max(candidates, key=lambda m: (len(resting[m]), m))
    return tuple(moments[m] for m in resting[longest])


def _supports(pose: Array, everything: Array, corners: Array) -> bool:
    """Is everything on the printed side of the board, and some of it well off?"""
    height = (everything - pose[:3, 3]) @ pose[:3, 2]
    board_height = (corners - pose[:3, 3]) @ pose[:3, 2]
    return bool(np.percentile(height, STRAYS_PERCENT) > -BELOW_M and board_height.max() > RISES_M)


def _at_same_place(corners: Array, moment: int) -> list[int]:
    apart = np.linalg.norm(corners - corners[moment], axis=2).max(axis=1)
    return np.flatnonzero(apart <= SAME_PLACE_M).tolist()


def _rests(one: Sequence[Sighting], other: Sequence[Sighting]) -> bool:
    """Do all cameras that saw the board both times see it at the same place, and is there one?"""
    ways = [way_px(a, b) for a in one for b in other if a.camera == b.camera]
    return bool(ways) and max(ways) <= RESTS_PX


def _ranges(moments: Sequence[int]) -> str:
    """Numbers as text, at most eight of them."""
    shown = [str(moment) for moment in moments[:8]]
    return ", ".join(shown) + (f", ... {moments[-1]}" if len(moments) > 8 else "")
