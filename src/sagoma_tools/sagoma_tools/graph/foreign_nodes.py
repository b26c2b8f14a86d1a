"""Finds nodes of the same names on other machines, before anything is asked of a name that two nodes have.

A service request goes to whoever offers that service: without this look, a second server started on another machine
would drive the first one's nodes. Fast DDS puts a number of the machine into every GUID; where the middleware is
another one, machines are unknown, and nobody is foreign.
"""

from __future__ import annotations

import uuid
from collections.abc import Iterable, Mapping

from rclpy.node import Node
from std_msgs.msg import Empty

from ..doctor.machine.announcements import machine_of

COMMON_TOPIC = "/parameter_events"  # every node publishes there


def machines_of(node: Node) -> dict[str, set[str]]:
    """Return on which machines the nodes of each fully qualified name run, as known so far."""
    found: dict[str, set[str]] = {}
    for one in node.get_publishers_info_by_topic(COMMON_TOPIC):
        name = f"{one.node_namespace.rstrip('/')}/{one.node_name}"
        found.setdefault(name, set()).add(machine_of(one.endpoint_gid))
    return found


def own_machine(node: Node) -> str:
    """Return the machine on which this node runs; empty where it is not known."""
    topic = f"/{node.get_name()}/machine_{uuid.uuid4().hex}"  # of nobody else, though other nodes have its name
    publisher = node.create_publisher(Empty, topic, 1)
    try:
        return next((machine_of(one.endpoint_gid) for one in node.get_publishers_info_by_topic(topic)), "")
    finally:
        node.destroy_publisher(publisher)


def foreign_names(machines: Mapping[str, set[str]], here: str, names: Iterable[str]) -> tuple[list[str], list[str]]:
    """Return which of ``names`` nodes on other machines than ``here`` have, and which no node has yet.

    machines : of each name, as :func:`machines_of` returns them.
    """
    known = {name: machines.get(name, set()) for name in names}
    foreign = [name for name, places in known.items() if here and places - {here, ""}]
    return foreign, [name for name, places in known.items() if not places]
