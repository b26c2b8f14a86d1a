"""People of several makers, one row a maker and rig: how a body fares that nothing was fitted to."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable
from typing import Any, NamedTuple

from report import Table

import numpy as np
from clips import Recorded
from people_sets import States, follower_of, states_of

from sagoma_tools.evaluation.scores import INSIDE_95, LARGE_ERROR_MM, nees_of
from sagoma_tools.evaluation.track import Track
from stick_figure import metrics
from stick_figure.skeleton import POINT_NAMES


class Errors(NamedTuple):
    """Of one set's frames with a truth (F): mm of each point (F, 15) as it is and without offsets, whether inside its
    ellipsoid (F, 15) without offsets; NaN where not tracked. offsets (15, 3) m."""

    mm: np.ndarray
    centred_mm: np.ndarray
    inside: np.ndarray
    offsets: np.ndarray

    @classmethod
    def of_states(cls, what: Recorded, states: States) -> Errors:
        """Compare the first person's states with the truth."""
        known = np.flatnonzero(np.isfinite(what.truths[0]).any(axis=(1, 2)))
        truth, none = what.truths[0][known], np.full((len(known), 15), np.nan)
        track = Track.of_states([(frame, state) for frame, state, _ in states]).at(known)
        if not np.isfinite(track.points_world).any():
            return cls(none, none, none, np.full((15, 3), np.nan))
        centred = metrics.without_offsets(track.points_world, truth)
        squared = nees_of(centred - truth, track.covariance)
        return cls(
            1e3 * metrics.point_errors(track.points_world, truth),
            1e3 * metrics.point_errors(centred, truth),
            np.where(np.isfinite(squared), squared <= INSIDE_95, np.nan),
            metrics.joint_offsets(track.points_world, truth),
        )


def figures(several: list[Errors]) -> dict[str, float]:
    """What a row says of the sets' errors."""
    mm, centred, inside = (np.concatenate([getattr(e, name) for e in several]) for name in Errors._fields[:3])
    tracked = np.isfinite(centred).any(axis=1)
    return {
        "mean_mm": float(np.nanmean(mm)),
        "without_offset_mm": float(np.nanmean(centred)),
        "over_200mm": float((np.nanmax(centred[tracked], axis=1) > LARGE_ERROR_MM).mean()),
        "tracked": float(tracked.mean()),
        "inside_95": float(np.nanmean(inside)),
        "worst_point_inside_95": float(np.nanmin(np.nanmean(inside, axis=0))),
    }


def makers(sets: Iterable[Recorded], settings: dict[str, Any], offsets: bool) -> dict[str, dict[str, float]]:
    """Track the sets avatar_MAKER_BODY_CLIP_RIG and avatar_held_... of `models/avatar_people.py`. Makers put joints to
    different places: the constant offset of each point in the pelvis's frame says what they mean by it, and is taken
    out of all columns but the first.

    Columns: mean error of the 15 points, mm; without offsets; share of the tracked frames with a point over 200 mm;
    share tracked; errors inside the track's own 95 % ellipsoids, all and of the worst point of a row. ``offsets`` :
    print them, too: ahead, left and up, mm, mean over a maker's sets.
    """
    columns = "mean:>6.1f | -offset:>7.1f | > 200:>6.1% | tracked:>7.0% | inside:>6.1% | worst:>6.0%"
    by_row, by_maker = defaultdict[str, list[Errors]](list), defaultdict[str, list[Errors]](list)
    each = Table(f"set:<48 | {columns}")
    for what in sets:
        words = what.name.removesuffix("_own").split("_")
        if words[0] != "avatar":
            continue
        errors = Errors.of_states(what, states_of(what, follower_of(what, settings)))
        maker = f"{words[2]}, held out" if words[1] == "held" else words[1]
        each.row(what.name, *figures([errors]).values())
        own = ", own silhouettes" if what.name.endswith("_own") else ""
        by_row[f"{maker}, {len(what.rig.cameras)} cameras{own}"].append(errors)
        by_maker[maker].append(errors)
    shown, table = Table(f"maker:<31 | {columns}"), {}
    for name, several in by_row.items():
        table[name] = figures(several)
        shown.row(name, *table[name].values())
    if offsets:
        heads = Table("point:<15" + "".join(f" | {maker}:>18s" for maker in by_maker))
        means = [np.nanmean([e.offsets for e in several], axis=0) for several in by_maker.values()]
        for i, point in enumerate(POINT_NAMES):
            heads.row(point, *(" ".join(f"{1e3 * v:.0f}" for v in mean[i]) for mean in means))
    return table
