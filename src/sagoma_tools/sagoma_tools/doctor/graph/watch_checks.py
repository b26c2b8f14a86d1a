"""The running figures that nodes publish beside their message, which names the gravest trouble alone."""

from __future__ import annotations

import json
from collections.abc import Iterator

from camera_client.camera_moved import State
from capture_rig.verdict import REDO, USABLE

from ..findings import Finding, note, ok, warning
from .facts import NodeFacts

OLD_BACKGROUND_H = 12.0
LEARN = "sagoma background, while the room is empty"
PUT_BACK = "Put the camera back as it was, or: sagoma calibrate extrinsics"


def check_watch(node: NodeFacts) -> Iterator[Finding]:
    """Age of the background, and whether the camera stands as it did when it was calibrated."""
    age_h = _figure(node, "background_age_h")
    if age_h is not None and age_h > OLD_BACKGROUND_H:
        yield warning("background", f"it is {age_h:.0f} h old: the light has changed since", LEARN)
    elif age_h is not None:
        yield ok("background", f"it is {age_h:.1f} h old")
    yield from _check_lesson(node)
    shift_px, turn_deg = _figure(node, "camera_shift_px"), _figure(node, "camera_turn_deg")
    if shift_px is None or turn_deg is None:
        return
    text = f"its picture is shifted by {shift_px:.1f} px and turned by {turn_deg:.2f} degrees since its background"
    if node.values.get("camera_moved") == State.MOVED.value:
        yield warning("moved", text, PUT_BACK)
    else:
        yield ok("moved", text)


def _check_lesson(node: NodeFacts) -> Iterator[Finding]:
    """What came of learning the background, if it was learned since the node's start."""
    try:
        lesson = json.loads(node.values["background_lesson"])
        grade, findings = lesson["grade"], lesson["findings"]
        why = "; ".join(f"{finding['what']} ({finding['remedy']})" for finding in findings)
    except (KeyError, TypeError, ValueError):  # none was learned, or not by this version
        return
    if grade == REDO:
        yield warning("background", f"the last lesson failed: {why}", LEARN)
    elif grade == USABLE:
        yield note("background", f"usable, not good: {why}", LEARN)


def check_standing(hull: NodeFacts, camera: str) -> Iterator[Finding]:
    """Whether this camera stands as its calibration says, by the silhouettes of the others (hull server)."""
    push_deg = _figure(hull, f"calibration_push_deg_{camera}")
    if push_deg is None:
        return
    sd_deg, share = (
        _figure(hull, f"calibration_push_sd_deg_{camera}"),
        _figure(hull, f"calibration_consistency_{camera}"),
    )
    known = "" if sd_deg is None else f" (sd {sd_deg:.2f})"
    agrees = "" if share is None else f"; agrees with them in {100 * share:.0f} %"
    text = f"by the others' silhouettes it is {push_deg:.2f} degrees{known} off its calibration{agrees}"
    if camera in hull.values.get("calibration_suspects", "").split(","):
        yield warning("calibration", text, PUT_BACK)
    else:
        yield ok("calibration", text)


def _figure(node: NodeFacts, key: str) -> float | None:
    """The number under ``key``; None where there is none, or the node cannot tell."""
    try:
        return float(node.values[key])
    except (KeyError, ValueError):
        return None
