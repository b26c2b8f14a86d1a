"""Step 2: which cameras are tied together. Two cameras are when both see the same target in the same frame."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence

import numpy as np
import numpy.typing as npt

from capture_rig.errors import InputError

from ..boards.board import TargetDetection

PoseKey = tuple[str, int]  # (target, frame): one pose of one target


def groups_of(cameras: Iterable[str], detections: Sequence[TargetDetection]) -> list[tuple[str, ...]]:
    """Find the groups of cameras that are linked by common views, largest first, names in order within each."""
    parent = {name: name for name in cameras}

    def root(name: str) -> str:
        while parent[name] != name:
            name = parent[name]
        return name

    first: dict[PoseKey, str] = {}
    for detection in detections:
        other = first.setdefault((detection.target, detection.frame_index), detection.camera)
        low, high = sorted((root(detection.camera), root(other)))
        parent[high] = low
    members: dict[str, list[str]] = {}
    for name in sorted(parent):
        members.setdefault(root(name), []).append(name)
    return sorted((tuple(group) for group in members.values()), key=lambda group: (-len(group), group))


def common_frames(detections: Sequence[TargetDetection]) -> dict[tuple[str, str], int]:
    """Count how many poses of targets each pair of cameras (in name order) shares; pairs that share none are left
    out."""
    seen: dict[PoseKey, list[str]] = {}
    for detection in detections:
        seen.setdefault((detection.target, detection.frame_index), []).append(detection.camera)
    counts: dict[tuple[str, str], int] = {}
    for cameras in seen.values():
        names = sorted(cameras)
        for i, a in enumerate(names):
            for b in names[i + 1 :]:
                counts[a, b] = counts.get((a, b), 0) + 1
    return dict(sorted(counts.items()))


def require_connected(
    cameras: Iterable[str], detections: Sequence[TargetDetection], lost: Mapping[str, str] | None = None
) -> None:
    """Raise InputError naming cameras that see no target, or the groups of cameras that share no view.

    ``lost`` tells, by camera, why detections that would have linked it were left out.
    """
    names, reasons = sorted(cameras), lost or {}
    blind = sorted(set(names) - {detection.camera for detection in detections})
    why = "".join(f" Left out for {name}: {reasons[name]}." for name in blind or names if name in reasons)
    if blind:
        raise InputError(
            f"{', '.join(blind)}: no picture that can be used shows a target.{why}",
            remedy="Show the board to it, or leave that camera out.",
        )
    groups = groups_of(names, detections)
    if len(groups) > 1:
        listed = " | ".join(", ".join(group) for group in groups)
        raise InputError(
            f"these groups of cameras share no view: {listed}.{why}",
            remedy="Show the board where cameras of both groups see it in the same frame.",
        )


def most_seen(detections: Sequence[TargetDetection], targets: Sequence[str]) -> str:
    """Find the target with the most detections: the one that the others' sizes are compared with."""
    counts = {name: sum(detection.target == name for detection in detections) for name in targets}
    return max(sorted(counts), key=lambda name: counts[name])


def comparable_targets(
    detections: Sequence[TargetDetection], targets: Sequence[str], base: str
) -> npt.NDArray[np.bool_]:
    """Mark (k,) the targets whose size the views tell beside that of ``base``, which is not among them.

    So it is when two cameras that are linked by targets of known size saw the target in the same frame.
    """
    known, changed = {base}, True
    cameras = sorted({detection.camera for detection in detections})
    while changed:
        groups = groups_of(cameras, [detection for detection in detections if detection.target in known])
        more = {name for name in targets if name not in known and _seen_within(name, detections, groups)}
        known, changed = known | more, bool(more)
    return np.array([name in known and name != base for name in targets])


def _seen_within(target: str, detections: Sequence[TargetDetection], groups: Sequence[tuple[str, ...]]) -> bool:
    group = {camera: index for index, members in enumerate(groups) for camera in members}
    seen = [(detection.frame_index, group[detection.camera]) for detection in detections if detection.target == target]
    return len(set(seen)) < len(seen)
