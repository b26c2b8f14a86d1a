"""Truncation of a body by the volume and the views: which parts are cut off, which camera misses them, where to step.

Outside the volume, and where too few cameras see, a hull ends although the body goes on. Parts that are cut there must
not be measured.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from capture_rig.visibility import RigVisibility
from stick_figure.body import TYPICAL_STATURE_M

FEET, HEAD, LEFT_HAND, RIGHT_HAND, BODY = "feet", "head", "left hand", "right hand", "body"

# Thresholds: measured by python bench/people.py --first-pose (what is refused, what is started wrongly).
TRIMMED = 0.2  # per cent of the voxels that may be stray at either end
SAGGING_M, FEET_LOST_M = 0.08, 0.6  # a hull sags this far below the soles; one that ends at the knees may lack feet
COLUMN_M = 0.23  # greatest distance of the crown from the body's middle
REACH_VOXELS = 1.5  # from a voxel's centre to the place that must be visible for the hull to continue
FEWEST_CUT = 5  # voxels (of some 3000 samples of a body) that make a cut
FEET_TO, HEAD_FROM = 0.45, 0.90  # heights over the stature: a cut below the first lacks feet
HANDS = (LEFT_HAND, RIGHT_HAND)
TIP_M, TIP_CUT = 0.06, 0.33  # two cells of the hull and half a hand; least share of a tip that a cut removes
TRUNK_REACH = 0.16  # over the stature: farther from the spine are arms
# places of a T-pose over the stature: ahead, to the left, up (Drillis & Contini 1966: feet .152 long, span about 1)
ANKLES_APART, TOES, HEEL, SOLE, FINGERS, SHOULDERS, CROWN, DEEP = 0.07, 0.11, -0.05, 0.015, 0.50, 0.81, 1.01, 0.08


@dataclass(frozen=True, eq=False)
class Stance:
    """A standing person: place (2,) m, forward (2,) unit or its opposite, floor and stature m."""

    place_world: np.ndarray
    forward_world: np.ndarray
    floor_world: float
    stature: float

    def places_of(self, parts: tuple[str, ...]) -> np.ndarray:
        """Return points (k, 3) about parts of a T-pose in this stance, of all parts for BODY, world, metres."""
        ahead = np.array([*self.forward_world, 0.0])
        left, up = np.array([-ahead[1], ahead[0], 0.0]), np.array([0.0, 0.0, 1.0])
        origin = np.array([*self.place_world, self.floor_world])
        local = np.concatenate([_T_POSE[part] for part in (_T_POSE if BODY in parts else parts)]) * self.stature
        return np.asarray(origin + local @ np.array([ahead, left, up]))


_T_POSE = {
    FEET: np.array([[x, y, SOLE] for x in (HEEL, TOES) for y in (-ANKLES_APART, ANKLES_APART)]),
    HEAD: np.array([[x, y, z] for x in (-DEEP, DEEP) for y in (-0.05, 0.05) for z in (0.93, CROWN)]),
    LEFT_HAND: np.array([[0.0, y, SHOULDERS] for y in (FINGERS - 0.06, FINGERS)]),
    RIGHT_HAND: np.array([[0.0, -y, SHOULDERS] for y in (FINGERS - 0.06, FINGERS)]),
    BODY: np.array([[x, y, z] for x in (-DEEP, DEEP) for y in (-0.12, 0.12) for z in (0.5, SHOULDERS)]),
}


def pitch_of(voxels_world: np.ndarray) -> float:
    """Edge of a voxel, metres: the least distance of two layers."""
    layers = np.unique(np.round(voxels_world[:, 2], 4))
    return float(np.diff(layers).min()) if len(layers) > 1 else 0.0


def stance_of(voxels_world: np.ndarray, pitch: float) -> Stance:
    """Estimate where a body stands, though its hull may be cut: on the map's floor unless it is far above.

    The crown lies over the body's middle; higher voxels farther off are a raised hand.
    """
    floor = float(np.percentile(voxels_world[:, 2], TRIMMED)) - pitch / 2
    floor = 0.0 if -SAGGING_M < floor < FEET_LOST_M else floor
    place = np.median(voxels_world[:, :2], axis=0)
    column = np.linalg.norm(voxels_world[:, :2] - place, axis=1) < COLUMN_M
    high = np.percentile(voxels_world[column if column.any() else slice(None), 2], 100.0 - TRIMMED)
    stature = max(float(high) + pitch / 2 - floor, 0.5 * TYPICAL_STATURE_M)
    axis = np.linalg.eigh(np.cov((voxels_world[:, :2] - place).T))[1][:, -1]
    return Stance(place, np.array([axis[1], -axis[0]]), floor, stature)


def at_the_cut(voxels_world: np.ndarray, pitch: float, visibility: RigVisibility) -> np.ndarray:
    """Return which voxels (m,) bool of a hull have a neighbour, above the floor, that the rig does not see."""
    cut = np.zeros(len(voxels_world), dtype=bool)
    for axis in range(3):
        for way in (-1.0, 1.0):
            beyond = voxels_world.copy()
            beyond[:, axis] += way * REACH_VOXELS * pitch
            cut |= ~visibility.shows(beyond) & (beyond[:, 2] > visibility.volume.low[2] + pitch)
    return cut


def cut_parts(voxels_world: np.ndarray, stance: Stance, pitch: float, visibility: RigVisibility) -> tuple[str, ...]:
    """Name the parts of a hull (m, 3) that are cut off at the limit of the rig's view."""
    cut = at_the_cut(voxels_world, pitch, visibility)
    if np.count_nonzero(cut) < FEWEST_CUT:
        return ()
    flat = voxels_world[:, :2] - stance.place_world
    height = (voxels_world[:, 2] - stance.floor_world) / stance.stature
    across = flat @ np.array([-stance.forward_world[1], stance.forward_world[0]])
    near = np.linalg.norm(flat, axis=1) < TRUNK_REACH * stance.stature
    low = height < FEET_TO
    rows = {
        FEET: low,
        HEAD: near & (height > HEAD_FROM),
        LEFT_HAND: _tip(~near & ~low, across),
        RIGHT_HAND: _tip(~near & ~low, -across),
        BODY: near & ~low & (height <= HEAD_FROM),
    }
    rows = {
        part: cut & chosen
        for part, chosen in rows.items()
        if part not in HANDS or cut[chosen].sum() > TIP_CUT * chosen.sum()
    }
    found = tuple(part for part, chosen in rows.items() if np.count_nonzero(chosen) >= FEWEST_CUT)
    return (BODY,) if BODY in found else found


