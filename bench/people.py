"""One table over everybody there is to track: test data, the studio's people, hard cases, rendered mesh people.

    python bench/people.py [NAME ...] [--products FOLDER] [--set NODE.PARAMETER=VALUE ...]
    python bench/people.py --quick                     # half a minute: one set, which is carved if it is not kept
    python bench/people.py --ablation [NAME ...]       # what each part of tracker and filter is worth
    python bench/people.py --doubt [NAME ...]          # whether doubt is right
    python bench/people.py --makers [NAME ...]         # other makers' people, by maker and rig
    python bench/people.py --fast | --smoothed [NAME ...]
    python bench/people.py --first-pose [SESSION ...]  # what a T-pose tells; people cut off, people who walk in

Tracks every set (those with a NAME in theirs) with automatic start and default settings: each session of the test data
with its own silhouettes and, as _exact, with exact ones; the studio's tour by five people and its hard cases; scenes of
two to four of its people (together_); and what `models/mesh_people.py` and `models/random_people.py` put into FOLDER
(mesh_fit_: constants may have been fitted to them; mesh_prove_: never).

The hulls are carved once and kept in FOLDER (output/people): empty it after a change of cameras or hull.

Columns: frames in which a person is wholly inside the volume; mean error of the 15 points, mm, and without each point's
constant offset in the pelvis's frame; share of tracked frames with a point over 200 mm; share of frames tracked; share
of errors inside the track's own 95 % ellipsoids, all and of the worst point; processor time of fit and filter, ms a set
(with the start, and compiled code that is loaded in the first sets); identity switches and tracks of nobody where there
are several persons (all persons' together; below, each person's mean error and ms a set by the number of persons). A
second table holds the covariances point by point over all sets. The last line is JSON.
Each study says where it is made what its columns are: people_ablation.py, people_studies.py, people_first_pose.py.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from report import Table, add_settings, execute, finish, parser

import numpy as np
from clips import Recorded
from people_ablation import ablation
from people_first_pose import first_pose
from people_sets import KEPT, Followed, followed, recorded
from people_studies import doubt, fast_motion, makers, smoothed
from scenes import inside_volume

from capture_rig.session import Truth
from sagoma_tools.arguments import parse_settings
from sagoma_tools.evaluation.scores import INSIDE_95, mean_of_known, nees_of, share_below
from sagoma_tools.evaluation.track import Track
from sagoma_tools.evaluation.track_evaluation import score_people
from stick_figure import metrics
from stick_figure.skeleton import POINT_NAMES

BAD_MM = 1e3 * metrics.LARGE_ERROR_M
QUICK = "studio_arm_on_chest"  # the set of --quick
COLUMNS = 10  # of the table; a row of figures holds more


@dataclass(frozen=True)
class Figures:
    """A row: see the module's docstring. None where nothing was found, or no frame is of the kind."""

    frames: int
    mean_mm: float | None
    without_offset_mm: float | None
    over_200mm: float | None
    tracked: float
    inside_95: float | None
    worst_point_inside_95: float | None
    ms: float
    switches: int | None = None
    ghosts: int | None = None
    point_inside_95: tuple[float, ...] | None = None
    point_nees: tuple[float, ...] | None = None
    persons_mm: tuple[float | None, ...] | None = None
    ms_by_persons: list[float | None] | None = None


def judged(what: Recorded, found: Followed) -> Figures:
    """The figures of all persons together."""
    tracks, ms = found.tracks, found.ms
    truths = [Truth(np.arange(len(t)), t, None, 1.0, Path(what.name)) for t in what.truths]
    known = [np.flatnonzero(inside_volume(what.rig, t)) for t in what.truths]
    frames = sum(map(len, known))
    several = len(truths) > 1
    people = score_people(tracks, truths, what.fps) if several else None
    owned = [numbers[:1] for numbers in people.who.numbers] if people else [tuple(sorted(tracks))[:1]]
    pairs = [
        (tracks[numbers[0]].at(rows), truth.points_world[rows])
        for numbers, truth, rows in zip(owned, truths, known, strict=True)
        if numbers
    ]
    switches, ghosts = (sum(s or 0 for s in people.who.switches), people.who.ghost_frames) if people else (None, None)
    if not pairs:
        return Figures(frames, *[None] * 3, 0.0, *[None] * 2, ms, switches, ghosts)  # type: ignore[arg-type]
    errors = np.concatenate([track.points_world - truth for track, truth in pairs])
    distances = 1e3 * np.linalg.norm(errors, axis=2)
    tracked = np.isfinite(distances).any(axis=1)
    worst = np.where(tracked, np.nan_to_num(distances, nan=-1.0).max(axis=1), np.nan)
    persons_mm = tuple(_mean(1e3 * metrics.point_errors(track.points_world, truth)) for track, truth in pairs)
    nees = nees_of(errors, np.concatenate([track.covariance for track, _ in pairs]))
    inside = share_below(INSIDE_95, nees, 0)
    return Figures(
        frames,
        _mean(distances),
        _mean(np.concatenate([_without_offsets(*pair) for pair in pairs])),
        _mean((worst > BAD_MM)[tracked]),
        float(tracked.sum() / frames),
        float(share_below(INSIDE_95, nees)),
        float(np.nanmin(inside)),
        ms,
        switches,
        ghosts,
        tuple(inside.tolist()),
        tuple(mean_of_known(nees, 0).tolist()),
        persons_mm if several else None,
        found.ms_by_persons if several else None,
    )


