"""Follows other places of each limb beside the tracked one, and says when a limb has to move.

An arm is lost far more often than a body, and cheaper to look for: what the rest of the body leaves over of a set
within the limb's reach is compared with places of a library, a part of it in every set; the best places are followed
from set to set and gather evidence (:mod:`.place_leads`). A place that explains nearly as much as the tracked one makes
the limb doubtful; one that has explained more for long enough moves it.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from mocap_packets.fit import PART_NAMES
from stick_figure.least_squares.gauss_newton import DataMatch
from stick_figure.least_squares.placed_figure import Figure
from stick_figure.pose import Pose

from .evidence import SAME_M, Evidence, ObservedSet
from .leaps import LEAP_RAYS, kept_limb, reach_m
from .limb_search import NO_POSES, LimbPlaces, other_places, with_limb
from .place_leads import PlaceLeads
from .pose_library import LIMBS, Limb, LimbPoses, limb_poses
from .track_quality import Hypothesis

LIMB_TURNS = (0, 1, 2, 0, 1, 3)  # of LIMBS, at every look one: arms are lost more often than legs
LIKELY_MARGIN = -3.0  # rays: a limb with a place no farther behind is looked at more often
UNEXPLAINED_RAYS = 10.0  # so many more than usual that pass a limb speak of another place of it, too
FOLLOWED_MARGIN = -30.0  # rays: a place farther behind is left to its limb's next turn (within four sets)
CHANCE_SHARE = 0.5  # of margin_rays: a place that explains no more than this gathers no lead


def limb_elsewhere(limb: Limb, pose: Pose) -> Hypothesis:
    """Return the hypothesis that a limb, and no other part of the body, is where a pose has it."""
    moved = tuple(part == limb.part for part in range(len(PART_NAMES)))
    return Hypothesis(pose, f"{PART_NAMES[limb.part]} elsewhere", moved)


class LimbMonitor:
    """The other places of one body's four limbs. Limbs go by their number in LIMBS."""

    def __init__(self, margin_rays: float, margin_s: float) -> None:
        """As `recovery.margin_rays`, `recovery.margin_s`: by how much, and for how long, a place has to lead."""
        self._chance_rays, self._needed = CHANCE_SHARE * margin_rays, margin_rays * margin_s
        self._leads: dict[int, PlaceLeads] = {}
        self._cycle = 0
        self._looks = [0] * len(LIMBS)

    @property
    def places(self) -> Mapping[int, LimbPlaces]:
        """The places that are followed of each limb that has some."""
        return {number: leads.places for number, leads in self._leads.items()}

    def without_leaps(self, observed: ObservedSet, pose: Pose, expected: Pose, leaps_m: np.ndarray) -> Pose:
        """Return the pose with limbs that leapt (m) for too little where they were expected; where they leapt to is
        another place of theirs from now on."""
        for number, limb in enumerate(LIMBS):
            if leaps_m[number] <= reach_m(observed.apart_s):
                continue
            kept = kept_limb(observed.body, pose, expected, limb, observed.data)
            if kept is not None:
                self._follow_alone(observed, number, kept, pose)
                pose = kept
        return pose

    def look(
        self,
        observed: ObservedSet,
        pose: Pose,
        turns: range,
        unexplained: np.ndarray,
        hidden: np.ndarray,
        matched: DataMatch | None = None,
    ) -> None:
        """Rate other places of the limbs: those that are followed, and a part of the library of one limb a turn.

        unexplained (4,) : rays near each limb that it does not explain, beyond what is usual. hidden (4,) bool : limbs
        out of sight; what is left over in sight is not theirs unless it is much. ``matched`` : as of `other_places`.
        """
        looked_at = [self._limb_of(turn, unexplained) for turn in turns]
        for number, limb in enumerate(LIMBS):
            before = self._leads.pop(number, None)
            known = NO_POSES if before is None else before.places.within(FOLLOWED_MARGIN)
            if number not in looked_at and len(known.flexion) == 0:
                continue
            library = NO_POSES
            if number in looked_at:
                self._looks[number] += 1
                library = limb_poses(limb).part(self._looks[number], limb.parts)
            places = other_places(Figure.of(observed.body), pose, limb, observed.data, library, known, matched)
            chance = LEAP_RAYS if hidden[number] else self._chance_rays
            self._leads[number] = PlaceLeads.after(before, places, observed.apart_s, chance)

    def moved(self, observed: ObservedSet, pose: Pose, evidence: Evidence) -> Hypothesis | None:
        """Return the limb whose other place has led for long enough, the whole figure fitted from there, with the
        evidence about it; None for no such limb, or if the whole set does not agree."""
        shares = {number: leads.shares_of(self._needed) for number, leads in self._leads.items()}
        number = max(shares, key=lambda number: float(shares[number].max(initial=0.0)), default=None)
        if number is None or shares[number].max(initial=0.0) < 1.0:
            return None
        limb, leads, k = LIMBS[number], self._leads[number], int(shares[number].argmax())
        moved = observed.fitted(with_limb(pose, limb, leads.places.poses.R[k], leads.places.poses.flexion[k]))
        found = observed.evidence_of(moved)
        if observed.apart_m(moved, pose) < SAME_M or evidence.margin_of(found) <= 0.0:
            self._leads[number] = leads.without(k)
            return None
        return replace(limb_elsewhere(limb, moved), evidence=found)

    def elsewhere(self, pose: Pose) -> Hypothesis | None:
        """Return the pose with one limb at the likeliest place that is not its own; None while none is followed."""
        found = [
            (float(leads.places.margins[k]), number, int(k))
            for number, leads in self._leads.items()
            for k in np.flatnonzero(leads.places.apart_m > SAME_M)
        ]
        if not found:
            return None
        _, number, k = max(found)
        limb, places = LIMBS[number], self._leads[number].places.poses
        return limb_elsewhere(limb, with_limb(pose, limb, places.R[k], places.flexion[k]))

    def go_over(self, observed: ObservedSet, pose: Pose, better: Pose) -> None:
        """Follow the places that a change-over left: it may be a mistake."""
        for number in range(len(LIMBS)):
            self._follow_alone(observed, number, better, pose)

    def _follow_alone(self, observed: ObservedSet, number: int, pose: Pose, left: Pose) -> None:
        """Follow nothing but the place of a limb in the pose that was left."""
        limb = LIMBS[number]
        place = LimbPoses(left.R_joints[None, limb.ball], left.hinges[None, limb.hinge])
        places = other_places(Figure.of(observed.body), pose, limb, observed.data, NO_POSES, place)
        self._leads[number] = PlaceLeads.after(None, places, 0.0, 0.0)

    def _limb_of(self, turn: int, unexplained: np.ndarray) -> int:
        """Return which limb is looked at: one after another, and every second time one that may well be elsewhere."""
        rivals = {number: float(leads.places.margins.max(initial=-np.inf)) for number, leads in self._leads.items()}
        likely = max(rivals, key=rivals.__getitem__, default=0)
        if rivals.get(likely, -np.inf) < LIKELY_MARGIN:
            likely = int(unexplained.argmax())
            if unexplained[likely] < UNEXPLAINED_RAYS:
                turn = 0
        if turn % 2:
            return likely
        self._cycle += 1
        return LIMB_TURNS[self._cycle % len(LIMB_TURNS)]
