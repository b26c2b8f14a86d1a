"""Checks one node: answers, diagnostics, lifecycle state, clock, background, camera movement, calibration."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Iterator

from camera_client.condition_findings import KEY as FINDINGS_KEY
from camera_client.condition_findings import read_findings
from camera_client.movement.detector import MovementState
from capture_rig.verdict import GOOD, REDO, USABLE

from ...graph.diagnostics_table import NodeReport
from ..findings import Finding, error, note, ok, warning
from .facts import ERROR, WARN, GraphFacts, NodeFacts

CAMERA_NODE = "camera_client"
ACTIVE = "active"
REPORT_HZ, RARE_HZ, FEW_REPORTS = 1.0, 0.7, 4
CLOCK_LIMIT_S = 5e-3  # a third of a frame period at 60 Hz
USUAL_PERIOD_S = 1 / 30
BUSY_PERCENT = 95.0
ACQUIRING = "acquiring"  # how the trackers' messages begin until they have a person
EMPTY = ("mask is empty", "empty silhouette", "hull is empty")
RECOVERY = "docs/recovery.md"
PAGES = {"/hull_server": "docs/camera_faults.md", "/icp_tracker": RECOVERY, "/ekf_tracker": RECOVERY}
START = "sagoma start (or sagoma up, where no process runs)"
UNREACHABLE = "Look for its process and log there; for the way: sagoma doctor --host ADDRESS, firewall, cable."
BIG_MESSAGES = (
    "Large messages get lost: one MTU on all machines (sagoma doctor --host ADDRESS), "
    "FASTRTPS_DEFAULT_PROFILES_FILE=config/dds/fastdds.xml, and UDP open between them."
)


def camera_node(camera: str) -> str:
    """Return the fully qualified name of a camera's client."""
    return f"/{camera}/{CAMERA_NODE}"


def camera_of(node: str) -> str:
    """Return the camera of a client node; "" for another node."""
    space, _, name = node.rpartition("/")
    return space.strip("/") if name == CAMERA_NODE else ""


def check_alone(node: NodeFacts, facts: GraphFacts) -> Iterator[Finding]:
    """Check that no other node has its name."""
    if node.copies > 1:
        places = Counter(map(facts.machine_name, node.machines))
        listed = ", ".join(place if count == 1 else f"{count} {place}" for place, count in places.items())
        where = f" ({listed})" if listed else ""
        remedy = "Stop all but one: the same camera or server was started twice, or two set-ups share a ROS_DOMAIN_ID."
        yield error("node.duplicate", f"{node.copies} nodes call themselves {node.name}{where}", remedy)


def check_node(node: NodeFacts, room_empty: bool = False) -> Iterator[Finding]:
    """Check that it answers, reports, is active and well; ``room_empty``: no camera sees a person, masks are empty."""
    if node.state is None and not node.reports:
        text = f"{node.name} is known, but neither answers nor reports: it died, hangs, or its packets do not get here"
        yield error("node.silent", text, UNREACHABLE)
        return
    if node.state is None:
        yield warning(
            "node.unresponsive", f"{node.name} reports, but does not answer questions: it is busy or hangs", UNREACHABLE
        )
    elif not node.reports:
        yield error("diagnostics.missing", f"{node.name} answers, but its diagnostics do not arrive", BIG_MESSAGES)
    if node.state not in (None, ACTIVE):
        yield warning("state.inactive", f"it is {node.state}", START)
    if node.reports:
        yield _message_finding(node, room_empty)
        yield from _check_work(node)


def check_clock(node: NodeFacts, here: str, period_s: float | None) -> Iterator[Finding]:
    """Bound its clock's offset from this machine's: a report takes between nothing and one round trip to arrive."""
    if not node.lead_s:
        return
    trip_s = node.round_trip_s or 0.0
    low, high = max(node.lead_s), max(node.lead_s) + trip_s
    off_s = low if low > 0 else min(high, 0.0)  # what is certain
    clock = "its clock" if node.machine != here else "its clock (though it runs on this machine)"
    way = "ahead of" if off_s > 0 else "behind"
    what = f"{clock} is {_time(abs(off_s))} {way} this machine's, at the least (known to {_time(trip_s)})"
    remedy = "chrony or PTP on all machines, with one source: frame sets are formed by stamps."
    if abs(off_s) > (period_s or USUAL_PERIOD_S) / 2:
        yield error("clock.off", what, remedy)
    elif abs(off_s) > CLOCK_LIMIT_S:
        yield warning("clock.imprecise", what, remedy)
    elif trip_s > 2 * CLOCK_LIMIT_S:
        yield note(
            "clock.unknown", f"no offset is found, but answers take {_time(trip_s)}: it cannot be measured more closely"
        )
    else:
        yield ok("clock", f"{1e3 * low:+.1f} to {1e3 * high:+.1f} ms from this machine's")


