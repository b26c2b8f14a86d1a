"""Whether the track is good, doubtful or lost, of the whole body and of each limb, and why."""

from __future__ import annotations

from dataclasses import dataclass, replace

from .challenger import Challenger
from .evidence import LEFT_ARM, PART_NAMES, TRUNK, Evidence

GOOD, DOUBTFUL, LOST = "good", "doubtful", "lost"

LOST_SHARE = 0.35  # of the outline: what hardly any wrong pose explains less of
LOST_FALL, DOUBTFUL_FALL = 0.30, 0.15  # below the share that this body usually explains
OUTSIDE_LIMB = 2  # of a limb's six points: so many outside the hull are no accident
CONTESTED_SETS = 3  # sets in which another pose must have led before it is a reason for doubt
USUAL_SETS = 300.0  # the usual share is the mean over about so many good sets


@dataclass(frozen=True)
class TrackQuality:
    """state : "good", "doubtful" or "lost", of the whole body; reason : why, empty when good.

    parts (5,) states of trunk, arms and legs; explained : share of the outline's rays that the pose explains;
    rival_lead : rays that the best other pose explains more, over several sets; None without a rival.
    """

    state: str
    reason: str
    parts: tuple[str, ...]
    explained: float
    rival_lead: float | None = None


UNKNOWN = TrackQuality(GOOD, "", (GOOD,) * 5, 1.0)
"""Of a fit that was not examined."""


class Usual:
    """The share of the outline that this body explains when it is tracked well: cameras and shadows differ."""

    def __init__(self) -> None:
        self.share: float | None = None
        self._sets = 0.0

    def add(self, share: float) -> None:
        """One more good set."""
        self._sets = min(self._sets + 1.0, USUAL_SETS)
        self.share = share if self.share is None else self.share + (share - self.share) / self._sets


def judge(evidence: Evidence, usual: float | None) -> TrackQuality:
    """The state of a pose, from its evidence and the share of rays that is usual for this body."""
    share = evidence.share
    fall = 0.0 if usual is None else usual - share
    parts, reasons = _parts(evidence)
    explains = f"the body explains {100 * share:.0f} % of the outlines"
    if usual is not None:
        explains += f", {100 * usual:.0f} % is usual"
    if share < LOST_SHARE or fall > LOST_FALL:
        return TrackQuality(LOST, explains, (LOST,) * len(PART_NAMES), share)
    if fall > DOUBTFUL_FALL:
        reasons.insert(0, explains)
        parts[TRUNK] = DOUBTFUL
    return TrackQuality(DOUBTFUL if reasons else GOOD, "; ".join(reasons), tuple(parts), share)


def contested(quality: TrackQuality, rival: Challenger, lead_rays: float) -> TrackQuality:
    """The quality with a rival pose beside it: doubtful where they differ once the rival leads for a few sets."""
    if rival.sets == 0:
        return quality
    quality = replace(quality, rival_lead=rival.lead)
    if rival.sets < CONTESTED_SETS or rival.lead < lead_rays or quality.state == LOST:
        return quality
    parts = list(quality.parts)
    for part in range(len(PART_NAMES)) if rival.part is None else [rival.part]:
        parts[part] = DOUBTFUL
    reason = f"{rival.why} would explain {rival.lead:.0f} rays more"
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