def coverage_of_people(found: list[Figures]) -> None:
    """Print point by point how the covariances hold over all sets, each with the same weight: the mean share inside,
    the least of a set, in how many it is 90 to 99 %, and the mean normalised squared error (3 when they are right).

    An error that is mostly a constant of a person is inside in all frames of a take or in none, so it is people among
    whom 95 % are to be inside, not frames.
    """
    known = [(f.point_inside_95, f.point_nees) for f in found if f.point_inside_95 and f.point_nees]
    if len(known) < 2:
        return
    inside, nees = (np.array(rows) for rows in zip(*known, strict=True))
    shown = Table("point:<15 | inside, of all sets:>19.1% | least:>6.0% | sets in 90 to 99 %:>18d | NEES:>5.1f")
    for i, name in enumerate(POINT_NAMES):
        within = (inside[:, i] >= 0.9) & (inside[:, i] <= 0.99)
        shown.row(name, np.nanmean(inside[:, i]), np.nanmin(inside[:, i]), int(within.sum()), np.nanmean(nees[:, i]))
    shown.row("all points", np.nanmean(inside), np.nanmin(inside), None, np.nanmean(nees))


def _without_offsets(track: Track, truth: np.ndarray) -> np.ndarray:
    rows = np.isfinite(track.points_world).all(axis=(1, 2))
    centred = metrics.without_offsets(track.points_world[rows], truth[rows])
    return 1e3 * metrics.point_errors(centred, truth[rows])


def _mean(values: np.ndarray) -> float | None:
    known = np.asarray(values, float)
    return float(np.nanmean(known)) if np.isfinite(known).any() else None


def main() -> None:
    """Print the table and the line of JSON."""
    given = parser(__doc__, quick="one set; with --first-pose fewer people, exact silhouettes only")
    given.add_argument("names", nargs="*", help="patterns in names of sets (walk_ring5top$); of --first-pose: sessions")
    given.add_argument("--products", type=Path, default=KEPT, help="where hulls are kept, and mesh people lie")
    study = given.add_mutually_exclusive_group()
    study.add_argument("--ablation", action="store_true", help="what each part of the tracker is worth, set by set")
    study.add_argument("--doubt", action="store_true", help="wrong limbs that are called, clear ones that are not")
    study.add_argument("--makers", action="store_true", help="people of several makers, by maker and rig")
    study.add_argument("--fast", action="store_true", help="error and lag of hands and feet, by their speed")
    study.add_argument("--smoothed", action="store_true", help="filter and smoother beside each other")
    study.add_argument("--first-pose", action="store_true", help="what the T-pose tells, and starts without one")
    given.add_argument("--offsets", action="store_true", help="with --makers: where their joints lie from the track's")
    add_settings(given)
    asked = given.parse_args()
    settings = parse_settings(asked.settings)
    if asked.first_pose:
        finish(first_pose([Path(name) for name in asked.names], asked.products, asked.quick))
        return
    chosen = recorded(asked.products, asked.names or ([QUICK] if asked.quick else []))
    if asked.ablation:
        finish(ablation(chosen))
    elif asked.doubt:
        finish(doubt(chosen, settings))
    elif asked.makers:
        finish(makers(chosen, settings, asked.offsets))
    elif asked.fast:
        finish(fast_motion(chosen, settings))
    elif asked.smoothed:
        finish(smoothed(chosen, settings))
    else:
        finish(whole_table(chosen, settings))


def whole_table(chosen: Iterable[Recorded], settings: dict[str, Any]) -> dict[str, dict[str, Any]]:
    """Track and judge the sets."""
    shown = Table(
        "set:<40 | frames:>7d | mean:>6.1f | -offset:>8.1f | > 200:>7.1% | tracked:>8.0%"
        " | inside:>7.1% | worst:>6.0% | ms:>5.2f | switches:>9d | ghosts:>7d"
    )
    table, every = dict[str, dict[str, Any]](), list[Figures]()
    for what in chosen:
        figures = judged(what, followed(what, settings))
        every.append(figures)
        table[what.name] = asdict(figures)
        shown.row(what.name, *list(table[what.name].values())[:COLUMNS])
        if figures.persons_mm:
            persons, ms = (", ".join(map(_text, part)) for part in (figures.persons_mm, figures.ms_by_persons or ()))
            print(f"{'':<40} each person, mm: {persons}; ms a set by persons: {ms}", flush=True)
    coverage_of_people(every)
    return table


def _text(value: float | None) -> str:
    return "-" if value is None else f"{value:.1f}"


if __name__ == "__main__":
    execute(main)