def _message_finding(node: NodeFacts, room_empty: bool) -> Finding:
    if node.message in {finding.line for finding in read_findings(node.values.get(FINDINGS_KEY, ""))}:
        return ok("says", "what its background's findings say")
    if node.level >= ERROR:
        return error("says.error", node.message, _remedy(node))
    if node.level < WARN:
        return ok("says", node.message)
    if node.message.startswith(ACQUIRING):
        return note("says.acquiring", node.message, "" if room_empty else "Stand in the T-pose: docs/acquisition.md.")
    if room_empty and any(words in node.message for words in EMPTY):
        return note("says.room_empty", f"{node.message} (the room is empty)")
    return warning("says.warning", node.message, _remedy(node))


def _check_work(node: NodeFacts) -> Iterator[Finding]:
    if node.reports >= FEW_REPORTS and node.rate_hz < RARE_HZ:
        text = f"come {node.rate_hz:.1f} times a second instead of {REPORT_HZ:.0f}: it is busy, or they get lost"
        yield warning("diagnostics.rare", text, BIG_MESSAGES)
    busy = node.values.get("cpu_percent", "")
    if busy.isdigit() and float(busy) > BUSY_PERCENT:
        yield note("load.high", f"it uses {busy} % of a core")
    losses = NodeReport(bytes([node.level]), node.message, node.values).losses()
    if losses:
        counters = ", ".join(f"{count} {key}" for key, count in losses.items())
        yield note("lost.counted", f"since its start: {counters}")


def _remedy(node: NodeFacts) -> str:
    page = "docs/camera_pcs.md" if camera_of(node.name) else PAGES.get(node.name, "")
    return f"See {page}." if page else "See its log."


def _time(seconds: float) -> str:
    return f"{seconds:.2f} s" if seconds >= 1 else f"{1e3 * seconds:.1f} ms"


OLD_BACKGROUND_H = 12.0
LEARN = "sagoma background, while the room is empty"
OF_GRADE = {GOOD: note, USABLE: warning, REDO: error}
PUT_BACK = "Put the camera back as it was, or: sagoma calibrate extrinsics"


def check_watch(node: NodeFacts) -> Iterator[Finding]:
    """Check whether a camera's background still fits, and whether it moved since that was trained."""
    age_h = _figure(node, "background_age_h")
    yield from _check_findings(node)
    if age_h is not None and age_h > OLD_BACKGROUND_H:
        yield warning("background.old", f"it is {age_h:.0f} h old: the light has changed since", LEARN)
    elif age_h is not None:
        yield ok("background", f"it is {age_h:.1f} h old")
    yield from _check_training(node)
    shift_px, turn_deg = _figure(node, "camera_shift_px"), _figure(node, "camera_turn_deg")
    if shift_px is None or turn_deg is None:
        return
    text = f"its picture is shifted by {shift_px:.1f} px and turned by {turn_deg:.2f} degrees since its background"
    if node.values.get("camera_moved") == MovementState.MOVED.value:
        yield warning("moved.shifted", text, PUT_BACK)
    else:
        yield ok("moved", text)


def _check_findings(node: NodeFacts) -> Iterator[Finding]:
    """Report what the client itself finds against its background, by the client's codes; its age is checked here."""
    for finding in read_findings(node.values.get(FINDINGS_KEY, "")):
        if finding.code != "background.old":
            yield OF_GRADE[finding.grade](finding.code, finding.what, finding.remedy)


def _check_training(node: NodeFacts) -> Iterator[Finding]:
    """Report the verdict of the last background training since the node's start."""
    try:
        training = json.loads(node.values["background_training"])
        grade, findings = training["grade"], training["findings"]
        why = "; ".join(f"{finding['what']} ({finding['remedy']})" for finding in findings)
    except (KeyError, TypeError, ValueError):  # none was learned, or not by this version
        return
    if grade == REDO:
        yield warning("background.failed", f"the last training failed: {why}", LEARN)
    elif grade == USABLE:
        yield note("background.usable", f"usable, not good: {why}", LEARN)


def check_standing(hull: NodeFacts, camera: str) -> Iterator[Finding]:
    """Check this camera's pose against the others' silhouettes, as the hull server estimates it."""
    push_deg = _figure(hull, f"calibration_rotation_error_deg_{camera}")
    if push_deg is None:
        return
    sd_deg, share = (
        _figure(hull, f"calibration_rotation_error_sd_deg_{camera}"),
        _figure(hull, f"calibration_consistency_{camera}"),
    )
    known = "" if sd_deg is None else f" (sd {sd_deg:.2f})"
    agrees = "" if share is None else f"; agrees with them in {100 * share:.0f} %"
    text = f"by the others' silhouettes it is {push_deg:.2f} degrees{known} off its calibration{agrees}"
    if camera in hull.values.get("calibration_suspects", "").split(","):
        yield warning("calibration.off", text, PUT_BACK)
    else:
        yield ok("calibration", text)


def _figure(node: NodeFacts, key: str) -> float | None:
    """Return the number under ``key``; None where there is none."""
    try:
        return float(node.values[key])
    except (KeyError, ValueError):
        return None
