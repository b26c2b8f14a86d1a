"""Which targets' sizes can be compared: a check of the sizes that were given."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from ..boards.sighting import Sighting
from .view_graph import groups_of


def most_seen(sightings: Sequence[Sighting], targets: Sequence[str]) -> str:
    """The target with the most sightings: the one that the others' sizes are compared with."""
    counts = {name: sum(sighting.target == name for sighting in sightings) for name in targets}
    return max(sorted(counts), key=lambda name: counts[name])


def comparable_targets(sightings: Sequence[Sighting], targets: Sequence[str], base: str) -> npt.NDArray[np.bool_]:
    """(k,) the targets whose size the views tell beside that of ``base``, which is not among them.

    So it is when two cameras that are linked by targets of known size saw the target at the same moment.
    """
    known, changed = {base}, True
    cameras = sorted({sighting.camera for sighting in sightings})
    while changed:
        groups = groups_of(cameras, [sighting for sighting in sightings if sighting.target in known])
        more = {name for name in targets if name not in known and _seen_within(name, sightings, groups)}
        known, changed = known | more, bool(more)
    return np.array([name in known and name != base for name in targets])


def _seen_within(target: str, sightings: Sequence[Sighting], groups: Sequence[tuple[str, ...]]) -> bool:
    group = {camera: index for index, members in enumerate(groups) for camera in members}
    seen = [(sighting.moment, group[sighting.camera]) for sighting in sightings if sighting.target == target]
    return len(set(seen)) < len(seen)
