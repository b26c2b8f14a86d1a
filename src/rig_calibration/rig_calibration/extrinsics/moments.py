"""Which moments of a carried board to use: shared by cameras, all over the volume, the board moving slowly."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from itertools import combinations, pairwise

import numpy as np
import numpy.typing as npt

from ..boards.sighting import Sighting

Array = npt.NDArray[np.float64]
Feature = tuple[str | int, ...]

MOST_MOMENTS = 120
CELLS = 4
"""An image is divided into so many cells along its width and along its height."""
PAIR_WEIGHT = 2.0
"""What two cameras share ties them together; where in the image it is helps less."""


def group_by_moment(sightings: Iterable[Sighting]) -> dict[int, list[Sighting]]:
    """Sightings by moment, ascending; in each, by camera's name."""
    groups: dict[int, list[Sighting]] = {}
    for sighting in sorted(sightings, key=lambda sighting: (sighting.moment, sighting.camera)):
        groups.setdefault(sighting.moment, []).append(sighting)
    return groups


def choose_moments(sightings: Sequence[Sighting], most: int = MOST_MOMENTS) -> tuple[int, ...]:
    """At most ``most`` of the moments that two or more cameras see, ascending.

    Greedily the one that adds most: pairs of cameras and cells of their images that few of the chosen have, each worth
    less the more often it is there. A board that moved fast counts less (exposure and synchronisation smear it). Of
    equal ones the earliest: the same sightings, in any order, give the same choice.
    """
    groups = {moment: group for moment, group in group_by_moment(sightings).items() if _cameras(group) >= 2}
    if len(groups) <= most:
        return tuple(groups)
    calm = _calmness(groups)
    features = {moment: _features(group) for moment, group in groups.items()}
    seen: Counter[Feature] = Counter()
    chosen: list[int] = []
    while len(chosen) < most:
        best = max(features, key=lambda moment: (calm[moment] * _gain(features[moment], seen), -moment))
        chosen.append(best)
        seen.update(features.pop(best))
    return tuple(sorted(chosen))


def speeds_px(sightings: Iterable[Sighting]) -> dict[tuple[str, int], float]:
    """How far the board moves a frame (median over its corners, px), by camera and moment: the slower of the way from
    the moment before and to the moment after. Missing where a camera saw the board only once."""
    by_camera: dict[str, list[Sighting]] = {}
    for sighting in sorted(sightings, key=lambda sighting: (sighting.camera, sighting.moment)):
        by_camera.setdefault(sighting.camera, []).append(sighting)
    speeds: dict[tuple[str, int], float] = {}
    for camera, track in by_camera.items():
        for one, two in pairwise(track):
            speed = way_px(one, two) / (two.moment - one.moment)
            for moment in (one.moment, two.moment):
                speeds[camera, moment] = min(speed, speeds.get((camera, moment), np.inf))
    return {key: speed for key, speed in speeds.items() if np.isfinite(speed)}


def way_px(one: Sighting, two: Sighting) -> float:
    """How far the board moved between two sightings of one camera: median over the corners both show, px."""
    _, here, there = np.intersect1d(one.ids, two.ids, return_indices=True)
    way = np.linalg.norm(one.pixels[here] - two.pixels[there], axis=1)
    return float(np.median(way)) if len(way) else float("inf")


def _cameras(group: Sequence[Sighting]) -> int:
    return len({sighting.camera for sighting in group})


def _calmness(groups: Mapping[int, Sequence[Sighting]]) -> dict[int, float]:
    """1 for a board at rest, a half at the usual speed, towards 0 when it is swung."""
    speeds = speeds_px(sighting for group in groups.values() for sighting in group)
    usual = max(float(np.median(list(speeds.values()))), 1e-3) if speeds else 1.0
    fastest = {m: max(speeds.get((s.camera, m), usual) for s in group) for m, group in groups.items()}
    return {moment: 1.0 / (1.0 + speed / usual) for moment, speed in fastest.items()}


def _features(group: Sequence[Sighting]) -> tuple[Feature, ...]:
    cells = [(sighting.camera, *_cell(sighting)) for sighting in group]
    return (*combinations(sorted({sighting.camera for sighting in group}), 2), *cells)


def _cell(sighting: Sighting) -> tuple[int, int]:
    column, row = sighting.pixels.mean(axis=0) / sighting.image_size * CELLS
    return int(column), int(row)


def _gain(features: Sequence[Feature], seen: Counter[Feature]) -> float:
    return sum((PAIR_WEIGHT if len(feature) == 2 else 1.0) / (1 + seen[feature]) for feature in features)
