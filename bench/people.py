"""One table over everybody there is to track: test data, the studio's people, hard cases, rendered mesh people.

    python bench/people.py [NAME ...] [--products FOLDER] [--pictures FOLDER] [--set NODE.PARAMETER=VALUE ...]

Tracks every set (those with a NAME in theirs) with automatic start and default settings: each session of the test data
with its own silhouettes and, as _exact, with exact ones; the studio's tour by five people and its hard cases; and what
`bench/mesh_people.py` put into FOLDER (mesh_fit_: constants may have been fitted to them; mesh_prove_: never).

The hulls are carved once and kept in FOLDER (output/people): empty it after a change of cameras or hull.

Columns: frames in which a person is wholly inside the volume; mean error of the 15 points, mm, and without each point's
constant offset in the pelvis's frame; share of tracked frames with a point over 200 mm; share of frames tracked; share
of errors inside the track's own 95 % ellipsoids, all and of the worst point; processor time of fit and filter, ms a set
(with the start, and compiled code that is loaded in the first sets); identity switches and tracks of nobody where there
are several persons (figures: all persons' together). A second table holds the covariances point by point over all sets.
The last line is JSON. What is called doubtful: `bench/doubt.py`.
--pictures draws the worst frame of every set with a point over 200 mm from the first person's side: silhouettes, which
must lie in FOLDER/../clips as `bench/mesh_people.py` writes them, truth in white, track in colour.
"""

from __future__ import annotations

import pickle
import time
from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from report import Table, add_settings, execute, finish, parser

import cv2
import numpy as np
from products import Recorded, load
from scenes import SHARED, Clip, inside_volume, session_clip, studio_clip

from capture_rig.session import Truth
from mocap_pipeline.configuration import Configuration
from mocap_pipeline.pipeline import BodyFollower
from sagoma_tools.arguments import parse_settings
from sagoma_tools.evaluation.people import score_people
from sagoma_tools.evaluation.scores import covariance_coverage
from sagoma_tools.evaluation.track import Track
from sagoma_tools.overlays import Window, montage, overlay
from stick_figure import metrics
from stick_figure.skeleton import POINT_NAMES
from virtual_studio.motions.catalogue import HARD_CASES
from virtual_studio.people import person_of

KEPT = Path("output/people")
BAD_MM = 1e3 * metrics.LARGE_ERROR_M
CLOSE_UP_PX = 240
BUILDS = ((1.60, 0.85, 1.0, 1.0), (1.88, 1.2, 1.0, 1.0), (1.75, 1.0, 1.0, 1.0), (1.68, 1.3, 0.95, 1.03),
          (1.82, 0.9, 1.05, 0.97))  # fmt: skip
"""Stature, m; build; length of arms and legs, over the average's."""
TOUR_S = 8.0
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


def sets() -> Iterator[tuple[str, Callable[[], Clip]]]:
    """Every set that can be made from the test data and the studio, and what makes its silhouettes."""
    rendered = SHARED / "sessions"
    for folder in [*sorted(rendered.glob("*/")), SHARED / "real_4cam"]:
        if not folder.is_dir():
            continue
        yield folder.name, lambda folder=folder: session_clip(folder, exact=False)  # type: ignore[misc]
        if folder.parent == rendered:
            yield f"{folder.name}_exact", lambda folder=folder: session_clip(folder, exact=True)  # type: ignore[misc]
    for stature, build, arms, legs in BUILDS:
        person = person_of(stature, arms, legs)
        yield (
            f"studio_tour_6_{stature:.2f}_{build:g}_{arms:g}_{legs:g}",
            lambda person=person, build=build: studio_clip("tour", TOUR_S, 6, person, build),  # type: ignore[misc]
        )
    for case, motion in HARD_CASES.items():
        yield (
            f"studio_{case}_6_1.75_1_1_1",
            lambda case=case, motion=motion: studio_clip(case, motion.duration_s, 6),  # type: ignore[misc]
        )


def recorded(folder: Path, only: list[str]) -> Iterator[Recorded]:
    """The sets chosen: those kept in the folder, the others made and kept."""
    makers = dict(sets())
    kept = {path.stem for path in folder.glob("*.pkl")}
    for name in [*makers, *sorted(kept - set(makers))]:
        if only and not any(part in name for part in only):
            continue
        path = folder / f"{name}.pkl"
        if name not in kept:
            Recorded.of(makers[name]()).save(path)
        yield load(path)


def followed(what: Recorded, settings: dict[str, Any]) -> tuple[dict[int, Track], float]:
    """Every person's track by number, and the processor time of fit and filter, ms a set."""
    configuration = Configuration.of({"hull_server.backend": "cpu", **what.start, **settings})
    follower = BodyFollower.of(configuration, what.rig)
    rows: dict[int, list[tuple[int, Any]]] = {}
    began = time.process_time()
    for frame, products in enumerate(what.products):
        for person in follower.step(products).people:
            if person.state is not None:
                rows.setdefault(person.person, []).append((frame, person.state))
    ms = 1e3 * (time.process_time() - began) / max(len(what.products), 1)
    return {number: Track.of_states(states) for number, states in rows.items()}, ms


