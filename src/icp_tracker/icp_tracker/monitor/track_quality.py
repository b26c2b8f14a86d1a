"""Whether the track is good, doubtful or lost, of the whole body and of each limb, and why."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from mocap_packets.fit import DOUBTFUL, GOOD, LOST, PART_NAMES, PART_POINTS, TrackQuality
from stick_figure.pose import Pose

from .evidence import LEFT_ARM, TRUNK, Evidence

# --- hypotheses: other poses, followed beside the first until the evidence of several frame sets decides


@dataclass(frozen=True, eq=False)
class Hypothesis:
    """Another pose, and what speaks for it.

    why : in words, what differs. part : of evidence.PART_NAMES if one limb alone differs, else None. evidence : about
    the pose at the last set. sets, seconds : frame sets it has been compared in, and the time between them; margin :
    mean over them of its lead over the followed pose, in rays (Evidence.margin_of).
    """

    pose: Pose
    why: str
    part: int | None
    evidence: Evidence | None = None
    sets: int = 0
    seconds: float = 0.0
    margin: float = 0.0

    def compared(self, pose: Pose, evidence: Evidence, followed: Evidence, apart_s: float) -> Hypothesis:
        """Return one more frame set, so long after the last: its pose, the evidence about it and the followed pose."""
        sets = self.sets + 1
        margin = self.margin + (followed.margin_of(evidence) - self.margin) / sets
        return Hypothesis(pose, self.why, self.part, evidence, sets, self.seconds + apart_s, margin)


LOST_SHARE = 0.35  # of the outline: what hardly any wrong pose explains less of
LOST_DROP, DOUBTFUL_DROP = 0.30, 0.15  # below the share that this body usually explains
OUTSIDE_LIMB = 2  # of a limb's six points: so many outside the hull are no accident
CONTESTED_SETS, CONTESTED_S = 2, 0.04  # in which another pose must have led before it is a reason for doubt
BASELINE_SETS = 300.0  # the usual share is the mean over about so many good sets


class Baseline:
    """The share of the outline that this body explains when it is tracked well: cameras and shadows differ."""

    def __init__(self) -> None:
        self.share: float | None = None
        self._sets = 0.0

    def add(self, share: float) -> None:
        """One more good set."""
        self._sets = min(self._sets + 1.0, BASELINE_SETS)
        self.share = share if self.share is None else self.share + (share - self.share) / self._sets


def judge_track(evidence: Evidence, baseline: float | None) -> TrackQuality:
    """Return the state of a pose, from its evidence and the share of rays that is usual for this body."""
    share = evidence.share
    drop = 0.0 if baseline is None else baseline - share
    parts, reasons = _parts(evidence)
    explains = f"the body explains {100 * share:.0f} % of the outlines"
    if baseline is not None:
        explains += f", {100 * baseline:.0f} % is usual"
    if share < LOST_SHARE or drop > LOST_DROP:
        return TrackQuality(LOST, explains, (LOST,) * len(PART_NAMES), share)
    if drop > DOUBTFUL_DROP:
        reasons.insert(0, explains)
        parts[TRUNK] = DOUBTFUL
    return TrackQuality(DOUBTFUL if reasons else GOOD, "; ".join(reasons), tuple(parts), share)


def contested(quality: TrackQuality, hypothesis: Hypothesis, margin_rays: float) -> TrackQuality:
    """Return the quality beside a hypothesis: doubtful where they differ once its margin has held for a few sets."""
    if hypothesis.sets == 0:
        return quality
    quality = replace(quality, hypothesis_margin=hypothesis.margin)
    lasting = hypothesis.sets >= CONTESTED_SETS and hypothesis.seconds >= CONTESTED_S
    if not lasting or hypothesis.margin < margin_rays or quality.state == LOST:
        return quality
    parts = list(quality.parts)
    for part in range(len(PART_NAMES)) if hypothesis.part is None else [hypothesis.part]:
        parts[part] = DOUBTFUL
    reason = f"{hypothesis.why} would explain {hypothesis.margin:.0f} rays more"
    return replace(
        quality, state=DOUBTFUL, parts=tuple(parts), reason="; ".join(filter(None, (quality.reason, reason)))
    )


def _parts(evidence: Evidence) -> tuple[list[str], list[str]]:
    parts, reasons = [GOOD] * len(PART_NAMES), []
    for part in range(LEFT_ARM, len(PART_NAMES)):
        outside = int(evidence.outside[part])
        if outside >= OUTSIDE_LIMB:
            parts[part] = DOUBTFUL
            reasons.append(
                f"{PART_NAMES[part]}: {outside} of 6 points outside the hull, "
                f"{evidence.unexplained[part]} rays unexplained near it"
            )
    return parts, reasons


# --- what is doubtful, as covariance

OUTSIDE_SD_M = 0.15  # a limb that leaves the hull may be anywhere about its place
EVEN_RAYS = 3.0  # margin at which the other pose is about three times as likely


def widened_covariance(
    covariance: np.ndarray, quality: TrackQuality, points_world: np.ndarray, hypothesis_points_world: np.ndarray | None
) -> np.ndarray:
    """Return the covariance (15, 3, 3) m^2 of points (15, 3) with what is doubtful about them.

    With a hypothesis that makes the track doubtful, a point is in one of two places: covariance
    p (1 - p) d d^T, d the way to the other one, p the belief in it. Without one, points of a doubtful part are
    uncertain by OUTSIDE_SD_M.
    """
    widened = covariance.copy()
    for points, state in zip(PART_POINTS, quality.parts, strict=True):
        if state != GOOD and hypothesis_points_world is None:
            widened[list(points)] += OUTSIDE_SD_M**2 * np.eye(3)
    if hypothesis_points_world is not None and quality.hypothesis_margin is not None and quality.state != GOOD:
        p = 1.0 / (1.0 + np.exp(-quality.hypothesis_margin / EVEN_RAYS))
        d = hypothesis_points_world - points_world
        widened += p * (1.0 - p) * d[:, :, None] * d[:, None, :]
    return widened
