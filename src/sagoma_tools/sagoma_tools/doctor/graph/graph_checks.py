"""The graph as a whole: who is missing, on which machines it runs, and whether its frames form sets and a hull."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from ..findings import Finding, error, note, ok, warning
from .facts import FrameSetFacts, GraphFacts, NodeFacts
from .node_checks import ACTIVE, BIG_MESSAGES, USUAL_PERIOD_S, camera_node, camera_of

SERVER_NODES = ("/hull_server", "/icp_tracker", "/ekf_tracker")
MANY_MACHINES, ENOUGH_CAMERAS = 2, 3
ALIKE = (
    ("frame_rate", warning, "frame rates", "Give all files the same aravis.frame_rate."),
    ("sync", warning, "kinds of sync", "Give all files the same aravis.sync."),
    ("stamps", note, "clocks for their stamps", "aravis.stamp_source: the same for all is best."),
    ("exposure_us", note, "exposure times", "Well, where the light differs; else aravis.exposure_us the same for all."),
)  # keys of the clients' diagnostics
UNCALIBRATED = "uncalibrated"  # how such a camera's message begins
LATE_PERIODS, LATE_MS = 5, 200.0
MISSING = 0.02  # of the frame sets


def check_graph(facts: GraphFacts, cameras: Sequence[str]) -> Iterator[Finding]:
    """Is anybody there, on how many machines, and who is not?"""
    where = f"ROS_DOMAIN_ID {facts.domain}"
    if not facts.nodes:
        yield _nobody_is_heard(facts)
        return
    yield ok("nodes", f"{len(facts.nodes)} in {where}{_machines(facts)}")
    heard = {node.name for node in facts.nodes}
    absent = [name for name in SERVER_NODES if name not in heard]
    if len(absent) == len(SERVER_NODES) and all(node.message.startswith(UNCALIBRATED) for node in facts.nodes):
        yield note(
            "nodes",
            "cameras that are not calibrated yet, and no server: the set-up has begun",
            "Go on with docs/first_capture.md.",
        )
    elif absent:
        yield error(
            "nodes",
            f"{', '.join(absent)} {'is' if len(absent) == 1 else 'are'} not heard in {where}",
            "sagoma up --rig RIG on the server; the same ROS_DOMAIN_ID on all machines, and "
            "ROS_AUTOMATIC_DISCOVERY_RANGE=SUBNET where there are several.",
        )
    strangers = [facts.camera for facts in facts.cameras if cameras and facts.camera not in cameras]
    if strangers:
        yield warning(
            "cameras",
            f"{', '.join(strangers)} publish silhouettes, but are not in the rig file",
            "Calibrate them into the rig, or stop them.",
        )
    if facts.simulated_time:
        yield note("clock", "the graph runs on simulated time (/clock): clocks are not compared")


def check_camera_is_there(camera: str, facts: GraphFacts) -> Iterator[Finding]:
    """A camera of the rig without its client."""
    if facts.nodes and facts.node(camera_node(camera)) is None:
        yield error(
            "node",
            f"its client {camera_node(camera)} is not heard",
            f"Start it on its machine (sagoma up --cameras FOLDER --only {camera}); the same ROS_DOMAIN_ID "
            f"({facts.domain}) and discovery range there.",
        )


def check_alike(facts: GraphFacts) -> Iterator[Finding]:
    """Are the cameras set alike? A set needs frames of one instant from all of them."""
    clients = {camera_of(node.name): node.values for node in facts.nodes if camera_of(node.name)}
    for key, say, what, remedy in ALIKE:
        said = {camera: values[key] for camera, values in clients.items() if values.get(key)}
        if len(set(said.values())) > 1:
            told = ", ".join(f"{camera} {value}" for camera, value in said.items())
            yield say("settings", f"the cameras have different {what} ({told})", remedy)


def check_frame_sets(sets: FrameSetFacts | None, hull: NodeFacts | None, seen: int) -> Iterator[Finding]:
    """Do the cameras' frames form sets, in step, in time, and does a hull come of them? ``seen``: how many cameras see
    somebody."""
    if hull is None or hull.state != ACTIVE:
        return
    if sets is None or not sets.sets:
        yield error(
            "frame sets",
            "the hull server forms none",
            "See the cameras; their stamps must lie within half a frame period: sync and clocks.",
        )
        return
    period_ms = 1e3 / sets.rate_hz if sets.rate_hz else 1e3 * USUAL_PERIOD_S
    spread, latency = _high(sets.spread_ms), _high(sets.latency_ms)
    text = f"stamps of a set differ by up to {spread:.1f} ms, of a frame period of {period_ms:.0f} ms"
    if spread > period_ms / 4:
        yield warning("sync", text, "aravis.sync: ptp, line or action instead of free_run; see docs/camera_pcs.md.")
    else:
        yield ok("sync", text)
    text = f"{sets.rate_hz:.1f} frame sets a second, {latency:.0f} ms from exposure to the hull"
    if latency > max(LATE_PERIODS * period_ms, LATE_MS):
        yield warning(
            "latency", text, "Fewer nodes on the slowest machine, or a lower frame rate; sagoma up shows who is busy."
        )
    else:
        yield ok("frame sets", text)
    yield from _check_hull(sets, seen)


def check_share_in_sets(camera: str, sets: FrameSetFacts | None) -> Iterator[Finding]:
    """How often this camera was missing from the frame sets, or left out of the hull."""
    if sets is None or not sets.sets:
        return
    missing, left_out = sets.missing.get(camera, 0), sets.left_out.get(camera, 0)
    if missing > MISSING * sets.sets:
        yield warning(
            "frame sets",
            f"it is missing from {missing} of {sets.sets}",
            "Frames come late, get lost, or have other stamps: see clock, sync and network.",
        )
    if left_out:
        yield warning(
            "consensus",
            f"it contradicts the others: left out of {left_out} of {sets.sets} frame sets",
            "Was it moved? Is something before its lens? docs/lying_cameras.md",
        )


def _check_hull(sets: FrameSetFacts, seen: int) -> Iterator[Finding]:
    bodies = sum(points > 0 for points in sets.points)
    if bodies:
        yield ok("centerline", f"in {bodies} of {sets.sets} frame sets")
    elif seen >= ENOUGH_CAMERAS:
        yield error(
            "centerline",
            f"{seen} cameras see somebody, but the hull is empty",
            "The rig file of another set-up? Stamps that differ? sagoma doctor --rig RIG --live",
        )
    else:
        yield note("centerline", "the hull is empty: nobody is there, as far as can be told")


def _nobody_is_heard(facts: GraphFacts) -> Finding:
    announcing = facts.elsewhere(facts.domain)
    if announcing:
        return error(
            "nodes",
            f"no node is heard in ROS_DOMAIN_ID {facts.domain}, though {', '.join(announcing)} "
            "announces some: what follows the first small packets does not get here",
            f"{BIG_MESSAGES} Run it there, too.",
        )
    return error("nodes", f"no node is heard in ROS_DOMAIN_ID {facts.domain}", _where_else(facts))


def _where_else(facts: GraphFacts) -> str:
    domains = {one.domain for one in facts.announced} | {*facts.domains_here}
    places = []
    for domain in sorted(domains - {facts.domain}):
        at = ["this machine"] if domain in facts.domains_here else []
        places.append(f"{' and '.join([*at, *facts.elsewhere(domain)])}: {domain}")
    hint = f"Nodes run in another ROS_DOMAIN_ID ({'; '.join(places)}): export that. " if places else ""
    if facts.discovery_range in ("LOCALHOST", "OFF"):
        hint += f"ROS_AUTOMATIC_DISCOVERY_RANGE = {facts.discovery_range} hears this machine only. "
    return (
        f"{hint}Start the graph (sagoma up); give all machines the same ROS_DOMAIN_ID, open UDP between them, and "
        "restart nodes that were started before their network was up: they stay deaf."
    )


def _machines(facts: GraphFacts) -> str:
    """Which nodes run where, when they do not all run on one machine."""
    where: dict[str, list[str]] = {}
    for node in facts.nodes:
        where.setdefault(node.machine, []).append(camera_of(node.name) or node.name.strip("/"))
    if len(where) < MANY_MACHINES:
        return f", all {facts.machine_name(*where)}"
    told = [f"{facts.machine_name(machine)}: {', '.join(names)}" for machine, names in where.items()]
    return f", on {len(where)} machines ({'; '.join(told)})"


def _high(values: Sequence[float]) -> float:
    """The 95th percentile; NaN of nothing."""
    ordered = sorted(values)
    return ordered[round(0.95 * (len(ordered) - 1))] if ordered else float("nan")
