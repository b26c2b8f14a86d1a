"""Where a graph's first pose comes from, as parameters of its ICP tracker."""

from __future__ import annotations

from typing import Any

from capture_rig.errors import InputError
from capture_rig.session import Session

AUTO_START, T_POSE_START, REFERENCE_START = "auto", "t_pose", "session"
STARTS = (AUTO_START, T_POSE_START, REFERENCE_START)


def start_settings(session: Session | None, start: str = AUTO_START) -> dict[str, Any]:
    """Return the ICP tracker's settings for the source of its first pose.

    start : "t_pose", "session" (its reference), or "auto": the reference where the session has one that was made from
    its footage (``reference*.csv``), else a T-pose or whoever walks in, as for live cameras.

    Raises InputError without a reference to start from.
    """
    truth = None if session is None else session.truth
    if start == AUTO_START and truth is not None and truth.source.name.startswith("reference"):
        start = REFERENCE_START
    if start != REFERENCE_START:
        return {"icp_tracker.initial_pose.source": start}
    if session is None or truth is None:
        where = "live cameras" if session is None else str(session.folder)
        raise InputError("has no reference to start from", where=where, remedy="Start from a T-pose.")
    return {
        "icp_tracker.initial_pose.source": REFERENCE_START,
        "icp_tracker.initial_pose.session": str(session.folder.resolve()),
        "icp_tracker.initial_pose.frame": int(truth.frames[0]),
    }
