"""The examination of the running graph: listen, judge node by node and camera by camera."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

from capture_rig.camera import CameraModel
from capture_rig.errors import InputError
from capture_rig.rig import Rig, load_rig

from ..findings import Finding, error, note, on
from .collect import collect_graph
from .facts import Canvas, GraphFacts, NodeFacts
from .graph_checks import check_alike, check_camera_is_there, check_frame_sets, check_graph, check_share_in_sets
from .node_checks import camera_node, camera_of, check_clock, check_node
from .silhouette_checks import check_canvas_agrees, check_silhouettes, sees_nobody, sees_somebody
from .watch_checks import check_standing, check_watch

LIVE_S = 6.0
SUBJECT = "graph"
HULL = "/hull_server"
REFUSED = "refused:"  # how its message begins


def examine_graph(seconds: float, rig_file: Path | None, domain_id: int | None = None) -> Iterator[Finding]:
    """Findings on the graph of this ROS domain, against the rig file where one is given."""
    rig = None
    if rig_file is not None:
        try:
            rig = load_rig(rig_file)
        except InputError as problem:  # the rig's examination says so too; the graph can be examined all the same
            yield from on(SUBJECT, [note("rig", f"{problem.where}: {problem.what}", problem.remedy)])
    facts = collect_graph(seconds, rig.names if rig else (), domain_id)
    if rig_file is None:
        rig = _hulls_rig(facts)
    yield from judge_graph(facts, rig)


def judge_graph(facts: GraphFacts, rig: Rig | None) -> Iterator[Finding]:
    """The findings on what was heard; ``rig`` says which cameras there should be, and their calibration."""
    names = rig.names if rig else ()
    canvases = {camera.name: canvas_of(camera.undistorted_view().camera) for camera in rig.cameras} if rig else {}
    yield from on(SUBJECT, check_graph(facts, names))
    yield from on(SUBJECT, check_alike(facts))
    seeing = [camera.camera for camera in facts.cameras if sees_somebody(camera)]
    nobody = all(sees_nobody(camera) for camera in facts.cameras if camera.masks)
    yield from on(SUBJECT, check_frame_sets(facts.frame_sets, facts.node(HULL), len(seeing)))
    for node in facts.nodes:
        if not camera_of(node.name):
            yield from on(node.name.strip("/"), _judge_node(node, facts, nobody))
    yield from on(HULL.strip("/"), _judge_refusals(facts, canvases))
    published, hull = {camera.camera: camera for camera in facts.cameras}, facts.node(HULL)
    clients = {camera_of(node.name) for node in facts.nodes} - {""}
    for name in sorted({*names, *published, *clients}):
        subject, client = f"camera {name}", facts.node(camera_node(name))
        if name in names:
            yield from on(subject, check_camera_is_there(name, facts))
        if client is not None:
            yield from on(subject, _judge_node(client, facts, nobody))
        if name in published:
            others = [camera for camera in seeing if camera != name]
            rig_file = facts.rig_files.get(camera_node(name), "")
            yield from on(subject, check_silhouettes(published[name], client, others, canvases.get(name), rig_file))
        yield from on(subject, check_share_in_sets(name, facts.frame_sets))
        if hull is not None:
            yield from on(subject, check_standing(hull, name))


def canvas_of(camera: CameraModel) -> Canvas:
    """The canvas of an undistorted camera."""
    K = camera.K
    return Canvas(camera.width, camera.height, float(K[0, 0]), float(K[1, 1]), float(K[0, 2]), float(K[1, 2]))


def _judge_node(node: NodeFacts, facts: GraphFacts, nobody: bool) -> Iterator[Finding]:
    yield from check_node(node, nobody)
    yield from check_watch(node)
    if not facts.simulated_time:
        rate_hz = facts.frame_sets.rate_hz if facts.frame_sets else 0.0
        yield from check_clock(node, facts.machine, 1 / rate_hz if rate_hz else None)


def _judge_refusals(facts: GraphFacts, canvases: dict[str, Canvas]) -> Iterator[Finding]:
    """Cameras that the hull server refuses although they agree with the rig file: the server is wrong."""
    hull = facts.node(HULL)
    if hull is None or not hull.message.startswith(REFUSED):
        return
    published = {camera.camera: camera.canvas for camera in facts.cameras}
    for name, wanted in canvases.items():
        canvas = published.get(name)
        if f"{name}:" in hull.message and canvas is not None and not check_canvas_agrees(canvas, wanted):
            has = facts.rig_files.get(HULL, "unknown")
            yield error(
                "rig",
                f"it refuses {name}, which agrees with the rig file: the server has another one ({has})",
                "Give it the same rig file: sagoma stop, sagoma up --rig RIG.",
            )


def _hulls_rig(facts: GraphFacts) -> Rig | None:
    """The hull server's rig file, when it lies on this machine."""
    path = facts.rig_files.get(HULL, "")
    try:
        return load_rig(path) if path and Path(path).is_file() else None
    except InputError:  # the server says so itself
        return None
