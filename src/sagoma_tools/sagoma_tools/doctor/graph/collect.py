"""Listens to the running graph for a few seconds, and asks its nodes for their state and rig file.

Nodes on other machines that cannot be reached are found by their announcements (:mod:`..machine.announcements`).
"""

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

from ...graph.network_settings import PEERS_VARIABLE
from ...graph.ros_link import RosLink, call_all, node_names, owners_of, settled
from ...graph.topics import DIAGNOSTICS_TOPIC, cameras_in
from ..machine.announcements import AnnouncementListener, machine_of
from ..machine.network import collect_network
from .facts import GraphFacts
from .subscribers import DiagnosticsSubscriber, FrameSetSubscriber, SilhouetteSubscriber

OWN_NAME = "sagoma_doctor"
DISCOVERY_S = 5.0
ANSWER_S = 1.0
QUESTIONS, PATIENCE = 5, 2
GET_STATE, GET_PARAMETERS = "/get_state", "/get_parameters"
ICP, ICP_RIG_PARAMETER, RIG_PARAMETER = "/icp_tracker", "initial_pose.rig_file", "rig_file"


def collect_graph(seconds: float, expected: Sequence[str] = (), domain_id: int | None = None) -> GraphFacts:
    """Listen for ``seconds``; also to ``expected`` cameras for which no publisher is found."""
    reach = os.environ.get("ROS_AUTOMATIC_DISCOVERY_RANGE", "")
    alone = reach in ("LOCALHOST", "OFF")
    domains_here = collect_network().domains_here  # before the listener takes a port of each domain
    with AnnouncementListener(alone) as announcements, RosLink(OWN_NAME, domain_id=domain_id) as link:
        node = link.node
        reports, sets = DiagnosticsSubscriber(node), FrameSetSubscriber(node)
        settled(lambda: set(node_names(node)) - {f"/{OWN_NAME}"}, 1, DISCOVERY_S)
        cameras = sorted({*expected, *cameras_in(name for name, _ in node.get_topic_names_and_types())})
        silhouettes = [SilhouetteSubscriber(node, camera) for camera in cameras]
        ends_s = time.monotonic() + seconds
        lifecycle = sorted(owners_of(node, "get_state", "lifecycle_msgs/srv/GetState"))
        states, trips = ask_states(node, lifecycle)
        rig_files = _ask_rig_files(node, [name for name in lifecycle if states.get(name)])
        threading.Event().wait(max(ends_s - time.monotonic(), 0.0))
        machines, copies = _machines(node), Counter(node_names(node))
        nodes = tuple(
            reports.facts(
                name,
                state=states.get(name),
                machine=machines.get(name, ("",))[0],
                copies=copies[name],
                machines=machines.get(name, ()),
                round_trip_s=trips.get(name),
            )
            for name in sorted({*lifecycle, *reports.names})
        )
        return GraphFacts(
            domain=node.context.get_domain_id(),
            discovery_range=reach,
            seconds=seconds,
            machine=machines.get(f"/{OWN_NAME}", ("",))[0],
            nodes=nodes,
            cameras=tuple(subscriber.facts() for subscriber in silhouettes),
            frame_sets=sets.facts(),
            simulated_time=node.count_publishers("/clock") > 0,
            rig_files=rig_files,
            domains_here=domains_here,
            announced=announcements.heard,
            peers=tuple(filter(None, os.environ.get(PEERS_VARIABLE, "").split(";"))),
        )


def ask_states(node: Node, names: Iterable[str]) -> tuple[dict[str, str], dict[str, float]]:
    """Return the lifecycle state of each node that answers, and its shortest round trip of a few, seconds."""
    states: dict[str, str] = {}
    trips: dict[str, float] = {}
    for name in names:
        client = node.create_client(GetState, name + GET_STATE)
        unanswered = 0
        for _ in range(QUESTIONS):
            answer, took_s = _ask(client, GetState.Request())
            unanswered += answer is None
            if unanswered == PATIENCE:
                break  # one answer may be lost while discovery is under way
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


def _machines(node: Node) -> dict[str, tuple[str, ...]]:
    """Return on which machines each node runs: several where nodes share a name."""
    publishers = node.get_publishers_info_by_topic(DIAGNOSTICS_TOPIC)
    found: dict[str, tuple[str, ...]] = {}
    for one in publishers:
        name = f"{one.node_namespace.rstrip('/')}/{one.node_name}"
        found[name] = (*found.get(name, ()), machine_of(one.endpoint_gid))
    own = node.get_subscriptions_info_by_topic(DIAGNOSTICS_TOPIC)
    return found | {f"/{OWN_NAME}": (machine_of(s.endpoint_gid),) for s in own if s.node_name == OWN_NAME}


def _ask_rig_files(node: Node, names: Sequence[str]) -> dict[str, str]:
    """Return the rig file parameter of each node. One parameter a request: an unknown one empties the whole answer."""
    files = {}
    for parameter, asked in ((RIG_PARAMETER, [n for n in names if n != ICP]), (ICP_RIG_PARAMETER, [ICP])):
        requests = {n + GET_PARAMETERS: GetParameters.Request(names=[parameter]) for n in asked if n in names}
        for service, reply in call_all(node, GetParameters, requests, ANSWER_S, repeatable=True).items():
            if reply is not None and reply.values and reply.values[0].string_value:
                files[service.removesuffix(GET_PARAMETERS)] = reply.values[0].string_value
    return files
