"""People of several makers, one row a maker and rig: how a body fares that nothing was fitted to.

    python bench/families.py [NAME ...] [--products FOLDER] [--offsets] [--set NODE.PARAMETER=VALUE ...]

Tracks the sets avatar_FAMILY_BODY_CLIP_RIG and avatar_held_... of `models/avatar_people.py` (those with a NAME in
theirs) with automatic start and default settings. Makers put joints to different places: the constant offset of each
point in the pelvis's frame says what they mean by it, and is taken out of all columns but the first.

Columns: mean error of the 15 points, mm; without offsets; share of the tracked frames with a point over 200 mm; share
tracked; errors inside the track's own 95 % ellipsoids, all and of the worst point of a row. --offsets prints the
offsets: ahead, left and up, mm, mean over a family's sets. The last line is JSON.
"""

from __future__ import annotations

from collections import defaultdict
from pathlib import Path
from typing import Any, NamedTuple

from report import Table, add_settings, execute, finish, parser

import numpy as np
from clips import Recorded, load
from people import BAD_MM
from people_sets import KEPT, followed

from sagoma_tools.arguments import parse_settings
from sagoma_tools.evaluation.scores import INSIDE_95, nees_of
from stick_figure import metrics
from stick_figure.skeleton import POINT_NAMES


class Errors(NamedTuple):
    """Of one set's frames (F): mm of each point (F, 15) as it is and without offsets, whether inside its ellipsoid
    (F, 15) without offsets; NaN where not tracked. offsets (15, 3) m."""

    mm: np.ndarray
    centred_mm: np.ndarray
    inside: np.ndarray
    offsets: np.ndarray


def errors_of(what: Recorded, settings: dict[str, Any]) -> Errors:
    """Track a set."""
    tracks = followed(what, settings).tracks
    truth, none = what.truths[0], np.full(what.truths[0].shape[:2], np.nan)
    if not tracks:
        return Errors(none, none, none, np.full((15, 3), np.nan))
    track = tracks[min(tracks)].at(np.arange(len(truth)))
    centred = metrics.without_offsets(track.points_world, truth)
    squared = nees_of(centred - truth, track.covariance)
    return Errors(
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
        "over_200mm": float((np.nanmax(centred[tracked], axis=1) > BAD_MM).mean()),
        "tracked": float(tracked.mean()),
        "inside_95": float(np.nanmean(inside)),
        "worst_point_inside_95": float(np.nanmin(np.nanmean(inside, axis=0))),
    }


def main() -> None:
    """Print the tables and the line of JSON."""
    given = parser(__doc__)
    given.add_argument("names", nargs="*", help="parts of names of sets; default: all")
    given.add_argument("--products", type=Path, default=KEPT, help="folder of the carved sets")
    given.add_argument("--offsets", action="store_true", help="print where a family's joints lie from the track's")
    add_settings(given)
    arguments = given.parse_args()
    settings = parse_settings(arguments.settings)
    columns = "mean:>6.1f | -offset:>7.1f | > 200:>6.1% | tracked:>7.0% | inside:>6.1% | worst:>6.0%"
    by_row, by_family = defaultdict[str, list[Errors]](list), defaultdict[str, list[Errors]](list)
    each = Table(f"set:<48 | {columns}")
    for path in sorted(arguments.products.glob("avatar_*.pkl")):
        if arguments.names and not any(part in path.stem for part in arguments.names):
            continue
        errors, words = errors_of(load(path), settings), path.stem.removesuffix("_own").split("_")
        family = f"{words[2]}, held out" if words[1] == "held" else words[1]
        each.row(path.stem, *figures([errors]).values())
        own = ", own silhouettes" if path.stem.endswith("_own") else ""
        cameras = "".join(filter(str.isdigit, words[-1]))
        by_row[f"{family}, {cameras} cameras{own}"].append(errors)
        by_family[family].append(errors)
    shown, table = Table(f"family:<31 | {columns}"), {}
    for name, several in by_row.items():
        table[name] = figures(several)
        shown.row(name, *table[name].values())
    if arguments.offsets:
        heads = Table("point:<15" + "".join(f" | {family}:>18s" for family in by_family))
        means = [np.nanmean([e.offsets for e in several], axis=0) for several in by_family.values()]
        for i, point in enumerate(POINT_NAMES):
            heads.row(point, *(" ".join(f"{1e3 * v:.0f}" for v in mean[i]) for mean in means))
    finish(table)


if __name__ == "__main__":
    execute(main)
