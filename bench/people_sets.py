"""The sets of bench/people.py: clips of people, carved once and kept; tracks them."""

from __future__ import annotations

import re
import time
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from clips import Clip, Recorded, load, session_clip
from scenes import SHARED, studio_clip, together_clip

from mocap_packets.state import BodyState
from mocap_pipeline.configuration import Configuration
from mocap_pipeline.pipeline import TrackingStage
from sagoma_tools.evaluation.track import Track
from virtual_studio.motions.catalogue import HARD_CASES
from virtual_studio.people import people_of_sizes, person_of

KEPT = Path("output/people")
BUILDS = ((1.60, 0.85, 1.0, 1.0), (1.88, 1.2, 1.0, 1.0), (1.75, 1.0, 1.0, 1.0), (1.68, 1.3, 0.95, 1.03),
          (1.82, 0.9, 1.05, 0.97))  # fmt: skip
"""Stature, m; build; length of arms and legs, over the average's."""
TOUR_S = 8.0
TOGETHER = {
    "meeting": (2, (4, 6, 8)),
    "coming_later": (2, (4, 6, 8)),
    "going_first": (2, (4, 6, 8)),
    "crowd": (4, (8,)),
}
"""Scene of several people: how many, and with how many cameras it is seen."""
SETTLED = 20  # sets with as many persons that are not timed: compiled code is loaded


def sets() -> Iterator[tuple[str, Callable[[], Clip]]]:
    """Every set that can be made from the test data and the studio, and what makes its silhouettes."""
    rendered = SHARED / "sessions"
    for folder in [*sorted(rendered.glob("*/")), SHARED / "real_4cam"]:
        if not folder.is_dir():
            continue
        yield folder.name, partial(session_clip, folder, exact=False)
        if folder.parent == rendered:
            yield f"{folder.name}_exact", partial(session_clip, folder, exact=True)
    for stature, build, *lengths in BUILDS:
        name = f"studio_tour_6_{stature:.2f}_{build:g}_{lengths[0]:g}_{lengths[1]:g}"
        yield name, partial(studio_clip, "tour", TOUR_S, 6, person_of(stature, *lengths), build)
    for case, motion in HARD_CASES.items():
        yield f"studio_{case}_6_1.75_1_1_1", partial(studio_clip, case, motion.duration_s, 6)
    for scene, (persons, rigs) in TOGETHER.items():
        for cameras in rigs:
            yield f"together_{scene}_{cameras}", partial(together_clip, scene, people_of_sizes(persons), cameras)


def recorded(folder: Path, only: list[str]) -> Iterator[Recorded]:
    """The sets with one of the patterns ``only`` in their names: those kept in the folder, the others made and kept."""
    makers = dict(sets())
    kept = {path.stem for path in folder.glob("*.pkl")}
    for name in [*makers, *sorted(kept - set(makers))]:
        if only and not any(re.search(part, name) for part in only):
            continue
        path = folder / f"{name}.pkl"
        if name not in kept:
            Recorded.of(makers[name]()).save(path)
        yield load(path)


def follower_of(what: Recorded, settings: dict[str, Any]) -> TrackingStage:
    """Tracker and filter for a set, from its first frame on."""
    return TrackingStage.of(Configuration.of({"hull_server.backend": "cpu", **what.start, **settings}), what.rig)


States = list[tuple[int, BodyState, tuple[float, ...]]]
"""Frame, the first person's filtered state, and the log odds that each part of the body is elsewhere or unseen."""


def states_of(what: Recorded, follower: TrackingStage) -> States:
    """Track the first person of a set, in the frames that have a state."""
    steps = enumerate(map(follower.step, what.products[: len(what.truths[0])]))
    return [(frame, step.state, step.fit.quality.log_odds) for frame, step in steps if step.state is not None]


class Followed(NamedTuple):
    """Every person's track by number; processor time of fit and filter, ms a set, over all sets and, of several, by
    the number of persons that have a filtered state (from one on; None where there were hardly any such sets)."""

    tracks: dict[int, Track]
    ms: float
    ms_by_persons: list[float | None]


def followed(what: Recorded, settings: dict[str, Any]) -> Followed:
    """Track a set."""
    follower = follower_of(what, settings)
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
    every = [took for of_number in ms.values() for took in of_number]
    settled = [ms.get(persons, [])[SETTLED:] for persons in range(1, max(ms, default=0) + 1)]
    means = [round(float(np.mean(took)), 2) if took else None for took in settled]
    tracks = {number: Track.of_states(states) for number, states in rows.items()}
    return Followed(tracks, float(np.mean(every or [0.0])), means)
