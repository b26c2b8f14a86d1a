"""Replays a bag through a graph started for it, set by set: the results depend on the bag and the settings alone."""

from __future__ import annotations

import threading
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from rclpy.node import Node

from capture_rig.errors import InputError
from capture_rig.rig import load_rig
from sagoma_bringup.graph import LOSSLESS_SETTINGS, build_graph
from sagoma_bringup.processes import ONE_PROCESS, THREE_PROCESSES

from ..console import doing
from ..graph.processes import ProcessSettings
from ..graph.ros_link import LOOK_S, PATIENCE_S, RosLink
from ..graph.supervisor import Supervisor
from ..graph.topics import PREDICTION_TOPIC, SILHOUETTE_SUFFIX, camera_topics
from .reader import SIDECAR_RIG, bag_cameras, bag_topics, frame_tolerance_ns, input_topics, read_frame_sets
from .recorder import GraphRecorder, server_topics
from .replayer import Answers, InputPublishers, LockstepReport, play_lockstep

QUIET_S, FLUSH_TIMEOUT_S = 0.5, 10.0

TOLERANCE = "hull_server.tolerance_s"
# topics with exactly one message a frame set
PER_SET = (
    "/hull/contour_rays",
    "/hull/centerline",
    "/hull/voxels",
    "/icp/reference_points",
    "/icp/fit",
    PREDICTION_TOPIC,
)
# topic -> the nodes that must listen to it before the first set is sent, where each has a process of its own
LISTENERS = {"/hull/products": {"icp_tracker"}, "/icp/people": {"ekf_tracker"}, PREDICTION_TOPIC: {"icp_tracker"}}


def replay_through_graph(
    bag: str | Path,
    output: str | Path,
    run_folder: str | Path,
    *,
    rig: str | Path | None = None,
    body: str | Path | None = None,
    settings: Mapping[str, Any] | None = None,
    domain_id: int | None = None,
    cancel: threading.Event | None = None,
    server: str = ONE_PROCESS,
) -> LockstepReport:
    """Start hull server, ICP and EKF, replay the bag's frame sets in lockstep, record their output into ``output``.

    rig : by default the one that lies in the bag's folder.
    server : ONE_PROCESS or THREE_PROCESSES; the bytes are the same.
    settings : parameters as for :func:`sagoma_bringup.graph.build_graph`; they win over the lossless ones.
    """
    rig_file = matching_rig(bag, rig)
    measured = {TOLERANCE: frame_tolerance_ns(bag) / 1e9}
    chosen = {**LOSSLESS_SETTINGS, **measured, **(settings or {})}
    graph = build_graph(rig=rig_file, body=body, settings=chosen)
    made_from = {"replayed_from": str(Path(bag).resolve()), "mode": "lockstep"}
    with Supervisor(graph, run_folder, ProcessSettings(server, domain_id), cancel=cancel) as supervisor:
        doing(f"starting {len(graph)} nodes")
        supervisor.configure()
        with (
            GraphRecorder(
                graph, output, topics=server_topics(graph), domain_id=domain_id, provenance=made_from, canonical=True
            ) as recorder,
            RosLink("sagoma_replayer", domain_id=domain_id) as link,
        ):
            recorder.wait_for_publishers()
            supervisor.activate()
            if server == THREE_PROCESSES:  # else they hand over in memory
                wait_for_listeners(link.node, PATIENCE_S)
            tolerance_ns = round(chosen[TOLERANCE] * 1e9)  # sets are formed here as the hull server forms them
            cameras = load_rig(rig_file).names
            report = lockstep_into(link.node, bag, cameras, tolerance_ns=tolerance_ns, cancel=cancel)
            recorder.recorder.wait_for_stamp(PREDICTION_TOPIC, report.last_stamp_ns, FLUSH_TIMEOUT_S)
            recorder.recorder.wait_until_quiet(QUIET_S, FLUSH_TIMEOUT_S)
            report.unrecorded = {t: n for t in PER_SET if (n := report.sets - recorder.recorder.counts[t]) != 0}
    return report


def lockstep_into(
    node: Node,
    bag: str | Path,
    cameras: Sequence[str] = (),
    *,
    tolerance_ns: int | None = None,
    cancel: threading.Event | None = None,
) -> LockstepReport:
    """Replay a bag in lockstep into a running graph; ``node`` must be spun by another thread.

    cameras : those of the graph, where they are known: it waits for none that the bag does not have.
    """
    types = bag_topics(bag)
    answers = Answers(node)
    topics = {topic.name: topic.msgtype for camera in cameras for topic in camera_topics(camera)}
    publishers = InputPublishers(node, topics | {name: types[name] for name in input_topics(bag)})
    silhouettes = [f"/{camera}{SILHOUETTE_SUFFIX}" for camera in {*cameras, *bag_cameras(bag)}]
    publishers.wait_for_subscribers(silhouettes, PATIENCE_S)
    publishers.require_no_other(silhouettes)
    frame_sets = read_frame_sets(bag, frame_tolerance_ns(bag) if tolerance_ns is None else tolerance_ns)
    done = doing("replaying frame sets")
    return play_lockstep(frame_sets, publishers, answers, timeout_s=PATIENCE_S, cancel=cancel, progress=done)


def wait_for_listeners(node: Node, timeout_s: float) -> None:
    """Return once the server's nodes subscribe to each other. Raises InputError naming missing subscriptions."""
    deadline_s = time.monotonic() + timeout_s
    while missing := _missing_subscriptions(node):
        if time.monotonic() > deadline_s:
            what = f"not heard by {', '.join(sorted(set().union(*missing.values())))} within {timeout_s:g} s"
            raise InputError(what, where=", ".join(missing), remedy="All three nodes of the server must be active.")
        threading.Event().wait(LOOK_S)


def matching_rig(bag: str | Path, rig: str | Path | None) -> Path:
    """The rig file to replay a bag with; InputError when there is none, or when its cameras are not the bag's."""
    rig_file = Path(rig) if rig is not None else Path(bag) / SIDECAR_RIG
    if not rig_file.is_file():
        raise InputError("there is no rig file", where=str(rig_file), remedy="Give one with --rig.")
    known, recorded = load_rig(rig_file).names, bag_cameras(bag)
    unknown = [name for name in recorded if name not in known]
    if unknown:
        what = f"the bag has silhouettes of {', '.join(unknown)}, which the rig does not know"
        raise InputError(what, where=str(rig_file), remedy=f"Known cameras: {', '.join(known)}.")
    return rig_file


def _missing_subscriptions(node: Node) -> dict[str, set[str]]:
    missing = {
        topic: wanted - {info.node_name for info in node.get_subscriptions_info_by_topic(topic)}
        for topic, wanted in LISTENERS.items()
    }
    return {topic: names for topic, names in missing.items() if names}
