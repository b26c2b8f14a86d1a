"""Listens to the running graph for a few seconds, and asks its nodes for their state and rig file.

Nodes on other machines that cannot be reached are found by their announcements: every process announces itself by
multicast every three seconds (RTPS 2.3: 8.5.3, 9.6.1.1). The packet's first twenty bytes name the middleware and the
machine, its port the ROS domain. Nothing is sent to find them.
"""

from __future__ import annotations

import contextlib
import os
import select
import socket
import threading
import time
from collections import Counter
from collections.abc import Iterable, Sequence
from typing import Any

from lifecycle_msgs.srv import GetState
from rcl_interfaces.srv import GetParameters
from rclpy.node import Node

from ...graph.ros_link import RosLink, call_all, node_names, owners_of, settled
from ...graph.topics import DIAGNOSTICS_TOPIC, cameras_in
from ..machine.network import DOMAIN_PORTS, FIRST_PORT, HIGHEST_DOMAIN, collect_interfaces, collect_network
from .facts import Announcement, GraphFacts
from .subscribers import DiagnosticsSubscriber, FrameSetSubscriber, SilhouetteSubscriber

FAST_DDS = b"\x01\x0f"  # the vendor's number, with which its GUIDs begin; the next two bytes are the machine's
GROUP = "239.255.0.1"
MAGIC, PREFIX = b"RTPS", slice(8, 20)
LOOPBACK = "127.0.0.1"
ANNOUNCEMENT_POLL_S = 0.2
PACKET_BYTES = 65536


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
            cameras=tuple(subscriber.facts() for subscriber in silhouettes),
            frame_sets=sets.facts(),
            simulated_time=node.count_publishers("/clock") > 0,
            rig_files=rig_files,
            domains_here=collect_network().domains_here,
            announced=announcements.heard,
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


def machine_of(gid: Sequence[int]) -> str:
    """Return the machine's number in a GUID, where the middleware is Fast DDS; else ""."""
    prefix = bytes(gid[:4])
    return prefix[2:].hex() if prefix[:2] == FAST_DDS else ""


def _machines(node: Node) -> dict[str, str]:
    publishers = node.get_publishers_info_by_topic(DIAGNOSTICS_TOPIC)
    found = {f"{p.node_namespace.rstrip('/')}/{p.node_name}": machine_of(p.endpoint_gid) for p in publishers}
    own = node.get_subscriptions_info_by_topic(DIAGNOSTICS_TOPIC)
    return found | {f"/{OWN_NAME}": machine_of(s.endpoint_gid) for s in own if s.node_name == OWN_NAME}


def _ask_rig_files(node: Node, names: Sequence[str]) -> dict[str, str]:
    """Return the rig file parameter of each node. One parameter a request: an unknown one empties the whole answer."""
    files = {}
    for parameter, asked in ((RIG_PARAMETER, [n for n in names if n != ICP]), (ICP_RIG_PARAMETER, [ICP])):
        requests = {n + GET_PARAMETERS: GetParameters.Request(names=[parameter]) for n in asked if n in names}
        for service, reply in call_all(node, GetParameters, requests, ANSWER_S, repeatable=True).items():
            if reply is not None and reply.values and reply.values[0].string_value:
                files[service.removesuffix(GET_PARAMETERS)] = reply.values[0].string_value
    return files


class AnnouncementListener:
    """Collects announcements in every ROS domain while it is open; ``loopback_only`` joins no other interface."""

    def __init__(self, loopback_only: bool) -> None:
        addresses = [LOOPBACK] if loopback_only else [LOOPBACK, *(i.address for i in collect_interfaces() if i.up)]
        self._sockets = {}
        for domain in range(HIGHEST_DOMAIN + 1):
            with contextlib.suppress(OSError):  # another program holds the port
                self._sockets[_listener(domain, addresses)] = domain
        self._heard: set[Announcement] = set()
        self._closing = threading.Event()
        self._thread = threading.Thread(target=self._run, name="announcements", daemon=True)

    @property
    def heard(self) -> tuple[Announcement, ...]:
        """The announcements so far, in order of domain and address."""
        return tuple(sorted(set(self._heard), key=lambda one: (one.domain, one.address, one.machine)))

    def __enter__(self) -> AnnouncementListener:
        self._thread.start()
        return self

    def __exit__(self, *error: object) -> None:
        self._closing.set()
        self._thread.join()
        for link in self._sockets:
            link.close()

    def _run(self) -> None:
        while not self._closing.is_set():
            ready, _, _ = select.select(list(self._sockets), [], [], ANNOUNCEMENT_POLL_S)
            for link in ready:
                packet, (address, _) = link.recvfrom(PACKET_BYTES)
                if packet.startswith(MAGIC):
                    self._heard.add(Announcement(self._sockets[link], address, machine_of(packet[PREFIX])))


def _listener(domain: int, addresses: Sequence[str]) -> socket.socket:
    link = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    try:
        link.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        link.bind((GROUP, FIRST_PORT + DOMAIN_PORTS * domain))
        for address in addresses:
            with contextlib.suppress(OSError):  # an interface without multicast
                link.setsockopt(
                    socket.IPPROTO_IP, socket.IP_ADD_MEMBERSHIP, socket.inet_aton(GROUP) + socket.inet_aton(address)
                )
    except OSError:
        link.close()
        raise
    return link
