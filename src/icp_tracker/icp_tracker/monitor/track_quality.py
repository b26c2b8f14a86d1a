"""Whether the track is good, doubtful or lost, of the whole body and of each limb, and why."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass, replace

import numpy as np

from mocap_packets.fit import DOUBTFUL, GOOD, LOST, PART_NAMES, PART_POINTS, TrackQuality
from stick_figure.pose import Pose
from stick_figure.skeleton import STICK_NAMES

from .evidence import LEFT_ARM, PART_OF_STICK, TRUNK, Evidence
from .limb_search import LimbPlaces
from .pose_library import LIMB_POINTS, LIMBS, LOWER_STICKS

# --- hypotheses: other poses, followed beside the first until the evidence of several frame sets decides


ALL_PARTS = (True,) * len(PART_NAMES)


@dataclass(frozen=True, eq=False)
class Hypothesis:
    """Another pose of the body, and what speaks for it.

    why : in words, what differs. evidence : about the pose at the last set. sets, seconds : frame sets it has been
    compared in, and the time between them; margin : mean over them of its lead over the followed pose, in rays
    (Evidence.margin_of). moved (5,) bool : the parts that are elsewhere in it; the others are fitted to them.
    """

    pose: Pose
    why: str
    moved: tuple[bool, ...] = ALL_PARTS
    evidence: Evidence | None = None
    sets: int = 0
    seconds: float = 0.0
    margin: float = 0.0

    def compared(self, pose: Pose, evidence: Evidence, followed: Evidence, apart_s: float) -> Hypothesis:
        """Return one more frame set, so long after the last: its pose, the evidence about it and the followed pose."""
        sets = self.sets + 1
        margin = self.margin + (followed.margin_of(evidence) - self.margin) / sets
        return replace(self, pose=pose, evidence=evidence, sets=sets, seconds=self.seconds + apart_s, margin=margin)


LOST_SHARE = 0.35  # of the outline: what hardly any wrong pose explains less of
LOST_DROP, DOUBTFUL_DROP = 0.30, 0.15  # below the share that this body usually explains
OUTSIDE_LIMB = 3  # of a limb's six points: so many outside the hull are no foot that shadows cut off
CONTESTED_SETS, CONTESTED_S = 2, 0.04  # in which another pose must have led before it is a reason for doubt
BASELINE_SETS = 300.0  # what is usual is the mean over about so many good sets
# an arm before the trunk, in three cameras, keeps a quarter of its usual rays, a calf without a hull a tenth (44 000
# limbs of 27 sets of bench/people.py: 1 in 10 000 right ones below a fifth); of fewer usual rays the share says nothing
SEEN_SHARE, USUAL_RAYS = 0.2, 20.0
# a forearm or calf that so few rays speak for, and so few of its usual ones, is where the hull lets it be: before three
# and four cameras (73 sets) a ninth of the wrong limbs that nothing else called, and 1 in 2000 of the right ones
FAINT_SHARE, FAINT_RAYS = 0.3, 12.0


class Baseline:
    """What of the outlines this body explains when it is tracked well: cameras and shadows differ.

    share : of the rays, None before the first good set; rays (10,) : those of each stick.
    """

    def __init__(self) -> None:
        self.share: float | None = None
        self.rays = np.zeros(len(PART_OF_STICK))
        self._sets = 0.0

    def add(self, evidence: Evidence) -> None:
        """One more good set."""
        self._sets = min(self._sets + 1.0, BASELINE_SETS)
        share = evidence.share
        self.share = share if self.share is None else self.share + (share - self.share) / self._sets
        self.rays += (evidence.explained - self.rays) / self._sets

    def share_of_usual(self, evidence: Evidence) -> np.ndarray:
        """Return (4,), limb by limb, how much of its usual rays speaks for its forearm or calf; NaN where that says
        nothing."""
        usual = self.rays[LOWER_STICKS]
        return np.where(usual > USUAL_RAYS, evidence.explained[LOWER_STICKS] / np.maximum(usual, 1.0), np.nan)

    def unseen_sticks(self, evidence: Evidence) -> np.ndarray:
        """Return (10,) bool: forearms and calves that hardly a ray speaks for, unlike before.

        Where their hull is missing (behind a thing in the room that one camera takes for background, a part that is
        taken for shadow) no place in it is right; nor is one that is found elsewhere in the hull.
        """
        return _sticks(self.share_of_usual(evidence) < SEEN_SHARE)

    def faint_sticks(self, evidence: Evidence) -> np.ndarray:
        """Return (10,) bool: forearms and calves that too few rays speak for to tell one place from another."""
        share = self.share_of_usual(evidence)
        return _sticks((share < SEEN_SHARE) | (share < FAINT_SHARE) & (evidence.explained[LOWER_STICKS] < FAINT_RAYS))


def _sticks(limbs: np.ndarray) -> np.ndarray:
    """Return the forearms and calves (10,) bool of limbs (4,) bool."""
    sticks = np.zeros(len(PART_OF_STICK), bool)
    sticks[LOWER_STICKS] = limbs
    return sticks


def unseen_points(sticks: np.ndarray) -> np.ndarray:
    """Return the reference points (15,) bool that only sticks (10,) which are not seen could place: hands and feet."""
    points = np.zeros(15, bool)
    points[LIMB_POINTS[:, -1]] = sticks[LOWER_STICKS]
    return points


def points_of_limbs(limbs: np.ndarray) -> np.ndarray:
    """Return the reference points (15,) bool that limbs (4,) bool of LIMBS hold alone."""
    points = np.zeros(15, bool)
    points[LIMB_POINTS] = limbs[:, None]
    return points


def with_faint_limbs(quality: TrackQuality, evidence: Evidence, baseline: Baseline) -> TrackQuality:
    """Return the quality with limbs doubtful whose forearm or calf too few rays speak for."""
    faint = np.flatnonzero(baseline.faint_sticks(evidence)).tolist()
    return _with_doubts(quality, [(PART_OF_STICK[stick], _shown_by(stick, evidence, baseline)) for stick in faint])


def with_torn_limbs(quality: TrackQuality, torn: np.ndarray) -> TrackQuality:
    """Return the quality with limbs (4,) bool doubtful that lost their rays as they left the places where they were
    expected."""
    parts = [limb.part for limb, lost in zip(LIMBS, torn, strict=True) if lost]
    return _with_doubts(quality, [(part, f"{PART_NAMES[part]}: its rays are gone") for part in parts])


def _with_doubts(quality: TrackQuality, doubts: Iterable[tuple[int, str]]) -> TrackQuality:
    """Return the quality with parts of the body doubtful that were good, each with its reason."""
    parts, reasons = list(quality.parts), [quality.reason] if quality.reason else []
    for part, reason in doubts:
        if parts[part] == GOOD:
            parts[part] = DOUBTFUL
            reasons.append(reason)
    if tuple(parts) == quality.parts:
        return quality
    return replace(quality, state=DOUBTFUL, parts=tuple(parts), reason="; ".join(reasons))


def unchecked_quality(quality: TrackQuality) -> TrackQuality:
    """Return the quality of a body that was lost a moment ago and may have been found the wrong way round."""
    if quality.state == LOST:
        return quality
    reason = "; ".join(filter(None, (quality.reason, "found again, other poses are being tried")))
    return replace(quality, state=DOUBTFUL, parts=(DOUBTFUL,) * len(PART_NAMES), reason=reason)


def judge_track(evidence: Evidence, baseline: Baseline) -> TrackQuality:
    """Return the state of a pose, from its evidence and what is usual for this body."""
    share = evidence.share
    drop = 0.0 if baseline.share is None else baseline.share - share
    parts, reasons = _parts(evidence, baseline)
    explains = f"the body explains {100 * share:.0f} % of the outlines"
    if baseline.share is not None:
        explains += f", {100 * baseline.share:.0f} % is usual"
    if share < LOST_SHARE or drop > LOST_DROP:
        return TrackQuality(LOST, explains, (LOST,) * len(PART_NAMES), share)
    if drop > DOUBTFUL_DROP:
        reasons.insert(0, explains)
        parts[TRUNK] = DOUBTFUL
    return TrackQuality(DOUBTFUL if reasons else GOOD, "; ".join(reasons), tuple(parts), share)


def contested(quality: TrackQuality, hypothesis: Hypothesis, margin_rays: float) -> TrackQuality:
    """Return the quality beside a hypothesis about the whole body: doubtful once its margin has held for a few sets."""
    if hypothesis.sets == 0:
        return quality
    quality = replace(quality, hypothesis_margin=hypothesis.margin)
    lasting = hypothesis.sets >= CONTESTED_SETS and hypothesis.seconds >= CONTESTED_S
    if not lasting or hypothesis.margin < margin_rays or quality.state == LOST:
        return quality
    reason = f"{hypothesis.why} would explain {hypothesis.margin:.0f} rays more"
    parts = (DOUBTFUL,) * len(PART_NAMES)
    return replace(quality, state=DOUBTFUL, parts=parts, reason="; ".join(filter(None, (quality.reason, reason))))


# --- limbs that may be elsewhere


# rays: a limb is doubtful while another place explains no less than so much more than its own, and its forearm or calf
# less than such a share of its usual rays; chosen where bench/doubt.py calls most wrong limbs for one clear frame in a
# hundred
DOUBTFUL_MARGIN, CERTAIN_SHARE = -2.0, 0.8
# ... of somebody whose part of the hull is another person's, too: much of what a place explains is the other one's
SHARED_MARGIN = -10.0


def doubtful_limbs(
    places: Mapping[int, LimbPlaces], share_of_usual: np.ndarray, shared: bool = False
) -> frozenset[int]:
    """Return the limbs, by their number in LIMBS, that may as well be elsewhere.

    share_of_usual (4,) : of :class:`Baseline`. ``shared`` : in a hull of several persons, whose rays may be another's.
    """
    least = SHARED_MARGIN if shared else DOUBTFUL_MARGIN
    certain = np.zeros(len(LIMBS), bool) if shared else share_of_usual > CERTAIN_SHARE
    return frozenset(n for n, other in places.items() if other.margin_elsewhere > least and not certain[n])


def with_doubtful_limbs(
    quality: TrackQuality, doubtful: Collection[int], places: Mapping[int, LimbPlaces]
) -> TrackQuality:
    """Return the quality with these limbs doubtful, by their number in LIMBS, and why."""
    margins = [-np.inf] * len(PART_NAMES)
    for number, other in places.items():
        margins[LIMBS[number].part] = other.margin_elsewhere
    doubts = [(LIMBS[number].part, _elsewhere(LIMBS[number].part, places[number])) for number in sorted(doubtful)]
    return _with_doubts(replace(quality, margins=tuple(margins)), doubts)


def _elsewhere(part: int, other: LimbPlaces) -> str:
    return f"{PART_NAMES[part]}: a place {100 * other.apart_m[0]:.0f} cm away explains {other.margins[0]:+.0f} rays"


def limb_spread(quality: TrackQuality, places: Mapping[int, LimbPlaces]) -> np.ndarray | None:
    """Return the second moment (15, 3, 3) m^2, about where they are tracked, of where the points of doubtful limbs may
    be: each place as likely as the rays say that it explains. None without a doubtful limb."""
    spread = np.zeros((15, 3, 3))
    for number, other in places.items():
        part = LIMBS[number].part
        if quality.parts[part] != DOUBTFUL or len(other.margins) == 0:
            continue
        odds = np.exp(np.clip(other.margins / EVEN_RAYS, -MOST_ODDS, MOST_ODDS))
        belief = odds / (1.0 + odds.sum())
        offsets = other.ends - other.tracked
        spread[list(PART_POINTS[part])] = np.einsum("k,kpi,kpj->pij", belief, offsets, offsets)
    return spread if spread.any() else None


def _parts(evidence: Evidence, baseline: Baseline) -> tuple[list[str], list[str]]:
    parts, reasons = [GOOD] * len(PART_NAMES), []
    for stick in np.flatnonzero(baseline.unseen_sticks(evidence)).tolist():
        part = PART_OF_STICK[stick]
        parts[part] = DOUBTFUL
        reasons.append(_shown_by(stick, evidence, baseline))
    for part in range(LEFT_ARM, len(PART_NAMES)):
        outside = int(evidence.outside[part])
        if outside >= OUTSIDE_LIMB:
            parts[part] = DOUBTFUL
            reasons.append(
                f"{PART_NAMES[part]}: {outside} of 6 points outside the hull, "
                f"{evidence.unexplained[part]} rays unexplained near it"
            )
    return parts, reasons


def _shown_by(stick: int, evidence: Evidence, baseline: Baseline) -> str:
    shown, usual = evidence.explained[stick], baseline.rays[stick]
    return f"{PART_NAMES[PART_OF_STICK[stick]]}: {shown} of {usual:.0f} rays show its {STICK_NAMES[stick]}"


# --- what is doubtful, as covariance

OUTSIDE_SD_M = 0.15  # a limb that leaves the hull, or may be elsewhere, may be anywhere about its place
EVEN_RAYS = 3.0  # margin at which the other pose is about three times as likely
MOST_ODDS = 2.0  # however many rays speak for one place, the others are not out of the question: 1 to 7


def widened_covariance(
    covariance: np.ndarray,
    quality: TrackQuality,
    points_world: np.ndarray,
    hypothesis_points_world: np.ndarray | None,
    spread: np.ndarray | None = None,
) -> np.ndarray:
    """Return the covariance (15, 3, 3) m^2 of points (15, 3) with what is doubtful about them.

    With a hypothesis that makes the track doubtful, a point is in one of two places: covariance
    p (1 - p) d d^T, d the way to the other one, p the belief in it. Without one, points of a doubtful part are
    uncertain by OUTSIDE_SD_M. spread (15, 3, 3) m^2 : of where doubtful limbs may be, besides.
    """
    widened = covariance.copy() if spread is None else covariance + spread
    for points, state in zip(PART_POINTS, quality.parts, strict=True):
        if state != GOOD and hypothesis_points_world is None:
            widened[list(points)] += OUTSIDE_SD_M**2 * np.eye(3)
    if hypothesis_points_world is not None and quality.hypothesis_margin is not None and quality.state != GOOD:
        p = 1.0 / (1.0 + np.exp(-quality.hypothesis_margin / EVEN_RAYS))
        d = hypothesis_points_world - points_world
        widened += p * (1.0 - p) * d[:, :, None] * d[:, None, :]
    return widened
