"""One discrete Bayes filter for the pose of the whole body: as tracked, or one alternative.

The body is judged by the share of the contour rays that it explains. One alternative pose, turned round, with left and
right exchanged, or a new one in the hull, is fitted to every set beside the tracked one while it may be right. Log odds
are forgotten exponentially, as those of the limbs (:mod:`.limb_filter`).
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

from mocap_packets.fit import DOUBTFUL, GOOD, LOST, PART_NAMES, TrackQuality
from stick_figure.kinematics import farthest_apart_m
from stick_figure.pose import Pose

from . import limb_filter
from .evidence import RAYS_PER_NAT, SAME_M, TRUNK, Evidence, Observation
from .pose_library import WITH_ARMS, WITH_LEGS, WITH_SIDES, exchanged, moved_to, stances, turned_around

# Thresholds: chosen with python bench/recovery.py.
TURNED_EVERY = 8  # every how many searches one is of the whole body, while the track is good
CHECKS = 8  # of them, two more than there are kinds, before a body that was lost is good again
STANCES_A_SET = 6
BODY_LOG_PRIOR = -3.0  # of another pose of the whole body, against the tracked one: a person seldom turns in a set
BODY_DOUBTFUL = 0.4  # probability of another pose of the whole body
LOST_SHARE, DOUBTFUL_SHARE = 0.35, 0.60  # of the contour rays explained: what wrong poses explain, what clothes leave
# share of the contour rays, smoothed over MISFIT_S, below which the body's shape is not the person's. It makes parts
# doubtful and changes no pose, as torn silhouettes leave as much unexplained beside right poses. Of 73 sets of six
# makers' people, those below it have a point 0.1 m off half of the time; any share from 0.66 to 0.70 separates them
# (python bench/people.py --doubt)
MISFIT_SHARE, MISFIT_S = 0.68, 0.3


@dataclass(frozen=True, eq=False)
class Hypothesis:
    """Another pose of the whole body, in words what differs, and its log odds against the tracked one."""

    pose: Pose
    why: str
    log_odds: float = BODY_LOG_PRIOR
    margin: float = 0.0

    @property
    def probability(self) -> float:
        return 1.0 / (1.0 + math.exp(-self.log_odds))


class BodyFilter:
    """Quality of one body's pose. ``other`` : the alternative that is fitted beside it, if any."""

    def __init__(self) -> None:
        self.other: Hypothesis | None = None
        self._recent_share = 1.0
        self._last_good: Pose | None = None
        self._kind = self._unchecked = 0

    def mark_lost(self) -> None:
        """Mark a set that shows nobody: the next pose is doubtful until other poses have been tried."""
        self._unchecked = CHECKS

    @staticmethod
    def judge(share: float) -> TrackQuality:
        """Return the quality by the share of the contour rays that the body explains."""
        state = LOST if share < LOST_SHARE else DOUBTFUL if share < DOUBTFUL_SHARE else GOOD
        reason = "" if state == GOOD else f"the body explains {100 * share:.0f} % of the outlines"
        return TrackQuality(state, reason, (state,) * len(PART_NAMES), share)

    def mark_set(self, pose: Pose, quality: TrackQuality, dt_s: float) -> None:
        """Update the smoothed share of explained rays with a set, ``dt_s`` after the one before."""
        if quality.state == GOOD:
            self._last_good = pose
        self._recent_share += (quality.explained - self._recent_share) * (1.0 - math.exp(-dt_s / MISFIT_S))

    def update(
        self, seen: Observation, pose: Pose, evidence: Evidence, quality: TrackQuality, turns: range
    ) -> tuple[Hypothesis, Evidence] | None:
        """Fit the alternative to a set, or search for one in these turns; return one that has become more probable,
        with its evidence."""
        other = self.other
        if other is not None:
            fitted = seen.fitted(other.pose)
            found = seen.evidence_of(fitted)
            other = _updated(replace(other, pose=fitted), evidence.margin_of(found), seen.dt_s)
            if other.log_odds < BODY_LOG_PRIOR - 1.0 or farthest_apart_m(seen.body, fitted, pose) < SAME_M:
                other = None
            elif other.log_odds > 0.0:
                self.other = None
                return other, found
            self.other = other
        if other is None or self._unchecked:
            for turn in turns:
                self._try_alternative(seen, pose, evidence, quality, turn)
        return None

    def _try_alternative(
        self, seen: Observation, pose: Pose, evidence: Evidence, quality: TrackQuality, turn: int
    ) -> None:
        """Fit one other pose of the whole body if a turn is due; keep it if it explains more."""
        if quality.state == LOST and turn % 2:
            guess = self._stance(seen, turn // 2)
        elif turn % (1 if quality.state == LOST or self._unchecked or quality.parts[TRUNK] != GOOD else TURNED_EVERY):
            return
        else:
            guess = self._other_way_round(seen, pose)
        fitted = seen.fitted(guess.pose, guess=True)
        margin = evidence.margin_of(seen.evidence_of(fitted))
        best = 0.0 if self.other is None else self.other.margin
        if margin > best and farthest_apart_m(seen.body, fitted, pose) > SAME_M:
            self.other = _updated(replace(guess, pose=fitted), margin, seen.dt_s)

    def _other_way_round(self, seen: Observation, pose: Pose) -> Hypothesis:
        """Return the body turned round or with sides exchanged, one kind after another."""
        body, kind = seen.body, self._kind % 6
        self._kind += 1
        self._unchecked = max(self._unchecked - 1, 0)
        if kind in (0, 3):
            return Hypothesis(exchanged(body, pose, WITH_SIDES), "left and right exchanged")
        if kind == 1:
            return Hypothesis(turned_around(pose), "the body facing the other way")
        if kind == 2:
            return Hypothesis(exchanged(body, pose, WITH_LEGS), "left and right leg exchanged")
        if kind == 4 or self._last_good is None:
            return Hypothesis(exchanged(body, pose, WITH_ARMS), "left and right arm exchanged")
        return Hypothesis(moved_to(self._last_good, seen.data.hull), "the last good pose")

    def _stance(self, seen: Observation, turn: int) -> Hypothesis:
        """Return the best of a few stances; the next set tries others."""
        every = stances(seen.body, seen.data.hull)
        parts = len(every) // STANCES_A_SET
        best = min(every[turn % parts :: parts], key=lambda pose: seen.evidence_of(pose).cost)
        return Hypothesis(best, "the body found anew")

    def with_other(self, quality: TrackQuality) -> TrackQuality:
        """Return the quality with all parts doubtful while the alternative may be right, or while a body that was lost
        has not been compared with other poses."""
        other, reasons = self.other, [quality.reason] if quality.reason else []
        if other is not None:
            quality = replace(quality, hypothesis_margin=other.margin)
        if quality.state == LOST:
            return quality
        if other is not None and other.probability > BODY_DOUBTFUL:
            reasons.append(f"{other.why} would explain {other.margin:.0f} rays more")
        elif self._unchecked > 0:
            reasons.append("found again, other poses are being tried")
        else:
            return quality
        return replace(quality, state=DOUBTFUL, parts=(DOUBTFUL,) * len(PART_NAMES), reason="; ".join(reasons))

    def with_misfit(self, quality: TrackQuality) -> TrackQuality:
        """Return the quality with no part better than doubtful if the smoothed share of explained rays is too low."""
        if self._recent_share > MISFIT_SHARE or GOOD not in quality.parts:
            return quality
        reasons = [f"the body explains only {100 * quality.explained:.0f} % of the outlines", quality.reason]
        parts = tuple(DOUBTFUL if part == GOOD else part for part in quality.parts)
        return replace(quality, parts=parts, reason="; ".join(filter(None, reasons)))


def _updated(other: Hypothesis, margin: float, dt_s: float) -> Hypothesis:
    """Return the hypothesis after a set in which it explained ``margin`` rays more than the tracked pose."""
    gain = 1.0 - math.exp(-dt_s / limb_filter.MEMORY_S)
    most = 2.0 * limb_filter.SET_NATS  # of a whole body: a tear reaches one part of it
    nats = min(max(margin / RAYS_PER_NAT, -most), most)
    return replace(other, log_odds=other.log_odds + gain * (BODY_LOG_PRIOR + nats - other.log_odds), margin=margin)