def _tip(arms: np.ndarray, outwards: np.ndarray) -> np.ndarray:
    """Return which voxels (m,) are the outer end of the arm on one side.

    Its cut share is tested, as a hull is wider than the arm in it, so its sides may leave the view though the hand does
    not.
    """
    side = arms & (outwards > 0.0)
    return side & (outwards > outwards[side].max(initial=0.0) - TIP_M)


def advice_text(parts: tuple[str, ...], stance: Stance, visibility: RigVisibility) -> str:
    """Return one sentence on what is not seen, by which cameras, and where to step."""
    names = dict.fromkeys(part.split()[-1] for part in parts)  # whose front is not known has no left hand
    yours = "you" if parts == (BODY,) else "your " + " and ".join(names)
    places = stance.places_of(parts)
    inside, seen = visibility.in_volume(places), visibility.seen_by(places)
    blind = [name for name, sees in zip(visibility.names, seen[inside].T, strict=True) if not sees.all()]
    if not inside.all() or not blind:
        be = "are" if yours == "you" or "feet" in yours or len(names) > 1 else "is"
        return f"{yours} {be} partly outside the volume: step towards its middle"
    do, it = ("does", "it") if len(blind) == 1 else ("do", "them")
    whole = "all of you" if yours == "you" else yours
    return f"{' and '.join(blind)} {do} not see {whole}: step away from {it}, or turn {it} towards you"
