"""Listens to the running graph for a few seconds, and asks its nodes for their state and rig file."""

from __future__ import annotations

import os
import threading
import time
from collections import Counter
from collections.abc import Iterable, Sequence
from typing import Any

from lifecycle_msgs.srv import GetState
from rcl_interfaces.srv import GetParameters
from rclpy.node import Node

from ...ros_link import RosLink
from ...service_calls import call_all
from ...topics import DIAGNOSTICS_TOPIC, cameras_in
from ..machine.collect_network import collect_network
from .announcements import AnnouncementEar
from .ears import DiagnosticsEar, FrameSetEar, SilhouetteEar
from .facts import GraphFacts
from .middleware import machine_of

OWN_NAME = "sagoma_doctor"
DISCOVERY_S, QUIET_S, LOOK_S = 5.0, 1.0, 0.1
ANSWER_S = 1.0
QUESTIONS, PATIENCE = 5, 2
GET_STATE, GET_PARAMETERS = "/get_state", "/get_parameters"
ICP, ICP_RIG_PARAMETER, RIG_PARAMETER = "/icp_tracker", "initial_pose.rig_file", "rig_file"


def collect_graph(seconds: float, expected: Sequence[str] = (), domain_id: int | None = None) -> GraphFacts:
    """What is heard in ``seconds``; ``expected`` cameras are listened to even when nobody publishes for them."""
    reach = os.environ.get("ROS_AUTOMATIC_DISCOVERY_RANGE", "")
    alone = reach in ("LOCALHOST", "OFF")
    with AnnouncementEar(alone) as announcements, RosLink(OWN_NAME, domain_id=domain_id) as link:
        node = link.node
        reports, sets = DiagnosticsEar(node), FrameSetEar(node)
        _discover(node)
        cameras = sorted({*expected, *cameras_in(name for name, _ in node.get_topic_names_and_types())})
        silhouettes = [SilhouetteEar(node, camera) for camera in cameras]
        ends_s = time.monotonic() + seconds
        lifecycle = _lifecycle_nodes(node)
        states, trips = ask_states(node, lifecycle)
        rig_files = _ask_rig_files(node, [name for name in lifecycle if states.get(name)])
        threading.Event().wait(max(ends_s - time.monotonic(), 0.0))
        machines, copies = _machines(node), Counter(_node_names(node))
        nodes = tuple(
            reports.facts(
                name,
                state=states.get(name),
                machine=machines.get(name, ""),
                copies=copies[name],
                round_trip_s=trips.get(name),
            )
            for name in sorted({*lifecycle, *reports.names})
        )
        return GraphFacts(
            domain=node.context.get_domain_id(),
            discovery_range=reach,
            seconds=seconds,
            machine=machines.get(f"/{OWN_NAME}", ""),
            nodes=nodes,
            cameras=tuple(ear.facts() for ear in silhouettes),
            frame_sets=sets.facts(),
            simulated_time=node.count_publishers("/clock") > 0,
            rig_files=rig_files,
            domains_here=collect_network().domains_here,
            announced=announcements.heard,
        )


def ask_states(node: Node, names: Iterable[str]) -> tuple[dict[str, str], dict[str, float]]:
    """Lifecycle state of each node that answers, and the fastest of a few answers, seconds."""
    states: dict[str, str] = {}
    trips: dict[str, float] = {}
    for name in names:
        client = node.create_client(GetState, name + GET_STATE)
        unanswered = 0
        for _ in range(QUESTIONS):
            answer, took_s = _ask(client, GetState.Request())
            unanswered += answer is None
            if unanswered == PATIENCE:
                break  # the first answer may be lost, where discovery is not through; the deaf stay deaf
            if answer is None:
                continue
            states[name] = answer.current_state.label
            trips[name] = min(took_s, trips.get(name, took_s))
        node.destroy_client(client)
    return states, trips


def _ask(client: Any, request: Any) -> tuple[Any, float]:
    answered = threading.Event()
    if not client.wait_for_service(ANSWER_S):
        return None, ANSWER_S
    began_s = time.perf_counter()
    took_s = ANSWER_S

    def take(_: Any) -> None:
        nonlocal took_s
        took_s = time.perf_counter() - began_s
        answered.set()

    future = client.call_async(request)
    future.add_done_callback(take)
    if not answered.wait(ANSWER_S):
        client.remove_pending_request(future)
        return None, ANSWER_S
    return future.result(), took_s


def _discover(node: Node) -> None:
    """Wait until nodes have appeared, and no new one for a while: discovery has no end."""
    deadline_s = quiet_s = time.monotonic() + DISCOVERY_S
    known = {f"/{OWN_NAME}"}
    while time.monotonic() < min(deadline_s, quiet_s):
        now = set(_node_names(node))
        if now - known:
            known, quiet_s = known | now, time.monotonic() + QUIET_S
        threading.Event().wait(LOOK_S)


def _node_names(node: Node) -> list[str]:
    return [f"{space.rstrip('/')}/{name}" for name, space in node.get_node_names_and_namespaces()]


def _lifecycle_nodes(node: Node) -> list[str]:
    services = node.get_service_names_and_types()
    return sorted(
        name.removesuffix(GET_STATE)
        for name, types in services
        if name.endswith(GET_STATE) and "lifecycle_msgs/srv/GetState" in types
    )


def _machines(node: Node) -> dict[str, str]:
    publishers = node.get_publishers_info_by_topic(DIAGNOSTICS_TOPIC)
    found = {f"{p.node_namespace.rstrip('/')}/{p.node_name}": machine_of(p.endpoint_gid) for p in publishers}
    own = node.get_subscriptions_info_by_topic(DIAGNOSTICS_TOPIC)
    return found | {f"/{OWN_NAME}": machine_of(s.endpoint_gid) for s in own if s.node_name == OWN_NAME}


def _ask_rig_files(node: Node, names: Sequence[str]) -> dict[str, str]:
    """The rig file that each node was given. One parameter a question: an unknown one empties the whole answer."""
    files = {}
    for parameter, asked in ((RIG_PARAMETER, [n for n in names if n != ICP]), (ICP_RIG_PARAMETER, [ICP])):
        requests = {n + GET_PARAMETERS: GetParameters.Request(names=[parameter]) for n in asked if n in names}
        for service, reply in call_all(node, GetParameters, requests, ANSWER_S, repeatable=True).items():
            if reply is not None and reply.values and reply.values[0].string_value:
                files[service.removesuffix(GET_PARAMETERS)] = reply.values[0].string_value
    return files
