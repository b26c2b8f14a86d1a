"""Checks of the running graph: its nodes, its cameras' silhouettes, and its frame sets."""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

import numpy as np

from camera_client.background.causes import KEY as FINDINGS_KEY
from camera_client.background.causes import read_findings
from camera_client.background.training import KEY as TRAINING_KEY
from camera_client.background.training import TrainingReport
from camera_client.diagnostics import UNCALIBRATED
from capture_rig.rig import load_rig
from capture_rig.verdict import GOOD, REDO, USABLE
from sagoma_ros.middleware import RANGE_VARIABLE

from .findings import CheckResult, CheckResults, about, error, note, ok, result_of, warning
from .graph_listener import ACTIVE, FLOODED, HULL, GraphFacts, NodeFacts, SilhouetteFacts, collect_graph
from .hosts import RosSettings
from .machine import domains_here

SUBJECT = "graph"
SERVER_NODES = (HULL, "/icp_tracker", "/ekf_tracker")
ENOUGH_CAMERAS = 3
ALIKE = (
    ("frame_rate", warning, "frame rates"),
    ("sync", warning, "kinds of sync"),
    ("stamps", note, "clocks for their stamps"),
)  # keys of the clients' diagnostics
ACQUIRING = "acquiring"  # how a tracker's message begins
EMPTY = ("mask is empty", "empty silhouette", "hull is empty")
LATE_PERIODS, LATE_MS = 5, 200.0
MISSING, LOST = 0.02, 0.02  # of the frame sets; of the silhouettes
USUAL_PERIOD_S = 1 / 30
OLD_S, EARLY_S, NOTHING = 1.0, 5e-3, 1e-5
OF_GRADE = {GOOD: note, USABLE: warning, REDO: error}
RECOVERY = "docs/how-to/tracking.md"
PAGES = {HULL: "docs/how-to/faults.md", "/icp_tracker": RECOVERY, "/ekf_tracker": RECOVERY}
UNREACHABLE = "Look for its process and log there; for the way: sagoma doctor --host ADDRESS, firewall, cable."
BIG_MESSAGES = (
    "Large messages get lost: one MTU on all machines (sagoma doctor --host ADDRESS), "
    "FASTRTPS_DEFAULT_PROFILES_FILE=config/dds/fastdds.xml, and UDP open between them."
)


def examine_graph(seconds: float, rig_file: Path | None, namespace: str = "") -> Iterator[CheckResult]:
    """Examine the graph of this ROS domain and a namespace, against the rig file if given."""
    expected = () if rig_file is None else load_rig(rig_file).names
    yield from graph_findings(collect_graph(seconds, expected, namespace=namespace))


def graph_findings(facts: GraphFacts) -> Iterator[CheckResult]:
    """Yield the findings on the facts."""
    yield from about(SUBJECT, check_nodes(facts), check_alike(facts), check_frame_sets(facts))
    for node in facts.nodes:
        if not node.camera:
            yield from about(node.name.strip("/"), *_of_node(node, facts))
    sent = {camera.camera: camera for camera in facts.cameras}
    for name in sorted({*facts.expected, *sent, *(node.camera for node in facts.nodes)} - {""}):
        subject, client = f"camera {name}", facts.client(name)
        yield from about(subject, check_presence(name, facts))
        if client is not None:
            yield from about(subject, *_of_node(client, facts))
        if (its := sent.get(name)) is not None:
            yield from about(subject, check_arrival(its, client), check_content(its, facts))


def _of_node(node: NodeFacts, facts: GraphFacts) -> list[CheckResults]:
    return [check_answers(node, facts), check_message(node, facts), check_clock(node, facts), check_background(node)]


def check_nodes(facts: GraphFacts) -> Iterator[CheckResult]:
    """Which nodes answer, and which of the server's are missing."""
    where = f"ROS_DOMAIN_ID {facts.domain}"
    if not facts.nodes:
        others = ", ".join(str(domain) for domain in domains_here() if domain != facts.domain)
        hint = f"Nodes run on this machine in another ROS_DOMAIN_ID ({others}): export that. " if others else ""
        reach = f"{RANGE_VARIABLE} (here {RosSettings.of(os.environ).reach})"
        remedy = f"{hint}Start the graph (sagoma up); give all machines the same ROS_DOMAIN_ID and {reach}, open UDP "
        remedy += "between them (sagoma doctor --host ADDRESS; --peers where the network passes no multicast), and "
        remedy += "restart nodes that started before their network was up."
        yield error("nodes.none", f"no node is heard in {where}", remedy)
        return
    listed = ", ".join(node.camera or node.name.strip("/") for node in facts.nodes)
    yield ok("nodes", f"{len(facts.nodes)} in {where}: {listed}")
    absent = [name for name in SERVER_NODES if facts.node(name) is None]
    if absent:
        remedy = "sagoma up --rig RIG on the server, once the cameras are calibrated; the same ROS_DOMAIN_ID on all "
        remedy += "machines, and ROS_AUTOMATIC_DISCOVERY_RANGE=SUBNET where there are several."
        yield error("nodes.server_missing", f"not heard in {where}: {', '.join(absent)}", remedy)
    unknown = [camera.camera for camera in facts.cameras if camera.camera not in facts.expected]
    if facts.expected and unknown:
        text = f"{', '.join(unknown)} publish silhouettes, but are not in the rig file"
        yield warning("cameras.not_in_rig", text, "Calibrate them into the rig, or stop them.")


