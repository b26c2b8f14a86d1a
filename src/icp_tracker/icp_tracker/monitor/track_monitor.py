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
from stick_figure.least_squares.gauss_newton import Data, DataMatch
from stick_figure.pose import Pose

from ..articulated_fit import ArticulatedSettings
from .evidence import SAME_M, TRUNK, Evidence, ObservedSet
from .leaps import RecentRays, expected_on_trunk, leaps_of_limbs
from .limb_monitor import LimbMonitor
from .out_of_sight import is_cut, limbs_of_points, points_out_of_sight, shown_parts, with_hidden_parts
from .place_leads import FAR_M
from .pose_library import LIMBS, arms_exchanged, legs_exchanged, moved_to, sides_exchanged, stances, turned_around
from .track_quality import (
    ALL_PARTS,
    Baseline,
    Hypothesis,
    contested,
    doubtful_limbs,
    judge_track,
    limb_spread,
    points_of_limbs,
    unseen_points,
    with_doubtful_limbs,
    with_faint_limbs,
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
CHECKS = 8  # looks at the whole body turned, two more than there are kinds, until one that was lost is believed
LIMB_EVERY = 4  # looks from one at a limb elsewhere, with the whole body fitted to it, to the next
TURNED_EVERY = 8  # looks from one at the whole body turned round to the next
LONGEST_S = 0.1  # the time between two sets counts for no more: where none came, nothing was compared
NS_PER_S = 1e9
STANCES_A_SET = 6
SLIGHT_DROP, SLIGHT_DROP_EVERY = 0.03, 2  # so little less explained than usual is a reason to look at the body turned
NOTHING_MOVED = (False,) * len(PART_NAMES)
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


class TrackMonitor:
    """Judges and repairs the track of one body. Deterministic; its work is bounded at every frame set."""

    def __init__(self, settings: RecoverySettings) -> None:
        self._settings = settings
        self.reset()

    def reset(self) -> None:
        """Forget the body's baseline, and the hypothesis."""
        self._baseline, self._recent = Baseline(), RecentRays()
        self._hypothesis: Hypothesis | None = None
        self._limbs = LimbMonitor(self._settings.margin_rays, self._settings.margin_s)
        self._sets = self._turns = self._looks = self._unchecked = 0
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
        shared: bool = False,
        matched: DataMatch | None = None,
    ) -> Examination:
        """Judge a pose that was fitted to a set's data, and look for a better one.

        ``expected`` : where a good track's motion leads to; None where it is not known. ``shared`` : the body's part of
        the hull is another person's, too. ``matched`` : what the data are matched to in the pose, when that is known.
        """
        last_ns, self._last_stamp_ns = self._last_stamp_ns, stamp_ns
        apart_s = 0.0 if last_ns is None else min((stamp_ns - last_ns) / NS_PER_S, LONGEST_S)
        if len(data.contour_rays.information) == 0 or len(data.hull.points) == 0:
            return Examination(UNKNOWN)
        observed = ObservedSet(apart_s, body, data, settings, shared)
        fitted, leaps_m = pose, np.zeros(len(LIMBS))
        points, expected_points = forward(body, pose), None
        if expected is not None:
            expected_points = expected_on_trunk(body, pose, expected)
            if self._settings.search:
                leaps_m = leaps_of_limbs(points, expected_points)
                pose = self._limbs.without_leaps(observed, pose, expected, leaps_m)
                points = points if pose is fitted else forward(body, pose)
        evidence = observed.evidence_of(pose, matched if pose is fitted else None)
        torn = self._recent.torn(evidence, leaps_m, apart_s)
        unexplained = self._recent.more_unexplained(evidence)
        self._recent.add(evidence, apart_s)
        shown = shown_parts(evidence, self._baseline)
        hidden = points_out_of_sight(points, expected_points, data.hull.unseen, shown)
        quality = with_hidden_parts(judge_track(evidence, self._baseline), hidden)
        self._sets += 1
        if quality.state == LOST:
            self.lose()
        if quality.state == GOOD:
            self._baseline.add(evidence)
            self._last_good = pose
        if not self._settings.search:
            return Examination(quality, unseen=hidden)
        found = self._look_for_better(observed, pose, evidence, quality, unexplained, hidden)
        if found.better is not None:
            return replace(found, unchecked=self._unchecked > 0)
        unseen = hidden | unseen_points(self._baseline.unseen_sticks(evidence)) | points_of_limbs(torn)
        quality = with_faint_limbs(with_torn_limbs(found.quality, torn), evidence, self._baseline)
        return replace(
            found,
            quality=quality,
            spread=limb_spread(quality, self._limbs.places),
            unseen=unseen,
            kept=None if pose is fitted else pose,
            unchecked=self._unchecked > 0,
        )

    def _look_for_better(
        self,
        observed: ObservedSet,
        pose: Pose,
        evidence: Evidence,
        quality: TrackQuality,
        unexplained: np.ndarray,
        hidden: np.ndarray,
    ) -> Examination:
        """Look at other places of the limbs and other poses of the body; say what is doubtful, or what to change to.

        unexplained (4,) : rays that pass each limb, beyond what is usual. hidden (15,) bool : points out of sight.
        """
        turns = range(self._turns, self._turns + min(max(round(observed.apart_s * LOOKS_HZ), 1), LOOKS_A_SET))
        self._turns = turns.stop
        self._limbs.look(observed, pose, turns, unexplained, limbs_of_points(hidden), evidence.matched)
        if is_cut(hidden):
            self._hypothesis = None
        else:
            self._follow(observed, pose, evidence)
            self._look_for_another(turns, observed, pose, evidence, quality)
        places = self._limbs.places
        doubtful = doubtful_limbs(places, self._baseline.share_of_usual(evidence), observed.shared)
        doubted = with_doubtful_limbs(quality, doubtful, places)
        found = self._decide(observed, pose, doubted)
        if found.better is None:
            found = self._move_limb(observed, pose, evidence) or found
        if found.better is not None:
            self._limbs.go_over(observed, pose, found.better)
        return found

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
            return self._changed_to(hypothesis, quality)
        if hypothesis.seconds >= PATIENT_S or (hypothesis.sets >= 2 and hypothesis.margin < 0.0):
            self._hypothesis = None
            return Examination(quality)
        if hypothesis.moved != ALL_PARTS:  # the places that are followed of the limb say what is doubtful about it
            return Examination(quality)
        return Examination(contested(quality, hypothesis, s.margin_rays), hypothesis=hypothesis.pose)

    def _move_limb(self, observed: ObservedSet, pose: Pose, evidence: Evidence) -> Examination | None:
        """Return the change-over to another place of one limb, if one has led for long enough."""
        found = self._limbs.moved(observed, pose, evidence)
        return None if found is None else self._changed_to(found, UNKNOWN)

    def _changed_to(self, hypothesis: Hypothesis, otherwise: TrackQuality) -> Examination:
        """Return the change-over to a hypothesis, judged by its evidence; ``otherwise`` : of one without."""
        known = otherwise if hypothesis.evidence is None else judge_track(hypothesis.evidence, self._baseline)
        return Examination(known, hypothesis.pose, hypothesis.why, hypothesis.moved)

    def _has_lasted(self, hypothesis: Hypothesis, observed: ObservedSet, pose: Pose) -> bool:
        """Return whether the margin has held for long enough; stamps jitter, so half an interval may be missing."""
        s, sets, seconds = self._settings, hypothesis.sets, hypothesis.seconds
        if sets < MARGIN_SETS or seconds < s.margin_s - 0.5 * observed.apart_s:
            return False
        far = 1.0 + min(observed.apart_m(hypothesis.pose, pose) / FAR_M, 1.0)
        return hypothesis.margin >= s.margin_rays * max(1.0, far * s.margin_s / seconds, far * MARGIN_SETS / sets)

    # --- other poses of the whole body --------------------------------------------------------------------------------

    def _look_for_another(
        self, turns: range, observed: ObservedSet, pose: Pose, evidence: Evidence, quality: TrackQuality
    ) -> None:
        """Try other poses; one becomes the hypothesis if it explains more than the pose and the hypothesis so far."""
        if self._hypothesis is not None and quality.state != LOST and self._sets % 2:
            return  # following one takes as long as trying one
        for turn in turns:
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
        if turn % LIMB_EVERY == LIMB_EVERY // 2:
            return self._limbs.elsewhere(pose)
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
