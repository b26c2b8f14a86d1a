"""Monitors a track: judges every fitted pose, tries better ones, and says when to change over.

A fit finds the nearest explanation of the hull, which need not be the best: an arm that was lost in a wide hull, a body
that faces backward, both are local optima that no prior leaves. So other poses are tried, a few every frame set: places
of one limb, the body turned round, and when all is lost, stances anywhere in the hull. A pose that explains the
silhouettes' outlines better becomes the hypothesis, is followed beside the first for a while, and takes over once its
margin is clear: a single set is not enough, chance margins do not last. What lasts is a time, not a number of sets: the
body that causes a chance margin moves on as fast at any rate.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from capture_rig.settings import setting
from mocap_packets.fit import GOOD, LOST, PART_NAMES, UNKNOWN, TrackQuality
from stick_figure.body import Body
from stick_figure.kinematics import forward
from stick_figure.least_squares.gauss_newton import Data
from stick_figure.least_squares.placed_figure import Figure
from stick_figure.pose import Pose

from ..articulated_fit import ArticulatedSettings, PriorSettings, minimise
from .evidence import Evidence, evidence_of
from .limb_search import NO_POSES, LimbPlaces, other_places
from .pose_library import (
    LIMBS,
    LimbPoses,
    arms_exchanged,
    legs_exchanged,
    limb_poses,
    moved_to,
    sides_exchanged,
    stances,
    turned_around,
)
from .track_quality import (
    Baseline,
    Hypothesis,
    contested,
    doubtful_limbs,
    judge_track,
    limb_spread,
    unseen_points,
    with_doubtful_limbs,
)


@dataclass(frozen=True)
class RecoverySettings:
    """How a lost track, or a lost limb, is noticed and found again."""

    search: bool = setting(True, "look for better poses of limbs and body; off: the track is judged, not repaired")
    margin_rays: float = setting(
        2.0,
        "rays that another pose must explain beyond the followed one, on average over the sets it is compared in",
        low=0.0,
        high=1e4,
    )
    margin_s: float = setting(
        0.1, "time that it must be compared for, three frame sets at least", unit="s", low=0.0, high=100.0
    )


# checked by the drills of bench/recovery.py
CLEAR_RAYS = 20.0  # margin with which two frame sets are enough
MARGIN_SETS = 3  # sets that a hypothesis is compared in at least: one may be torn, two may share a chance
PATIENT_S = 0.5  # after which a hypothesis without the margin is dropped
LOOKS_HZ, LOOKS_A_SET = 60.0, 4  # looks at one limb elsewhere: so many a second, so many a set at most
LIMB_TURNS = (0, 1, 2, 0, 1, 3)  # of LIMBS, at every look one: arms are lost more often than legs
FOLLOWED_MARGIN = -30.0  # rays: a place farther behind is left to its limb's next turn (within four sets)
TURNED_EVERY = 16  # looks from one at the whole body turned round to the next
LONGEST_S = 0.1  # the time between two sets counts for no more: where none came, nothing was compared
NS_PER_S = 1e9
SAME_M = 0.10  # poses whose 15 points are so near to each other are one
FAR_M = 0.4  # a pose so far from the followed one, or farther, needs twice the evidence: tracks slip, they seldom leap
FREE = PriorSettings(position_sd_m=0.3, rotation_sd=0.4, ball_sd=0.5, hinge_sd=0.5)
FREE_ITERATIONS = 12
STANCES_A_SET = 6
SLIGHT_DROP, SLIGHT_DROP_EVERY = 0.03, 4  # so little less explained than usual is a reason to look at the body turned
BEHIND_MOST = 3.0  # rays that another pose may be behind when it is first looked at


@dataclass(frozen=True, eq=False)
class Examination:
    """What became of a fitted pose: how good it is; a better one to change over to, if any, and what it changes.

    hypothesis : another pose that may be right. spread (15, 3, 3) m^2 : of where the points of doubtful limbs may be.
    unseen (15,) bool : points for which nothing in the set speaks.
    """

    quality: TrackQuality
    better: Pose | None = None
    change: str = ""
    hypothesis: Pose | None = None
    spread: np.ndarray | None = None
    unseen: np.ndarray | None = None


@dataclass(frozen=True, eq=False)
class ObservedSet:
    """One frame set as the monitor examines it; ``apart_s`` : since the one before."""

    apart_s: float
    body: Body
    data: Data
    settings: ArticulatedSettings

    def evidence_of(self, pose: Pose) -> Evidence:
        """Return the evidence about a pose."""
        return evidence_of(Figure.of(self.body), pose, self.data)

    def fitted(self, pose: Pose, free: bool = False) -> Pose:
        """Return the pose that the fit reaches from another one, more freely if it is only a guess."""
        settings = replace(self.settings, prior=FREE, max_iterations=FREE_ITERATIONS) if free else self.settings
        return minimise(self.body, pose, self.data, settings)[0]

    def apart_m(self, pose: Pose, other: Pose) -> float:
        """Return how far apart (m) two poses' reference points are at most."""
        return float(np.linalg.norm(forward(self.body, pose) - forward(self.body, other), axis=1).max())