def check_alike(facts: GraphFacts) -> Iterator[CheckResult]:
    """Whether the cameras are set alike: a frame set needs frames of one instant from all of them."""
    for key, severity, what in ALIKE:
        clients = {node.camera: node.value(key) for node in facts.nodes if node.camera and node.value(key)}
        if len(set(clients.values())) > 1:
            listed = ", ".join(f"{camera} {value}" for camera, value in clients.items())
            remedy = "Give all their files the same."
            yield severity(f"settings.{key}_differs", f"the cameras have different {what} ({listed})", remedy)


def check_frame_sets(facts: GraphFacts) -> Iterator[CheckResult]:
    """Spread and latency of the frame sets, and whether they give a hull."""
    hull, sets = facts.node(HULL), facts.sets
    if hull is None or hull.state != ACTIVE:
        return
    if not sets:
        remedy = "See the cameras; their stamps must lie within half a frame period: sync and clocks."
        yield error("frame_sets.none", "the hull server forms none", remedy)
        return
    period_ms, spread, latency = 1e3 * _period_s(facts), _high(sets, "spread_ms"), _high(sets, "published_ms")
    text = f"stamps of a set differ by up to {spread:.1f} ms, of a frame period of {period_ms:.0f} ms"
    remedy = "aravis.sync: ptp, line or action instead of free_run; see docs/how-to/camera_pcs.md."
    yield result_of("sync", text, (spread > period_ms / 4, warning, "spread", remedy))
    text = f"{facts.sets_hz:.1f} frame sets a second, {latency:.0f} ms from exposure to the hull"
    remedy = "Fewer nodes on the slowest machine, or a lower frame rate; sagoma up shows who is busy."
    yield result_of("latency", text, (latency > max(LATE_PERIODS * period_ms, LATE_MS), warning, "late", remedy))
    bodies, seen = sum(each.get("points", "0") != "0" for each in sets), len(facts.seeing)
    text = f"in {bodies} of {len(sets)} frame sets; {seen} cameras see a person"
    remedy = "The rig file of another set-up? Stamps that differ? sagoma doctor --rig RIG --live"
    yield result_of("centerline", text, (not bodies and seen >= ENOUGH_CAMERAS, error, "empty", remedy))


def _period_s(facts: GraphFacts) -> float:
    return 1 / facts.sets_hz if facts.sets_hz else USUAL_PERIOD_S


def _high(sets: Sequence[Mapping[str, str]], key: str) -> float:
    """Return the 95th percentile of a figure of the frame sets; NaN of nothing."""
    values = [float(each[key]) for each in sets if key in each]
    return float(np.percentile(values, 95)) if values else float("nan")


def check_answers(node: NodeFacts, facts: GraphFacts) -> Iterator[CheckResult]:
    """Whether the node is the only one of its name, answers, reports and is active."""
    if node.copies > 1:
        remedy = "Stop all but one: the same camera or server was started twice, or two set-ups share a ROS_DOMAIN_ID."
        yield error("node.duplicate", f"{node.copies} nodes call themselves {node.name}", remedy)
    if node.state is None:
        text = f"{node.name} is known, but does not answer{' or report' if node.report is None else ''}"
        yield error("node.silent", f"{text}: it died, hangs, is busy, or its packets do not get here", UNREACHABLE)
    elif node.report is None:
        yield error("diagnostics.missing", f"{node.name} answers, but its diagnostics do not arrive", BIG_MESSAGES)
    if node.state not in (None, ACTIVE):
        yield warning("state.inactive", f"it is {node.state}", "sagoma start (or sagoma up, where no process runs)")


def check_message(node: NodeFacts, facts: GraphFacts) -> CheckResult | None:
    """The node's own warning or error, except those usual in an empty room."""
    if node.report is None:
        return None
    message, level = node.message, node.report.level[0]
    if message in {finding.line for finding in read_findings(node.value(FINDINGS_KEY))}:
        return None  # it is a finding of its own
    page = "docs/how-to/camera_pcs.md" if node.camera else PAGES.get(node.name, "")
    remedy = f"See {page}." if page else "See its log."
    if level == 1 and message.startswith(ACQUIRING):
        return note("says.acquiring", message, "Somebody has to come, or stand in the T-pose: docs/how-to/tracking.md.")
    if level == 1 and facts.room_empty and any(words in message for words in EMPTY):
        return ok("says", f"{message} (the room is empty)")
    return result_of("says", message, (level > 1, error, "error", remedy), (level > 0, warning, "warning", remedy))