def judged(what: Recorded, tracks: dict[int, Track], ms: float) -> Figures:
    """The figures of all persons together."""
    truths = [Truth(np.arange(len(t)), t, None, 1.0, Path(what.name)) for t in what.truths]
    known = [np.flatnonzero(inside_volume(what.rig, t)) for t in what.truths]
    frames = sum(map(len, known))
    several = len(truths) > 1
    people = score_people(tracks, truths, what.fps) if several else None
    owned = [p.numbers[:1] for p in people.persons] if people else [tuple(sorted(tracks))[:1]]
    pairs = [
        (tracks[numbers[0]].at(rows), truth.points_world[rows])
        for numbers, truth, rows in zip(owned, truths, known, strict=True)
        if numbers
    ]
    switches, ghosts = (people.switches, people.ghost_frames) if people else (None, None)
    if not pairs:
        return Figures(frames, *[None] * 3, 0.0, *[None] * 2, ms, switches, ghosts)  # type: ignore[arg-type]
    errors = np.concatenate([track.points_world - truth for track, truth in pairs])
    distances = 1e3 * np.linalg.norm(errors, axis=2)
    tracked = np.isfinite(distances).any(axis=1)
    worst = np.where(tracked, np.nan_to_num(distances, nan=-1.0).max(axis=1), np.nan)
    coverage = covariance_coverage(errors, np.concatenate([track.covariance for track, _ in pairs]))
    return Figures(
        frames,
        _mean(distances),
        _mean(np.concatenate([_without_offsets(*pair) for pair in pairs])),
        _mean((worst > BAD_MM)[tracked]),
        float(tracked.sum() / frames),
        coverage.inside_95,
        float(np.nanmin(coverage.point_inside_95)),
        ms,
        switches,
        ghosts,
        tuple(coverage.point_inside_95.tolist()),
        tuple(coverage.point_nees.tolist()),
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


def draw(what: Recorded, clip: Clip, track: Track, path: Path) -> None:
    """Draws the worst frame of the first person's track, close up, in every camera."""
    aligned = track.at(np.arange(len(what.truths[0])))
    distances = np.linalg.norm(aligned.points_world - what.truths[0], axis=2).max(axis=1)
    frame = int(np.nanargmax(distances))
    if 1e3 * distances[frame] <= BAD_MM:
        return
    estimate, truth = aligned.points_world[frame], what.truths[0][frame]
    pictures = []
    for camera in (model.undistorted_view().camera for model in what.rig.cameras):
        window = Window.around(camera, np.concatenate([estimate, truth]), CLOSE_UP_PX)
        image = np.where(clip.mask(frame, camera.name) > 0, np.uint8(140), np.uint8(40))
        pictures.append(overlay(camera, image, estimate, truth, window))
    path.parent.mkdir(parents=True, exist_ok=True)
    cv2.imwrite(str(path), montage(pictures, columns=len(pictures)))
    print(f"{path}: frame {frame}, {POINT_NAMES[int(np.argmax(np.linalg.norm(estimate - truth, axis=1)))]}")


def _number_of_first(what: Recorded, tracks: dict[int, Track]) -> int:
    """The number under which the first person is followed."""
    truths = [Truth(np.arange(len(t)), t, None, 1.0, Path(what.name)) for t in what.truths]
    return next(iter(score_people(tracks, truths, what.fps).persons[0].numbers), min(tracks))


def _without_offsets(track: Track, truth: np.ndarray) -> np.ndarray:
    rows = np.isfinite(track.points_world).all(axis=(1, 2))
    centred = metrics.without_offsets(track.points_world[rows], truth[rows])
    return 1e3 * metrics.point_errors(centred, truth[rows])


def _mean(values: np.ndarray) -> float | None:
    known = np.asarray(values, float)
    return float(np.nanmean(known)) if np.isfinite(known).any() else None


def main() -> None:
    """Print the table and the line of JSON."""
    given = parser(__doc__)
    given.add_argument("names", nargs="*", help="parts of names of sets; default: all")
    given.add_argument("--products", type=Path, default=KEPT, help="where hulls are kept, and mesh people lie")
    given.add_argument("--pictures", type=Path, help="folder for the worst frames")
    add_settings(given)
    arguments = given.parse_args()
    settings = parse_settings(arguments.settings)
    shown = Table(
        "set:<40 | frames:>7d | mean:>6.1f | -offset:>8.1f | > 200:>7.1% | tracked:>8.0%"
        " | inside:>7.1% | worst:>6.0% | ms:>5.2f | switches:>9d | ghosts:>7d"
    )
    table, found = dict[str, dict[str, Any]](), list[Figures]()
    for what in recorded(arguments.products, arguments.names):
        tracks, ms = followed(what, settings)
        figures = judged(what, tracks, ms)
        silhouettes = arguments.products.parent / "clips" / f"{what.name}.pkl"
        if arguments.pictures and tracks and silhouettes.is_file():
            draw(
                what,
                pickle.loads(silhouettes.read_bytes()),
                tracks[_number_of_first(what, tracks)],
                arguments.pictures / f"{what.name}.png",
            )
        found.append(figures)
        table[what.name] = asdict(figures)
        shown.row(what.name, *list(table[what.name].values())[:COLUMNS])
    coverage_of_people(found)
    finish(table)


if __name__ == "__main__":
    execute(main)
