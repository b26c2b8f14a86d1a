"""Examines the running graph: listens, then checks the graph, its nodes, its cameras and its frame sets."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path

from capture_rig.camera import CameraModel
from capture_rig.errors import InputError
from capture_rig.rig import Rig, load_rig

from ..findings import Finding, error, graded, note, ok, on, warning
from .collect import collect_graph
from .facts import Canvas, FrameSetFacts, GraphFacts, NodeFacts
from .node_checks import (
    ACTIVE,
    BIG_MESSAGES,
    USUAL_PERIOD_S,
    camera_node,
    camera_of,
    check_alone,
    check_clock,
    check_node,
    check_standing,
    check_watch,
)
from .silhouette_checks import check_canvas_agrees, check_silhouettes, is_nearly_blank, sees_person

SERVER_NODES = ("/hull_server", "/icp_tracker", "/ekf_tracker")
MANY_MACHINES, ENOUGH_CAMERAS = 2, 3
ALIKE = (
    ("frame_rate", warning, "frame rates", "Give all files the same aravis.frame_rate."),
    ("sync", warning, "kinds of sync", "Give all files the same aravis.sync."),
    ("stamps", note, "clocks for their stamps", "aravis.stamp_source: the same for all is best."),
    (
        "exposure_us",
        note,
        "exposure times",
        "Nothing, where the light differs; else aravis.exposure_us the same for all.",
    ),
)  # keys of the clients' diagnostics
UNCALIBRATED = "uncalibrated"  # such a camera's message begins so
LATE_PERIODS, LATE_MS = 5, 200.0
MISSING = 0.02  # of the frame sets


def check_graph(facts: GraphFacts, cameras: Sequence[str]) -> Iterator[Finding]:
    """Check which nodes are heard, on which machines, and which are missing."""
    where = f"ROS_DOMAIN_ID {facts.domain}"
    if not facts.nodes:
        yield _no_node_heard(facts)
        return
    yield ok("nodes", f"{len(facts.nodes)} in {where}{_machines(facts)}")
    heard = {node.name for node in facts.nodes}
    absent = [name for name in SERVER_NODES if name not in heard]
    if len(absent) == len(SERVER_NODES) and all(node.message.startswith(UNCALIBRATED) for node in facts.nodes):
        text = "cameras that are not calibrated yet, and no server: the set-up has begun"
        yield note("nodes.setting_up", text, "Go on with docs/first_capture.md.")
    elif absent:
        yield error(
            "nodes.server_missing",
            f"{', '.join(absent)} {'is' if len(absent) == 1 else 'are'} not heard in {where}",
            "sagoma up --rig RIG on the server; the same ROS_DOMAIN_ID on all machines, and "
            "ROS_AUTOMATIC_DISCOVERY_RANGE=SUBNET where there are several.",
        )
    unknown = [facts.camera for facts in facts.cameras if cameras and facts.camera not in cameras]
    if unknown:
        text = f"{', '.join(unknown)} publish silhouettes, but are not in the rig file"
        yield warning("cameras.not_in_rig", text, "Calibrate them into the rig, or stop them.")
    if facts.simulated_time:
        yield note("clock.simulated", "the graph runs on simulated time (/clock): clocks are not compared")


def check_camera_is_there(camera: str, facts: GraphFacts) -> Iterator[Finding]:
    """Check that a camera of the rig has its client."""
    if facts.nodes and facts.node(camera_node(camera)) is None:
        others = [
            f"{domain} on {', '.join(at)}" for domain in facts.domains_elsewhere() if (at := facts.elsewhere(domain))
        ]
        hint = f" (other nodes announce themselves in ROS_DOMAIN_ID {'; '.join(others)})" if others else ""
        yield error(
            "node.missing",
            f"its client {camera_node(camera)} is not heard: it does not run, or its machine vanished{hint}",
            "Is it on, its cable in (sagoma doctor --host ADDRESS)? Start it there (sagoma up --cameras FOLDER "
            f"--only {camera}); the same ROS_DOMAIN_ID ({facts.domain}) and discovery range.",
        )


def check_alike(facts: GraphFacts) -> Iterator[Finding]:
    """Check that the cameras are set alike: a frame set needs frames of one instant from all of them."""
    clients = {camera_of(node.name): node.values for node in facts.nodes if camera_of(node.name)}
    for key, severity, what, remedy in ALIKE:
        set_to = {camera: values[key] for camera, values in clients.items() if values.get(key)}
        if len(set(set_to.values())) > 1:
            listed = ", ".join(f"{camera} {value}" for camera, value in set_to.items())
            yield severity(f"settings.{key}_differs", f"the cameras have different {what} ({listed})", remedy)


def check_frame_sets(sets: FrameSetFacts | None, hull: NodeFacts | None, seen: int) -> Iterator[Finding]:
    """Check spread and latency of the frame sets, and that they give a hull. ``seen``: cameras that see a person."""
    if hull is None or hull.state != ACTIVE:
        return
    if sets is None or not sets.sets:
        remedy = "See the cameras; their stamps must lie within half a frame period: sync and clocks."
        yield error("frame_sets.none", "the hull server forms none", remedy)
        return
    period_ms = 1e3 / sets.rate_hz if sets.rate_hz else 1e3 * USUAL_PERIOD_S
    spread, latency = _high(sets.spread_ms), _high(sets.latency_ms)
    text = f"stamps of a set differ by up to {spread:.1f} ms, of a frame period of {period_ms:.0f} ms"
    remedy = "aravis.sync: ptp, line or action instead of free_run; see docs/camera_pcs.md."
    yield graded("sync", text, (spread > period_ms / 4, warning, "spread", remedy))
    text = f"{sets.rate_hz:.1f} frame sets a second, {latency:.0f} ms from exposure to the hull"
    if latency > max(LATE_PERIODS * period_ms, LATE_MS):
        remedy = "Fewer nodes on the slowest machine, or a lower frame rate; sagoma up shows who is busy."
        yield warning("latency.late", text, remedy)
    else:
        yield ok("frame_sets", text)
    if hull.values.get("thinning"):
        remedy = "sagoma up shows who is busy; a lower aravis.frame_rate, or see docs/overload.md."
        yield warning("frame_sets.thinned", hull.values["thinning"], remedy)
    yield from _check_hull(sets, seen)


def check_share_in_sets(camera: str, sets: FrameSetFacts | None) -> Iterator[Finding]:
    """Check how often this camera was missing from the frame sets, or left out of the hull."""
    if sets is None or not sets.sets:
        return
    missing, left_out = sets.missing.get(camera, 0), sets.left_out.get(camera, 0)
    if missing > MISSING * sets.sets:
        remedy = "Frames come late, get lost, or have other stamps: see clock, sync and network."
        yield warning("frame_sets.missing_camera", f"it is missing from {missing} of {sets.sets}", remedy)
    if left_out:
        text = f"it contradicts the others: left out of {left_out} of {sets.sets} frame sets"
        yield warning("consistency.left_out", text, "Was it moved? Is something before its lens? docs/camera_faults.md")


def _check_hull(sets: FrameSetFacts, seen: int) -> Iterator[Finding]:
    bodies = sum(points > 0 for points in sets.points)
    if bodies:
        yield ok("centerline", f"in {bodies} of {sets.sets} frame sets")
    elif seen >= ENOUGH_CAMERAS:
        remedy = "The rig file of another set-up? Stamps that differ? sagoma doctor --rig RIG --live"
        yield error("centerline.empty", f"{seen} cameras see a person, but the hull is empty", remedy)
    else:
        yield note("centerline.room_empty", "the hull is empty: probably the room is, too")


def _no_node_heard(facts: GraphFacts) -> Finding:
    announcing = facts.elsewhere(facts.domain)
    if announcing:
        return error(
            "nodes.only_announced",
            f"no node is heard in ROS_DOMAIN_ID {facts.domain}, though {', '.join(announcing)} "
            "announces some: what follows the first small packets does not get here",
            f"{BIG_MESSAGES} Run it there, too.",
        )
    return error("nodes.none", f"no node is heard in ROS_DOMAIN_ID {facts.domain}", _where_else(facts))


def _where_else(facts: GraphFacts) -> str:
    places = []
    for domain in facts.domains_elsewhere():
        at = ["this machine"] if domain in facts.domains_here else []
        places.append(f"{' and '.join([*at, *facts.elsewhere(domain)])}: {domain}")
    hint = f"Nodes run in another ROS_DOMAIN_ID ({'; '.join(places)}): export that. " if places else ""
    if facts.peers:
        hint += (
            f"Only this machine and {', '.join(facts.peers)} are asked: sagoma doctor --host ADDRESS tells why not. "
        )
    elif facts.discovery_range in ("LOCALHOST", "OFF"):
        hint += f"ROS_AUTOMATIC_DISCOVERY_RANGE = {facts.discovery_range} hears this machine only. "
    return (
        f"{hint}Start the graph (sagoma up); give all machines the same ROS_DOMAIN_ID, open UDP between them (--peers "
        "where the network passes no multicast), and restart nodes that were started before their network was up: they "
        "never connect."
    )


def _machines(facts: GraphFacts) -> str:
    """Return which nodes run where, when they do not all run on one machine."""
    where: dict[str, list[str]] = {}
    for node in facts.nodes:
        where.setdefault(node.machine, []).append(camera_of(node.name) or node.name.strip("/"))
    if len(where) < MANY_MACHINES:
        return f", all {facts.machine_name(*where)}"
    listed = [f"{facts.machine_name(machine)}: {', '.join(names)}" for machine, names in where.items()]
    return f", on {len(where)} machines ({'; '.join(listed)})"


def _high(values: Sequence[float]) -> float:
    """Return the 95th percentile; NaN of nothing."""
    ordered = sorted(values)
    return ordered[round(0.95 * (len(ordered) - 1))] if ordered else float("nan")


LIVE_S = 6.0
SUBJECT = "graph"
HULL = "/hull_server"
REFUSED = "refused:"  # its message begins so


def examine_graph(seconds: float, rig_file: Path | None, domain_id: int | None = None) -> Iterator[Finding]:
    """Examine the graph of this ROS domain, against the rig file where one is given."""
    rig = None
    if rig_file is not None:
        try:
            rig = load_rig(rig_file)
        except InputError as problem:  # the graph is examined all the same
            yield from on(SUBJECT, [note("rig.invalid", f"{problem.where}: {problem.what}", problem.remedy)])
    facts = collect_graph(seconds, rig.names if rig else (), domain_id)
    if rig_file is None:
        rig = _hulls_rig(facts)
    yield from graph_findings(facts, rig)


def graph_findings(facts: GraphFacts, rig: Rig | None) -> Iterator[Finding]:
    """Yield the findings on the facts; ``rig`` holds the expected cameras and their calibration."""
    names = rig.names if rig else ()
    canvases = {camera.name: canvas_of(camera.undistorted_view().camera) for camera in rig.cameras} if rig else {}
    yield from on(SUBJECT, check_graph(facts, names))
    yield from on(SUBJECT, check_alike(facts))
    seeing = [camera.camera for camera in facts.cameras if sees_person(camera)]
    room_empty = all(is_nearly_blank(camera) for camera in facts.cameras if camera.masks)
    yield from on(SUBJECT, check_frame_sets(facts.frame_sets, facts.node(HULL), len(seeing)))
    for node in facts.nodes:
        if not camera_of(node.name):
            yield from on(node.name.strip("/"), _check_node(node, facts, room_empty))
    yield from on(HULL.strip("/"), _check_refusals(facts, canvases))
    published, hull = {camera.camera: camera for camera in facts.cameras}, facts.node(HULL)
    clients = {camera_of(node.name) for node in facts.nodes} - {""}
    for name in sorted({*names, *published, *clients}):
        subject, client = f"camera {name}", facts.node(camera_node(name))
        if name in names:
            yield from on(subject, check_camera_is_there(name, facts))
        if client is not None:
            yield from on(subject, _check_node(client, facts, room_empty))
        if name in published:
            others = [camera for camera in seeing if camera != name]
            rig_file = facts.rig_files.get(camera_node(name), "")
            yield from on(subject, check_silhouettes(published[name], client, others, canvases.get(name), rig_file))
        yield from on(subject, check_share_in_sets(name, facts.frame_sets))
        if hull is not None:
            yield from on(subject, check_standing(hull, name))


def canvas_of(camera: CameraModel) -> Canvas:
    """Return the canvas of an undistorted camera."""
    K = camera.K
    return Canvas(camera.width, camera.height, float(K[0, 0]), float(K[1, 1]), float(K[0, 2]), float(K[1, 2]))


def _check_node(node: NodeFacts, facts: GraphFacts, room_empty: bool) -> Iterator[Finding]:
    yield from check_alone(node, facts)
    yield from check_node(node, room_empty)
    yield from check_watch(node)
    if not facts.simulated_time:
        rate_hz = facts.frame_sets.rate_hz if facts.frame_sets else 0.0
        yield from check_clock(node, facts.machine, 1 / rate_hz if rate_hz else None)


def _check_refusals(facts: GraphFacts, canvases: dict[str, Canvas]) -> Iterator[Finding]:
    """Cameras that the hull server refuses although they agree with the rig file: the server is wrong."""
    hull = facts.node(HULL)
    if hull is None or not hull.message.startswith(REFUSED):
        return
    published = {camera.camera: camera.canvas for camera in facts.cameras}
    for name, wanted in canvases.items():
        canvas = published.get(name)
        if f"{name}:" in hull.message and canvas is not None and not check_canvas_agrees(canvas, wanted):
            has = facts.rig_files.get(HULL, "unknown")
            text = f"it refuses {name}, which agrees with the rig file: the server has another one ({has})"
            yield error("rig.refused", text, "Give it the same rig file: sagoma stop, sagoma up --rig RIG.")


def _hulls_rig(facts: GraphFacts) -> Rig | None:
    """Return the hull server's rig file, when it lies on this machine."""
    path = facts.rig_files.get(HULL, "")
    try:
        return load_rig(path) if path and Path(path).is_file() else None
    except InputError:  # the server reports it
        return None
