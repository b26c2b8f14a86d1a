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
from .evidence import TRUNK, Evidence, evidence_of
from .leaps import LEAP_RAYS, RecentRays, kept_limb, leaps_of_limbs, reach_m
from .limb_search import NO_POSES, other_places, with_limb
from .out_of_sight import is_cut, limbs_of_points, points_out_of_sight, shown_parts, with_hidden_parts
from .place_leads import FAR_M, PlaceLeads
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
    points_of_limbs,
    unseen_points,
    with_doubtful_limbs,
    with_torn_limbs,
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
        0.05, "time that it must be compared for, three frame sets at least", unit="s", low=0.0, high=100.0
    )


# checked by the drills of bench/recovery.py
CLEAR_RAYS = 20.0  # margin with which two frame sets are enough
MARGIN_SETS = 3  # sets that a hypothesis is compared in at least: one may be torn, two may share a chance
PATIENT_S = 0.5  # after which a hypothesis without the margin is dropped
LOOKS_HZ, LOOKS_A_SET = 60.0, 4  # looks at one limb elsewhere: so many a second, so many a set at most
LIKELY_MARGIN = -3.0  # rays: a limb with a place no farther behind is looked at more often
UNEXPLAINED_RAYS = 10.0  # so many more than usual that pass a limb speak of another place of it, too
LIMB_TURNS = (0, 1, 2, 0, 1, 3)  # of LIMBS, at every look one: arms are lost more often than legs
FOLLOWED_MARGIN = -30.0  # rays: a place farther behind is left to its limb's next turn (within four sets)
CHECKS = 8  # looks at the whole body turned, two more than there are kinds, until one that was lost is believed
TURNED_EVERY = 8  # looks from one at the whole body turned round to the next
LONGEST_S = 0.1  # the time between two sets counts for no more: where none came, nothing was compared
NS_PER_S = 1e9
CHANCE_SHARE = 0.5  # of margin_rays: a place that explains no more than this gathers no lead
SAME_M = 0.10  # poses whose 15 points are so near to each other are one
FREE = PriorSettings(position_sd_m=0.3, rotation_sd=0.4, ball_sd=0.5, hinge_sd=0.5)
FREE_ITERATIONS = 12
STANCES_A_SET = 6
SLIGHT_DROP, SLIGHT_DROP_EVERY = 0.03, 2  # so little less explained than usual is a reason to look at the body turned
NOTHING_MOVED, ALL_MOVED = (False,) * len(PART_NAMES), (True,) * len(PART_NAMES)
BEHIND_MOST = 3.0  # rays that another pose may be behind when it is first looked at