class TrackMonitor:
    """Judges and repairs the track of one body. Deterministic; its work is bounded at every frame set."""

    def __init__(self, settings: RecoverySettings) -> None:
        self._settings = settings
        self.reset()

    def reset(self) -> None:
        """Forget the body's baseline, and the hypothesis."""
        self._baseline = Baseline()
        self._hypothesis: Hypothesis | None = None
        self._places: dict[int, LimbPlaces] = {}  # by the limb's number in LIMBS
        self._doubtful: frozenset[int] = frozenset()
        self._sets = self._turns = self._looks = 0
        self._limb_looks = [0] * len(LIMBS)
        self._last_stamp_ns: int | None = None
        self._last_good: Pose | None = None

    def examine(self, stamp_ns: int, body: Body, pose: Pose, data: Data, settings: ArticulatedSettings) -> Examination:
        """Judge a pose that was fitted to a set's data, and look for a better one."""
        last_ns, self._last_stamp_ns = self._last_stamp_ns, stamp_ns
        apart_s = 0.0 if last_ns is None else min((stamp_ns - last_ns) / NS_PER_S, LONGEST_S)
        if len(data.contour_rays.information) == 0 or len(data.hull.points) == 0:
            return Examination(UNKNOWN)
        observed = ObservedSet(apart_s, body, data, settings)
        evidence = observed.evidence_of(pose)
        quality = judge_track(evidence, self._baseline)
        self._sets += 1
        if quality.state == GOOD:
            self._baseline.add(evidence)
            self._last_good = pose
        if not self._settings.search:
            return Examination(quality)
        looks = self._turns
        self._turns += min(max(round(apart_s * LOOKS_HZ), 1), LOOKS_A_SET)
        self._look_at_limbs(observed, pose, looks)
        self._follow(observed, pose, evidence)
        self._look_for_another(looks, observed, pose, evidence, quality)
        self._doubtful = doubtful_limbs(self._places, self._doubtful)
        found = self._decide(observed, pose, with_doubtful_limbs(quality, self._doubtful, self._places))
        if found.better is not None and self._places:
            self._keep_tracked(observed, pose, found.better)
        unseen = None if found.better is not None else unseen_points(self._baseline.unseen_sticks(evidence))
        return replace(found, spread=limb_spread(found.quality, self._places), unseen=unseen)

    # --- the hypothesis ----------------------------------------------------------------------------------------------

    def _follow(self, observed: ObservedSet, pose: Pose, evidence: Evidence) -> None:
        """Fit the hypothesis to this set too, and compare."""
        hypothesis = self._hypothesis
        if hypothesis is None:
            return
        fitted = observed.fitted(hypothesis.pose)
        if observed.apart_m(fitted, pose) < SAME_M:
            self._hypothesis = None
            return
        self._hypothesis = hypothesis.compared(fitted, observed.evidence_of(fitted), evidence, observed.apart_s)

    def _decide(self, observed: ObservedSet, pose: Pose, quality: TrackQuality) -> Examination:
        hypothesis, s = self._hypothesis, self._settings
        if hypothesis is None:
            return Examination(quality)
        if self._has_lasted(hypothesis, observed, pose) or (hypothesis.sets >= 2 and hypothesis.margin >= CLEAR_RAYS):
            self._hypothesis = None
            known = quality if hypothesis.evidence is None else judge_track(hypothesis.evidence, self._baseline)
            return Examination(known, hypothesis.pose, hypothesis.why)
        if hypothesis.seconds >= PATIENT_S or (hypothesis.sets >= 2 and hypothesis.margin < 0.0):
            self._hypothesis = None
            return Examination(quality)
        return Examination(contested(quality, hypothesis, s.margin_rays), hypothesis=hypothesis.pose)

    def _has_lasted(self, hypothesis: Hypothesis, observed: ObservedSet, pose: Pose) -> bool:
        """Return whether the margin has held for long enough; stamps jitter, so half an interval may be missing."""
        s, sets, seconds = self._settings, hypothesis.sets, hypothesis.seconds
        if sets < MARGIN_SETS or seconds < s.margin_s - 0.5 * observed.apart_s:
            return False
        far = 1.0 + min(observed.apart_m(hypothesis.pose, pose) / FAR_M, 1.0)
        return hypothesis.margin >= s.margin_rays * max(1.0, far * s.margin_s / seconds, far * MARGIN_SETS / sets)

    # --- limbs -------------------------------------------------------------------------------------------------------

    def _look_at_limbs(self, observed: ObservedSet, pose: Pose, looks: int) -> None:
        """Rate other places of the limbs: those that are known, and a part of the library of the limbs in turn."""
        turns = [LIMB_TURNS[turn % len(LIMB_TURNS)] for turn in range(looks, self._turns)]
        for number, limb in enumerate(LIMBS):
            places = self._places.pop(number, None)
            known = NO_POSES if places is None else places.within(FOLLOWED_MARGIN)
            if number not in turns and len(known.flexion) == 0:
                continue
            library = NO_POSES
            if number in turns:
                self._limb_looks[number] += 1
                library = limb_poses(limb).part(self._limb_looks[number], limb.parts)
            self._places[number] = other_places(Figure.of(observed.body), pose, limb, observed.data, library, known)

    def _keep_tracked(self, observed: ObservedSet, pose: Pose, better: Pose) -> None:
        """After a change-over, go on looking at the places that were left: a change may be a mistake."""
        for number, limb in enumerate(LIMBS):
            left = LimbPoses(pose.R_joints[None, limb.ball], pose.hinges[None, limb.hinge])
            self._places[number] = other_places(Figure.of(observed.body), better, limb, observed.data, NO_POSES, left)

    def _look_for_another(
        self, looks: int, observed: ObservedSet, pose: Pose, evidence: Evidence, quality: TrackQuality
    ) -> None:
        """Try other poses; one becomes the hypothesis if it explains more than the pose and the hypothesis so far."""
        if self._hypothesis is not None and quality.state != LOST and self._sets % 2:
            return  # following one takes as long as trying one
        for turn in range(looks, self._turns):
            self._look(observed, pose, evidence, self._guess(turn + 1, observed, pose, quality))

    def _look(self, observed: ObservedSet, pose: Pose, evidence: Evidence, guess: Hypothesis | None) -> None:
        """Fit another pose, and keep it as the hypothesis if it explains more."""
        if guess is None:
            return
        fitted = observed.fitted(guess.pose, free=guess.part is None)
        margin = evidence.margin_of(observed.evidence_of(fitted))
        behind = BEHIND_MOST if guess.part is None else 0.0  # only a limb's place is fitted to the end at once
        least = -behind if self._hypothesis is None else max(self._hypothesis.margin + 1.0, 0.0)
        known = [pose] if self._hypothesis is None else [pose, self._hypothesis.pose]
        if margin > least and all(observed.apart_m(fitted, other) > SAME_M for other in known):
            self._hypothesis = replace(guess, pose=fitted)

    # --- where to look -----------------------------------------------------------------------------------------------

    def _guess(self, turn: int, observed: ObservedSet, pose: Pose, quality: TrackQuality) -> Hypothesis | None:
        """Return what to try in this turn: a lost body's stances, the whole body turned, or one limb elsewhere."""
        every = TURNED_EVERY
        if quality.state == LOST and turn % 2 == 0:
            return self._stance(observed, turn // 2)
        if quality.state != GOOD:
            every = 1 if quality.state == LOST else 2
        elif self._baseline.share is not None and quality.explained < self._baseline.share - SLIGHT_DROP:
            every = min(every, SLIGHT_DROP_EVERY)
        if turn % every == 0:
            return self._whole_body(observed, pose)
        return self._limb(pose)

    def _whole_body(self, observed: ObservedSet, pose: Pose) -> Hypothesis:
        """Return the body turned or exchanged, one way after another; the most likely errors come most often."""
        body, turn = observed.body, self._looks % 6
        self._looks += 1
        if turn in (0, 2):
            return Hypothesis(sides_exchanged(body, pose), "left and right exchanged", None)
        if turn in (1, 4):
            return Hypothesis(turned_around(pose), "the body facing the other way", None)
        if turn == 5 and self._last_good is not None:
            return Hypothesis(moved_to(self._last_good, observed.data.hull.points), "the last good pose", None)
        if (self._looks // 6) % 2:
            return Hypothesis(legs_exchanged(body, pose), "left and right leg exchanged", None)
        return Hypothesis(arms_exchanged(body, pose), "left and right arm exchanged", None)

    def _stance(self, observed: ObservedSet, turn: int) -> Hypothesis:
        """Return the best of a few stances; others at the next set."""
        every = stances(observed.body, observed.data.hull.points)
        parts = len(every) // STANCES_A_SET
        best = min(every[turn % parts :: parts], key=lambda pose: observed.evidence_of(pose).cost)
        return Hypothesis(best, "the body found anew", None)

    def _limb(self, pose: Pose) -> Hypothesis | None:
        """Return the limb elsewhere whose other place explains most beyond the tracked one; None if none may."""
        places = {number: places for number, places in self._places.items() if len(places.margins)}
        if not places:
            return None
        number = max(places, key=lambda number: places[number].margins[0])
        other = places[number].best_pose(pose, LIMBS[number])
        part = LIMBS[number].part
        return None if other is None else Hypothesis(other, f"{PART_NAMES[part]} elsewhere", part)