def check_clock(node: NodeFacts, facts: GraphFacts) -> CheckResult | None:
    """The clock's offset from this machine's, to the milliseconds that a report takes to arrive."""
    if node.report is None or facts.simulated_time:
        return None
    off_s, half_s = abs(node.report.lead_s), _period_s(facts) / 2
    text = f"{1e3 * off_s:.1f} ms {'ahead of' if node.report.lead_s > 0 else 'behind'} this machine's"
    remedy = "chrony or PTP on all machines, with one source: frame sets are formed by stamps."
    off, imprecise = (off_s > half_s, error, "off", remedy), (off_s > half_s / 2, warning, "imprecise", remedy)
    return result_of("clock", text, off, imprecise)


def check_background(node: NodeFacts) -> Iterator[CheckResult]:
    """What a camera's client finds against its background, and the last training that failed."""
    for found in read_findings(node.value(FINDINGS_KEY)):
        yield OF_GRADE[found.grade](found.code, found.what, found.remedy)
    try:
        training = TrainingReport.from_json(node.value(TRAINING_KEY))
    except (KeyError, TypeError, ValueError):  # none was learned, or not by this version
        return
    if training.grade == REDO:
        why = "; ".join(map(str, training.findings))
        remedy = "sagoma background, while the room is empty"
        yield warning("background.failed", f"the last training failed: {why}", remedy)


def check_presence(camera: str, facts: GraphFacts) -> Iterator[CheckResult]:
    """Whether a camera of the rig has its client, and how often the camera was missing from the frame sets."""
    if facts.nodes and camera in facts.expected and facts.client(camera) is None:
        remedy = "Is it on, its cable in (sagoma doctor --host ADDRESS)? Start it there (sagoma up --cameras FOLDER "
        remedy += f"--only {camera}); the same ROS_DOMAIN_ID ({facts.domain}) and discovery range."
        yield error("node.missing", "its client is not heard: it does not run, or its machine vanished", remedy)
    missing, sets = sum(camera in each.get("missing", "").split(",") for each in facts.sets), len(facts.sets)
    if missing > MISSING * sets:
        remedy = "Frames come late, get lost, or have other stamps: see clock, sync and network."
        yield warning("frame_sets.missing_camera", f"it is missing from {missing} of {sets}", remedy)


def check_arrival(sent: SilhouetteFacts, client: NodeFacts | None) -> Iterator[CheckResult]:
    """Whether its silhouettes arrive, and in time."""
    if not sent.masks:
        if client is not None and client.state == ACTIVE and client.message != UNCALIBRATED:  # else it is a finding
            text = f"its client sends {client.value('rate_hz') or 'none or some'} a second, none arrives here"
            remedy = f"See its message: without a background it sends none. {BIG_MESSAGES}"
            yield error("silhouettes.not_arriving", text, remedy)
        return
    total = sent.masks + sent.lost
    if sent.lost > LOST * total:
        yield warning("network.loss", f"{sent.lost} of {total} silhouettes got lost on the way", BIG_MESSAGES)
    if sent.age_s < -EARLY_S:
        text = f"its frames are stamped {-sent.age_s:.3f} s ahead of this machine's clock"
        yield error("stamps.ahead", text, "chrony or PTP on all machines; for PTP stamps check tai_utc_offset_s.")
    elif sent.age_s > OLD_S:
        remedy = "Its clock is behind (see clock), footage plays late, or the machine is too busy."
        yield warning("latency.old", f"its silhouettes are {sent.age_s:.1f} s old when they arrive", remedy)


def check_content(sent: SilhouetteFacts, facts: GraphFacts) -> CheckResult | None:
    """Whether the silhouettes are plausible."""
    if not sent.masks:
        return None
    others = [camera for camera in facts.seeing if camera != sent.camera]
    learn = f"Learn the background of the empty room again: sagoma background --cameras {sent.camera}"
    text = f"{100 * sent.share:.1f} % foreground, {sent.masks} came"
    if sent.share < NOTHING and others:
        remedy = f"Lens cap, wrong direction, or a person was in the room while it learned. {learn}"
        return warning("silhouettes.blank", f"blank, while {', '.join(others)} see a person", remedy)
    flooded = (sent.share >= FLOODED, error, "flooded", f"The light or the camera was changed. {learn}")
    return result_of("silhouettes", text, flooded)
