"""Monitors a track: judges every fitted pose, tries others, and changes over to better ones.

A fit finds the nearest local optimum, which need not be the best: an arm that was lost in a wide hull, or a body that
faces backward, stays. So other poses are tried, a few every frame set: places of one limb, the body turned round, and
when all is lost, stances anywhere in the hull. Each limb has a discrete Bayes filter over its places
(:mod:`.limb_filter`), and so has the whole body over its pose and another (:mod:`.body_filter`). A pose that is more
probable than the tracked one replaces it; one that is nearly as probable makes the track doubtful.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from capture_rig.settings import setting
from capture_rig.stamps import NS_PER_S
from mocap_packets.fit import DOUBTFUL, GOOD, LOST, PART_NAMES, UNKNOWN, TrackQuality, points_of_parts
from stick_figure.body import Body
from stick_figure.kinematics import farthest_apart_m, forward
from stick_figure.least_squares.contour_factor import RayMatch
from stick_figure.least_squares.gauss_newton import Data
from stick_figure.least_squares.posed_model import BodyModel
from stick_figure.pose import Pose

from ..articulated_fit import LONGEST_S, ArticulatedSettings
from . import limb_filter
from .body_filter import BodyFilter
from .evidence import SAME_M, TRUNK, Evidence, Observation
from .limb_filter import LimbBelief
from .limb_search import NO_POSES, other_places, with_limb
from .pose_library import LIMB_POINTS, LIMBS, LimbPoses, limb_poses

# Thresholds: chosen with python bench/recovery.py.
LOOKS_HZ, LOOKS_A_SET = 60.0, 4  # limb searches per second, and at most per frame set
LIMB_TURNS = (0, 1, 2, 0, 1, 3)  # of LIMBS: arms are lost more often than legs
NOTHING_MOVED, ALL_PARTS = (False,) * len(PART_NAMES), (True,) * len(PART_NAMES)


@dataclass(frozen=True)
class RecoverySettings:
    """How a lost track, or a lost limb, is noticed and found again."""

    search: bool = setting(True, "look for better poses of limbs and body; off: the track is judged, not repaired")


@dataclass(frozen=True, eq=False)
class TrackAssessment:
    """Quality of a fitted pose; a better one to change over to, if any, with its changes in words and as parts (5,) of
    the body.

    spread (15, 3, 3) m^2 : second moment of the points of doubtful parts about where they are fitted.
    """

    quality: TrackQuality
    better: Pose | None = None
    change: str = ""
    moved: tuple[bool, ...] = NOTHING_MOVED
    spread: np.ndarray | None = None


class TrackMonitor:
    """Judges and repairs the track of one body. Deterministic; its work is bounded at every frame set."""

    def __init__(self, settings: RecoverySettings) -> None:
        self._settings = settings
        self.reset()

    def reset(self) -> None:
        """Forget all beliefs about the body."""
        self._beliefs: list[LimbBelief | None] = [None] * len(LIMBS)
        self._hidden = np.zeros(len(LIMBS), bool)  # limbs that reach out of the cameras' view
        self._body = BodyFilter()
        self._last_stamp_ns: int | None = None
        self._turn = 0
        self._looks = [0] * len(LIMBS)

    def mark_lost(self) -> None:
        """Mark a set that shows nobody: the next pose is doubtful until other poses have been tried."""
        self._body.mark_lost()

    def assess(
        self,
        stamp_ns: int,
        body: Body,
        pose: Pose,
        data: Data,
        settings: ArticulatedSettings,
        matched: RayMatch | None = None,
    ) -> TrackAssessment:
        """Judge a pose that was fitted to a set's data, and search for a better one; ``matched`` : the rays' match in
        that pose, if known."""
        last_ns, self._last_stamp_ns = self._last_stamp_ns, stamp_ns
        dt_s = 0.0 if last_ns is None else min((stamp_ns - last_ns) / NS_PER_S, LONGEST_S)
        if len(data.contour_rays.information) == 0 or len(data.hull) == 0:
            return TrackAssessment(UNKNOWN)
        seen = Observation(dt_s, body, data, settings)
        evidence = seen.evidence_of(pose, matched)
        quality = self._body.judge(evidence.share)
        if quality.state == LOST:
            self.mark_lost()
        if not self._settings.search:
            return TrackAssessment(quality)
        turns = range(self._turn, self._turn + min(max(round(dt_s * LOOKS_HZ), 1), LOOKS_A_SET))
        self._turn = turns.stop
        self._update_limbs(seen, pose, evidence, turns)
        quality = self._with_limbs(quality)
        self._body.mark_set(pose, quality, dt_s)
        found = self._changed_body(seen, pose, evidence, quality, turns) or self._changed_limb(seen, pose, evidence)
        if found is None:
            quality = self._body.with_other(quality)
            found = TrackAssessment(quality, spread=self._spread(seen, pose, quality))
        return replace(found, quality=self._body.with_misfit(found.quality))

    def _changed_body(
        self, seen: Observation, pose: Pose, evidence: Evidence, quality: TrackQuality, turns: range
    ) -> TrackAssessment | None:
        """Return the change-over to another pose of the whole body that is more probable."""
        if self._hidden.sum() > 1:
            self._body.other = None  # the visible rest of the body does not show which way it faces
            return None
        changed = self._body.update(seen, pose, evidence, quality, turns)
        if changed is None:
            return None
        self._beliefs = [None] * len(LIMBS)
        other, found = changed
        return TrackAssessment(self._body.judge(found.share), other.pose, other.why, ALL_PARTS)

    # --- beliefs about each limb --------------------------------------------------------------------------------------

    def _update_limbs(self, seen: Observation, pose: Pose, evidence: Evidence, turns: range) -> None:
        """Rate other places of the limbs: those known from the last set, and a part of one limb's library a turn."""
        self._hidden = seen.data.unseen.at(forward(seen.body, pose))[LIMB_POINTS].any(axis=1)
        searched = {self._limb_of(turn) for turn in turns}
        for number, limb in enumerate(LIMBS):
            before, library = self._beliefs[number], NO_POSES
            if number in searched:
                self._looks[number] += 1
                library = limb_poses(limb).part(self._looks[number], limb.parts)
            known = NO_POSES if before is None else before.places.poses
            places = other_places(BodyModel.of(seen.body), pose, limb, seen.data, library, known, evidence.matched)
            self._beliefs[number] = LimbBelief.after(before, places, seen.dt_s, bool(self._hidden[number]))

    def _limb_of(self, turn: int) -> int:
        """Return the limb to search for: each in turn, and every second time the least certain one."""
        certain = [1.0 if belief is None else float(belief.probabilities[0]) for belief in self._beliefs]
        return int(np.argmin(certain)) if turn % 2 else LIMB_TURNS[turn // 2 % len(LIMB_TURNS)]

    def _with_limbs(self, quality: TrackQuality) -> TrackQuality:
        """Return the quality with those limbs doubtful that may be elsewhere or unseen."""
        parts, log_odds = list(quality.parts), [-math.inf] * len(PART_NAMES)
        reasons = [quality.reason] if quality.reason else []
        for limb, belief in zip(LIMBS, self._beliefs, strict=True):
            part = limb.part
            if belief is None:
                continue
            p = belief.not_as_tracked
            log_odds[part] = math.log(p / (1.0 - p))
            if p > limb_filter.DOUBTFUL and parts[part] == GOOD:
                parts[part] = DOUBTFUL
                reasons.append(f"{PART_NAMES[part]}: {_in_words(belief)}")
        known = max((belief.known_elsewhere for belief in self._beliefs if belief is not None), default=0.0)
        state = DOUBTFUL if known > limb_filter.DOUBTFUL and quality.state == GOOD else quality.state
        return replace(quality, state=state, parts=tuple(parts), reason="; ".join(reasons), log_odds=tuple(log_odds))

    def _changed_limb(self, seen: Observation, pose: Pose, evidence: Evidence) -> TrackAssessment | None:
        """Return the change-over of the limb that is most probably elsewhere, with the whole body fitted from there;
        None without such a limb, or if the body's cost does not fall."""
        rivals = [
            (float(belief.log_odds[place]), number, place, belief)
            for number, belief in enumerate(self._beliefs)
            if belief is not None and (place := belief.likeliest_place) is not None
        ]
        if not rivals:
            return None
        log_odds, number, place, belief = max(rivals, key=lambda rival: rival[0])
        limb = LIMBS[number]
        better = seen.fitted(with_limb(pose, limb, *belief.places.poses.at(place)))
        found = seen.evidence_of(better)
        if farthest_apart_m(seen.body, better, pose) < SAME_M or evidence.margin_of(found) <= 0.0:
            self._beliefs[number] = belief.without(place)
            return None
        self._beliefs[number] = self._belief_after_move(seen, better, number, pose, log_odds)
        quality = self._with_limbs(self._body.judge(found.share))
        moved = tuple(part == limb.part for part in range(len(PART_NAMES)))
        return TrackAssessment(quality, better, f"{PART_NAMES[limb.part]} elsewhere", moved)

    def _belief_after_move(
        self, seen: Observation, better: Pose, number: int, left: Pose, log_odds: float
    ) -> LimbBelief:
        """Return the belief about a limb after a change-over: the place it left is now one of the others."""
        limb = LIMBS[number]
        places = other_places(BodyModel.of(seen.body), better, limb, seen.data, NO_POSES, LimbPoses.of(left, limb))
        before = self._beliefs[number]
        unfound, unseen = (0.0, 0.0) if before is None else (before.unfound - log_odds, before.unseen - log_odds)
        return LimbBelief(places, np.full(len(places.margins), -log_odds), unfound, unseen)

    # --- covariance of doubtful points --------------------------------------------------------------------------------

    def _spread(self, seen: Observation, pose: Pose, quality: TrackQuality) -> np.ndarray | None:
        """Return the mixture's second moment (15, 3, 3) m^2 of doubtful points about where they are fitted."""
        if quality.state == GOOD:
            return None
        spread = np.zeros((15, 3, 3))
        for limb, points, belief in zip(LIMBS, LIMB_POINTS, self._beliefs, strict=True):
            if belief is not None and quality.parts[limb.part] == DOUBTFUL:
                spread[points] = belief.spread
        if self._body.other is not None and quality.parts[TRUNK] != GOOD:
            d = forward(seen.body, self._body.other.pose) - forward(seen.body, pose)
            spread += self._body.other.probability * d[:, :, None] * d[:, None, :]
        elif quality.parts[TRUNK] != GOOD:
            spread[points_of_parts([part == TRUNK for part in range(len(PART_NAMES))])] += (
                limb_filter.UNSEEN_SD_M** 2 * np.eye(3)
            )
        return spread


def _in_words(belief: LimbBelief) -> str:
    places = belief.places
    of_places = belief.log_odds.max(initial=-np.inf)
    if belief.unseen >= max(belief.unfound, of_places):
        return f"{places.samples:.0f} independent samples show it"
    if belief.unfound >= of_places:
        return f"{places.unexplained:.0f} independent samples near it are left over, {places.samples:.0f} show it"
    k = int(belief.log_odds.argmax())
    return f"a place {100 * places.apart_m[k]:.0f} cm away explains {places.margins[k]:+.0f} independent samples"
