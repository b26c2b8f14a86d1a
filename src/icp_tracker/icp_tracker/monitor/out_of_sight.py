"""Limbs that reach beyond what the rig shows: outside the volume, or where too few cameras see.

There a hull ends although the body goes on, so a set says nothing about such a limb, and what is left over of the hull
nearby belongs to something else. It is doubtful at once, not after its rays have gone.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from capture_rig.visibility import UnseenCells
from mocap_packets.fit import DOUBTFUL, GOOD, PART_NAMES, PART_OF_POINT, TrackQuality
from stick_figure.skeleton import TORSO_POINTS

from .evidence import PART_OF_STICK, PARTS, TRUNK, Evidence
from .pose_library import LIMB_POINTS, LIMBS
from .track_quality import Baseline

SHOWN_SHARE = 0.5  # of the rays that a part usually has: one that has so many is in sight
TRUNK_POINTS = 3  # of the trunk's seven: so many out of sight leave its place open


def points_out_of_sight(
    points_world: np.ndarray, expected_world: np.ndarray | None, unseen: UnseenCells, shown: np.ndarray
) -> np.ndarray:
    """Return the points (15,) bool that lie where no hull shows a body, but for those of ``shown`` parts (5,).

    A limb counts where it was expected on the trunk (15, 3), too: a fit draws it to what is in sight.
    """
    hidden = unseen.at(points_world)
    if expected_world is not None:
        hidden |= unseen.at(expected_world)
    return np.asarray(hidden & ~shown[PART_OF_POINT])


def shown_parts(evidence: Evidence, baseline: Baseline) -> np.ndarray:
    """Return the parts (5,) bool of the body that explain about as many rays as usual."""
    explained, usual = (np.bincount(PART_OF_STICK, rays, PARTS) for rays in (evidence.explained, baseline.rays))
    return np.asarray(explained > SHOWN_SHARE * usual)


def limbs_of_points(points: np.ndarray) -> np.ndarray:
    """Return the limbs (4,) bool that one of the points (15,) bool belongs to."""
    return np.asarray(points[LIMB_POINTS].any(axis=1))


def is_cut(hidden: np.ndarray) -> bool:
    """Return whether so much of the body is out of sight, by its points (15,) bool, that the rest does not tell what
    the whole does: the trunk, or two limbs."""
    return bool(hidden[TORSO_POINTS].sum() >= TRUNK_POINTS or limbs_of_points(hidden).sum() > 1)


def with_hidden_parts(quality: TrackQuality, hidden: np.ndarray) -> TrackQuality:
    """Return the quality with the parts doubtful whose points (15,) bool are out of sight."""
    if not hidden.any():
        return quality
    parts, reasons = list(quality.parts), [quality.reason] if quality.reason else []
    out = {limb.part for limb, beyond in zip(LIMBS, limbs_of_points(hidden), strict=True) if beyond}
    if hidden[TORSO_POINTS].sum() >= TRUNK_POINTS:
        out.add(TRUNK)
    for part in sorted(out):
        if parts[part] == GOOD:
            parts[part] = DOUBTFUL
            reasons.append(f"{PART_NAMES[part]}: beyond what the cameras show")
    if tuple(parts) == quality.parts:
        return quality
    return replace(quality, state=DOUBTFUL, parts=tuple(parts), reason="; ".join(reasons))
