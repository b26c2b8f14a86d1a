"""Several persons: the studio's people meet, hug, leave and come back; two rendered persons; what each person costs.

    python bench/people_together.py [NAME ...] [--products FOLDER] [--set NODE.PARAMETER=VALUE ...] [--quick]

Scenes of the virtual studio (virtual_studio/motions/together.py) by people of four sizes, exact silhouettes, with 4, 6
and 8 cameras, and the session two_ring8 of the test data with its own silhouettes and exact ones. Start and settings
are the defaults. Hulls are carved once and kept in FOLDER (output/people_together): empty it after a change of cameras
or hull.

Columns: the truth and the numbers that its person was given; mean error of the 15 points where the rig shows them, mm,
and without constant offsets; share of frames with a point over 200 mm; share of the errors inside the track's 95 %
ellipsoids; frames tracked; identity switches. Below each: frames in which somebody is followed who is nobody, and ms of
fit and filter a set (processor time) by the number of persons that have a filtered state. The last line is JSON.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

from report import Table, add_settings, execute, finish, parser

import numpy as np
from clips import Clip, Recorded, load, session_clip
from scenes import SHARED, together_clip

from capture_rig.session import Truth
from capture_rig.visibility import RigVisibility
from mocap_pipeline.configuration import Configuration
from mocap_pipeline.pipeline import BodyFollower
from sagoma_tools.arguments import parse_settings
from sagoma_tools.evaluation.people import PeopleScores, score_people
from sagoma_tools.evaluation.scores import number
from sagoma_tools.evaluation.track import Track
from virtual_studio.people import people_of_sizes

KEPT = Path("output/people_together")
SCENES = {"meeting": (2, (4, 6, 8)), "coming_later": (2, (4, 6, 8)), "going_first": (2, (4, 6, 8)), "crowd": (4, (8,))}
"""Scene: persons in it, and with how many cameras it is seen."""
SETTLED = 20
"""Sets with as many persons that are not timed: compiled code is loaded."""


def sets() -> Iterator[tuple[str, Callable[[], Clip]]]:
    """Every set, and what makes its silhouettes."""
    for scene, (persons, rigs) in SCENES.items():
        for cameras in rigs:
            yield (
                f"{scene}_{cameras}",
                lambda scene=scene, n=persons, cameras=cameras: together_clip(scene, people_of_sizes(n), cameras),  # type: ignore[misc]
            )
    folder = SHARED / "sessions" / "two_ring8"
    if folder.is_dir():
        yield "two_ring8", lambda: session_clip(folder, exact=False)
        yield "two_ring8_exact", lambda: session_clip(folder, exact=True)


def recorded(folder: Path, only: list[str]) -> Iterator[Recorded]:
    """The sets chosen, carved and kept where they are not there yet."""
    for name, make in sets():
        if only and not any(part in name for part in only):
            continue
        path = folder / f"{name}.pkl"
        if not path.is_file():
            Recorded.of(make()).save(path)
        yield load(path)


def followed(what: Recorded, settings: dict[str, Any]) -> tuple[dict[int, Track], dict[int, float]]:
    """Every person's track by number, and ms a set by the number of persons that have a state."""
    configuration = Configuration.of({"hull_server.backend": "cpu", **what.start, **settings})
    follower = BodyFollower.of(configuration, what.rig)
    rows: dict[int, list[tuple[int, Any]]] = {}
    ms: dict[int, list[float]] = {}
    for frame, products in enumerate(what.products):
        began = time.process_time()
        people = follower.step(products).people
        took_ms = 1e3 * (time.process_time() - began)
        there = [person for person in people if person.state is not None]
        ms.setdefault(len(there), []).append(took_ms)
        for person in there:
            rows.setdefault(person.person, []).append((frame, person.state))
    means = {persons: float(np.mean(took[SETTLED:])) for persons, took in sorted(ms.items()) if len(took) > SETTLED}
    return {person: Track.of_states(states) for person, states in rows.items()}, means


def scored(what: Recorded, tracks: dict[int, Track]) -> PeopleScores:
    """The scores of everybody in a set."""
    truths = [Truth(np.arange(len(t)), t, None, 1.0, Path(what.name)) for t in what.truths]
    return score_people(tracks, truths, what.fps, RigVisibility(what.rig))


def main() -> None:
    """Print a row a person, and the line of JSON."""
    given = parser(__doc__, "the two-person scenes with six cameras alone")
    given.add_argument("names", nargs="*", help="parts of names of sets; default: all")
    given.add_argument("--products", type=Path, default=KEPT, help="where hulls are kept")
    add_settings(given)
    arguments = given.parse_args()
    only = arguments.names or (["_6"] if arguments.quick else [])
    shown = Table(
        "set:<18 | truth:>5d | numbers:>7 | mean:>6.1f | -offset:>8.1f | > 200:>7.1% | inside:>7.1%"
        " | frames:>7d | switches:>9d"
    )
    table: dict[str, Any] = {}
    for what in recorded(arguments.products, only):
        tracks, ms = followed(what, parse_settings(arguments.settings))
        people = scored(what, tracks)
        for person in people.persons:
            of, numbers = person.scores, "+".join(map(str, person.numbers)) or "-"
            figures = [None] * 4 + [0] if of is None else [
                of.mean_mm, of.mean_mm_without_offset, of.over_200mm, of.inside_95, of.tracked
            ]  # fmt: skip
            shown.row(what.name, person.truth + 1, numbers, *figures, person.switches)
        costs = ", ".join(f"{persons}: {took:.2f}" for persons, took in ms.items())
        print(f"{'':<18} with nobody in {people.ghost_frames} frames; ms a set by persons: {costs}", flush=True)
        table[what.name] = {
            "mean_mm": [None if p.scores is None else number(p.scores.mean_mm, 1) for p in people.persons],
            "over_200mm": [None if p.scores is None else number(p.scores.over_200mm) for p in people.persons],
            "switches": people.switches,
            "ghost_frames": people.ghost_frames,
            "ms": {str(persons): number(took, 2) for persons, took in ms.items()},
        }
    finish(table)


if __name__ == "__main__":
    execute(main)
