"""A second opinion about the pose, followed beside the first until the evidence of several frame sets decides."""

from __future__ import annotations

from dataclasses import dataclass

from stick_figure.pose import Pose

from .evidence import Evidence


@dataclass(frozen=True, eq=False)
class Challenger:
    """Another pose, and what speaks for it.

    why : in words, what differs. part : of evidence.PART_NAMES if one limb alone differs, else None. evidence : about
    the pose at the last set. sets : frame sets it has been compared in; lead : mean over them of its lead over
    the followed pose, in rays (Evidence.lead_of).
    """

    pose: Pose
    why: str
    part: int | None
    evidence: Evidence | None = None
    sets: int = 0
    lead: float = 0.0

    def compared(self, pose: Pose, evidence: Evidence, followed: Evidence) -> Challenger:
        """One more frame set: its pose there, the evidence about it, and about the followed pose."""
        sets = self.sets + 1
        lead = self.lead + (followed.lead_of(evidence) - self.lead) / sets
        return Challenger(pose, self.why, self.part, evidence, sets, lead)
