"""Finds nodes of a graph's names that other processes run, on any machine, before anything is asked of them.

A service request goes to whoever offers that service: without this look, a second graph would drive the first one's
nodes. Fast DDS puts a number of the machine and of the process into every GUID, by which a supervisor knows its own;
with another middleware both are unknown, and a name is foreign once two nodes have it.
"""

from __future__ import annotations

import threading
import time
import uuid
from collections.abc import Collection, Mapping, Sequence
from typing import NamedTuple

from rclpy.node import Node
from std_msgs.msg import Empty

from .lifecycle_client import LifecycleClient
from .ros_link import ANSWER_S, ASK_S, DISCOVERY_S, LOOK_S, settled

COMMON_TOPIC = "/parameter_events"  # every node publishes there
LEASE_S = 25.0  # a process that died without goodbye is forgotten by then: Fast DDS's 20 s, and some to look
PID = slice(4, 6)  # of a GUID of Fast DDS: the low 16 bits of the process's number, the lowest byte first
PID_BITS = 0xFFFF


class Place(NamedTuple):
    """Where a node runs: the middleware's number of the machine, "" where unknown, and of the process (its 16 bits)."""

    machine: str
    process: int


FAST_DDS = b"\x01\x0f"  # the vendor's number, with which its GUIDs begin; the next two bytes are the machine's


def machine_of(gid: Sequence[int]) -> str:
    """Return the machine's number in a GUID, where the middleware is Fast DDS; else ""."""
    prefix = bytes(gid[:4])
    return prefix[2:].hex() if prefix[:2] == FAST_DDS else ""


def places_of(node: Node) -> dict[str, list[Place]]:
    """Return where the nodes of each fully qualified name run, as known so far."""
    found: dict[str, list[Place]] = {}
    for one in node.get_publishers_info_by_topic(COMMON_TOPIC):
        name = f"{one.node_namespace.rstrip('/')}/{one.node_name}"
        found.setdefault(name, []).append(place_of(one.endpoint_gid))
    return found


def place_of(gid: Sequence[int]) -> Place:
    """Return what a GUID says of where its owner runs."""
    return Place(machine_of(gid), int.from_bytes(bytes(gid[PID]), "little"))


def own_machine(node: Node) -> str:
    """Return the machine on which this node runs; empty where it is not known."""
    topic = f"/{node.get_name()}/machine_{uuid.uuid4().hex}"  # of nobody else, though other nodes have its name
    publisher = node.create_publisher(Empty, topic, 1)
    try:
        return next((machine_of(one.endpoint_gid) for one in node.get_publishers_info_by_topic(topic)), "")
    finally:
        node.destroy_publisher(publisher)


def living_nodes(node: Node, names: Collection[str], cancel: threading.Event) -> dict[str, list[Place]]:
    """Return where nodes of these names run, before any of our own does.

    Not those that end within ANSWER_S; who answers nothing may have died, and has until LEASE_S to be forgotten.
    """

    def look() -> dict[str, list[Place]]:
        return {name: places for name, places in places_of(node).items() if name in names}

    settled(lambda: set(look()), 0, DISCOVERY_S)
    lifecycle, start_s = LifecycleClient(node), time.monotonic()
    while (found := look()) and not cancel.is_set():
        passed_s = time.monotonic() - start_s
        if passed_s > LEASE_S or (passed_s > ANSWER_S and any(lifecycle.states(found, ASK_S).values())):
            break
        cancel.wait(LOOK_S)
    return found


def foreign_nodes(
    found: Mapping[str, Sequence[Place]], here: str, pids: Mapping[str, int]
) -> tuple[dict[str, list[Place]], list[str]]:
    """Return where other processes than ours run nodes of our names, and the names of ours that are not known yet.

    found : as :func:`places_of` returns it. here : this machine. pids : of our processes, by the names of their nodes.
    """
    foreign, unknown = dict[str, list[Place]](), list[str]()
    for name, pid in pids.items():
        places = list(found.get(name, ()))
        own = Place(here, pid & PID_BITS) if here else Place("", places[0].process if places else 0)
        if own in places:
            places.remove(own)
        else:
            unknown.append(name)
        if places:
            foreign[name] = places
    return foreign, unknown


def run_already(foreign: Mapping[str, Sequence[Place]], here: str) -> str:
    """Say which nodes run already, where, and what to do about it."""
    machines = {place.machine for places in foreign.values() for place in places}
    where = "" if not here else " on this machine" if machines <= {here, ""} else " on another machine"
    remedy = "End that graph, or give this one another ROS_DOMAIN_ID (or, launched, a namespace:=NAME)"
    return f"{', '.join(sorted(foreign))} run already in this ROS domain{where}. {remedy}."
