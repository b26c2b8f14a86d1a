"""Step 2: do the cameras hang together? Two cameras do when both see the same target at the same moment."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence

from capture_rig.errors import InputError

from ..boards.sighting import Sighting

Key = tuple[str, int]  # (target, moment): one pose of one target


def groups_of(cameras: Iterable[str], sightings: Sequence[Sighting]) -> list[tuple[str, ...]]:
    """The groups of cameras that are linked by common views, largest first, names in order within each."""
    parent = {name: name for name in cameras}

    def root(name: str) -> str:
        while parent[name] != name:
            name = parent[name]
        return name

    first: dict[Key, str] = {}
    for sighting in sightings:
        other = first.setdefault((sighting.target, sighting.moment), sighting.camera)
        low, high = sorted((root(sighting.camera), root(other)))
        parent[high] = low
    members: dict[str, list[str]] = {}
    for name in sorted(parent):
        members.setdefault(root(name), []).append(name)
    return sorted((tuple(group) for group in members.values()), key=lambda group: (-len(group), group))


def common_moments(sightings: Sequence[Sighting]) -> dict[tuple[str, str], int]:
    """How many poses of targets each pair of cameras (in name order) shares; pairs that share none are left out."""
    seen: dict[Key, list[str]] = {}
    for sighting in sightings:
        seen.setdefault((sighting.target, sighting.moment), []).append(sighting.camera)
    counts: dict[tuple[str, str], int] = {}
    for cameras in seen.values():
        names = sorted(cameras)
        for i, a in enumerate(names):
            for b in names[i + 1 :]:
                counts[a, b] = counts.get((a, b), 0) + 1
    return dict(sorted(counts.items()))


def require_connected(
    cameras: Iterable[str], sightings: Sequence[Sighting], lost: Mapping[str, str] | None = None
) -> None:
    """Raises InputError naming cameras that see no target, or the groups of cameras that share no view.

    ``lost`` tells, by camera, why sightings that would have linked it were left out.
    """
    names, reasons = sorted(cameras), lost or {}
    blind = sorted(set(names) - {sighting.camera for sighting in sightings})
    why = "".join(f" Left out for {name}: {reasons[name]}." for name in blind or names if name in reasons)
    if blind:
        raise InputError(
            f"{', '.join(blind)}: no picture that can be used shows a target.{why}",
            remedy="Show the board to it, or leave that camera out.",
        )
    groups = groups_of(names, sightings)
    if len(groups) > 1:
        listed = " | ".join(", ".join(group) for group in groups)
        raise InputError(
            f"these groups of cameras share no view: {listed}.{why}",
            remedy="Show the board where cameras of both groups see it at the same moment.",
        )