@dataclass(frozen=True, eq=False)
class Examination:
    """What became of a fitted pose: how good it is; a better one to change over to, if any, and what it changes, in
    words and as parts (5,) of the body.

    hypothesis : another pose that may be right. spread (15, 3, 3) m^2 : of where the points of doubtful limbs may be.
    unseen (15,) bool : points for which nothing in the set speaks. kept : the fitted pose with limbs that leapt for too
    little where they were expected. unchecked : the body was lost, and may have been found the wrong way round.
    """

    quality: TrackQuality
    better: Pose | None = None
    change: str = ""
    moved: tuple[bool, ...] = NOTHING_MOVED
    hypothesis: Pose | None = None
    spread: np.ndarray | None = None
    unseen: np.ndarray | None = None
    kept: Pose | None = None
    unchecked: bool = False


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
        self._baseline, self._recent = Baseline(), RecentRays()
        self._hypothesis: Hypothesis | None = None
        self._leads: dict[int, PlaceLeads] = {}  # by the limb's number in LIMBS
        self._doubtful: frozenset[int] = frozenset()
        self._sets = self._turns = self._looks = self._cycle = self._unchecked = 0
        self._limb_looks = [0] * len(LIMBS)
        self._last_stamp_ns: int | None = None
        self._last_good: Pose | None = None

    def lose(self) -> None:
        """Note a set that shows nobody: who is found after it is not believed before other poses have been tried."""
        self._unchecked = CHECKS

    def examine(
        self,
        stamp_ns: int,
        body: Body,
        pose: Pose,
        data: Data,
        settings: ArticulatedSettings,
        expected: Pose | None = None,
    ) -> Examination:
        """Judge a pose that was fitted to a set's data, and look for a better one.

        ``expected`` : where a good track's motion leads to; None where it is not known.
        """
        last_ns, self._last_stamp_ns = self._last_stamp_ns, stamp_ns
        apart_s = 0.0 if last_ns is None else min((stamp_ns - last_ns) / NS_PER_S, LONGEST_S)
        if len(data.contour_rays.information) == 0 or len(data.hull.points) == 0:
            return Examination(UNKNOWN)
        observed = ObservedSet(apart_s, body, data, settings)
        fitted, leaps_m = pose, np.zeros(len(LIMBS))
        if expected is not None and self._settings.search:
            leaps_m = leaps_of_limbs(body, pose, expected)
            pose = self._without_leaps(observed, pose, expected, leaps_m)
        evidence = observed.evidence_of(pose)
        torn = self._recent.torn(evidence, leaps_m, apart_s)
        unexplained = self._recent.more_unexplained(evidence)
        self._recent.add(evidence, apart_s)
        shown = shown_parts(evidence, self._baseline)
        hidden = points_out_of_sight(body, pose, expected, data.hull.unseen, shown)
        quality = with_hidden_parts(judge_track(evidence, self._baseline), hidden)
        self._sets += 1
        if quality.state == LOST:
            self.lose()
        if quality.state == GOOD:
            self._baseline.add(evidence)
            self._last_good = pose
        if not self._settings.search:
            return Examination(quality, unseen=hidden)
        looks = self._turns
        self._turns += min(max(round(apart_s * LOOKS_HZ), 1), LOOKS_A_SET)
        self._look_at_limbs(observed, pose, looks, unexplained, limbs_of_points(hidden))
        if is_cut(hidden):
            self._hypothesis = None
        else:
            self._follow(observed, pose, evidence)
            self._look_for_another(looks, observed, pose, evidence, quality)
        places = {number: leads.places for number, leads in self._leads.items()}
        self._doubtful = doubtful_limbs(places, self._doubtful)
        found = self._decide(observed, pose, with_doubtful_limbs(quality, self._doubtful, places))
        if found.better is None:
            found = self._move_limb(observed, pose, evidence) or found
        if found.better is not None:
            self._keep_tracked(observed, pose, found.better)
            return replace(found, unchecked=self._unchecked > 0)
        unseen = hidden | unseen_points(self._baseline.unseen_sticks(evidence)) | points_of_limbs(torn)
        return replace(
            found,
            quality=with_torn_limbs(found.quality, torn),
            spread=limb_spread(found.quality, places),
            unseen=unseen,
            kept=None if pose is fitted else pose,
            unchecked=self._unchecked > 0,
        )

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
            return Examination(known, hypothesis.pose, hypothesis.why, ALL_MOVED)
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

    def _without_leaps(self, observed: ObservedSet, pose: Pose, expected: Pose, leaps_m: np.ndarray) -> Pose:
        """Return the pose with limbs that leapt for too little where they were expected; where they leapt to is another
        place of theirs from now on."""
        for number, limb in enumerate(LIMBS):
            if leaps_m[number] <= reach_m(observed.apart_s):
                continue
            kept = kept_limb(observed.body, pose, expected, limb, observed.data)
            if kept is not None:
                left = LimbPoses(pose.R_joints[None, limb.ball], pose.hinges[None, limb.hinge])
                places = other_places(Figure.of(observed.body), kept, limb, observed.data, NO_POSES, left)
                self._leads[number] = PlaceLeads.after(None, places, 0.0, 0.0)
                pose = kept
        return pose

    def _look_at_limbs(
        self, observed: ObservedSet, pose: Pose, looks: int, unexplained: np.ndarray, hidden: np.ndarray
    ) -> None:
        """Rate other places of the limbs: those that are known, and a part of the library of the limbs in turn.

        unexplained (4,) : rays near each limb that it does not explain, beyond what is usual. hidden (4,) bool : limbs
        out of sight; what is left over in sight is not theirs unless it is much.
        """
        turns = [self._limb_of(turn, unexplained) for turn in range(looks, self._turns)]
        for number, limb in enumerate(LIMBS):
            before = self._leads.pop(number, None)
            known = NO_POSES if before is None else before.places.within(FOLLOWED_MARGIN)
            if number not in turns and len(known.flexion) == 0:
                continue
            library = NO_POSES
            if number in turns:
                self._limb_looks[number] += 1
                library = limb_poses(limb).part(self._limb_looks[number], limb.parts)
            places = other_places(Figure.of(observed.body), pose, limb, observed.data, library, known)
            chance = LEAP_RAYS if hidden[number] else CHANCE_SHARE * self._settings.margin_rays
            self._leads[number] = PlaceLeads.after(before, places, observed.apart_s, chance)

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

    def _move_limb(self, observed: ObservedSet, pose: Pose, evidence: Evidence) -> Examination | None:
        """Return the pose with the limb moved whose other place has led for long enough, if all of the set agrees."""
        needed = self._settings.margin_rays * self._settings.margin_s
        shares = {number: leads.shares_of(needed) for number, leads in self._leads.items()}
        number = max(shares, key=lambda number: float(shares[number].max(initial=0.0)), default=None)
        if number is None or shares[number].max(initial=0.0) < 1.0:
            return None
        limb, leads, k = LIMBS[number], self._leads[number], int(shares[number].argmax())
        moved = observed.fitted(with_limb(pose, limb, leads.places.poses.R[k], leads.places.poses.flexion[k]))
        found = observed.evidence_of(moved)
        if observed.apart_m(moved, pose) < SAME_M or evidence.margin_of(found) <= 0.0:
            self._leads[number] = leads.without(k)
            return None
        quality = judge_track(found, self._baseline)
        parts = tuple(part == limb.part for part in range(len(PART_NAMES)))
        return Examination(quality, moved, f"{PART_NAMES[limb.part]} elsewhere", parts)

    def _keep_tracked(self, observed: ObservedSet, pose: Pose, better: Pose) -> None:
        """After a change-over, go on looking at the places that were left: a change may be a mistake."""
        for number, limb in enumerate(LIMBS):
            left = LimbPoses(pose.R_joints[None, limb.ball], pose.hinges[None, limb.hinge])
            places = other_places(Figure.of(observed.body), better, limb, observed.data, NO_POSES, left)
            self._leads[number] = PlaceLeads.after(None, places, 0.0, 0.0)

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
        fitted = observed.fitted(guess.pose, free=True)
        margin = evidence.margin_of(observed.evidence_of(fitted))
        least = -BEHIND_MOST if self._hypothesis is None else max(self._hypothesis.margin + 1.0, 0.0)
        known = [pose] if self._hypothesis is None else [pose, self._hypothesis.pose]
        if margin > least and all(observed.apart_m(fitted, other) > SAME_M for other in known):
            self._hypothesis = replace(guess, pose=fitted)

    # --- where to look -----------------------------------------------------------------------------------------------

    def _guess(self, turn: int, observed: ObservedSet, pose: Pose, quality: TrackQuality) -> Hypothesis | None:
        """Return what to try in this turn: a lost body's stances, or the whole body turned; mostly nothing."""
        every = TURNED_EVERY
        if quality.state == LOST and turn % 2 == 0:
            return self._stance(observed, turn // 2)
        if quality.state != GOOD:
            every = 2 if quality.parts[TRUNK] == GOOD else 1
        elif self._unchecked > 0:
            every = 1
        elif self._baseline.share is not None and quality.explained < self._baseline.share - SLIGHT_DROP:
            every = min(every, SLIGHT_DROP_EVERY)
        if turn % every == 0:
            return self._whole_body(observed, pose)
        return None

    def _whole_body(self, observed: ObservedSet, pose: Pose) -> Hypothesis:
        """Return the body turned or exchanged, one way after another; the most likely errors come most often."""
        body, turn = observed.body, self._looks % 6
        self._looks += 1
        self._unchecked = max(self._unchecked - 1, 0)
        if turn in (0, 2):
            return Hypothesis(sides_exchanged(body, pose), "left and right exchanged")
        if turn in (1, 4):
            return Hypothesis(turned_around(pose), "the body facing the other way")
        if turn == 5 and self._last_good is not None:
            return Hypothesis(moved_to(self._last_good, observed.data.hull.points), "the last good pose")
        if (self._looks // 6) % 2:
            return Hypothesis(legs_exchanged(body, pose), "left and right leg exchanged")
        return Hypothesis(arms_exchanged(body, pose), "left and right arm exchanged")

    def _stance(self, observed: ObservedSet, turn: int) -> Hypothesis:
        """Return the best of a few stances; others at the next set."""
        every = stances(observed.body, observed.data.hull.points)
        parts = len(every) // STANCES_A_SET
        best = min(every[turn % parts :: parts], key=lambda pose: observed.evidence_of(pose).cost)
        return Hypothesis(best, "the body found anew")
