"""The namespace in which a tool looks for the graph: its own node stands there, as the graph's nodes do.

A graph that was launched with ``namespace:=studio`` has its topics, services and nodes below ``/studio``. Tools name
them as they are without one, ``/mocap/state``; a bag holds these names, so that a take is read, exported and replayed
whatever the namespace was. Names that ROS shares between all graphs stay as they are.
"""

from __future__ import annotations

import argparse

from rclpy.exceptions import InvalidNamespaceException
from rclpy.node import Node
from rclpy.validate_namespace import validate_namespace

from capture_rig.errors import InputError

SHARED = ("/diagnostics", "/tf", "/tf_static", "/clock", "/rosout", "/parameter_events")
"""Topics that nodes of every namespace name from the root."""


def add_namespace_argument(parser: argparse.ArgumentParser) -> None:
    """--namespace: of the graph; :func:`namespace_argument` reads it."""
    text = "of the graph, as it was launched with (namespace:=studio); default: that of a graph without one"
    parser.add_argument("--namespace", default="", metavar="NAME", help=text)


def namespace_argument(args: argparse.Namespace) -> str:
    """Return the namespace asked for as ROS writes it, "/studio", and "" for none. Raises InputError for no name."""
    given = str(getattr(args, "namespace", "")).strip("/")
    try:
        validate_namespace(f"/{given}")
    except InvalidNamespaceException as error:
        remedy = "Give letters, digits and underscores, as in the launch file: --namespace studio."
        raise InputError(f"'{given}' is no namespace: {error}", where="--namespace", remedy=remedy) from None
    return f"/{given}" if given else ""


def namespace_of(node: Node) -> str:
    """Return the namespace that a node stands in, "/studio"; "" for none."""
    return str(node.get_namespace()).rstrip("/")


def below(node: Node, full_name: str) -> bool:
    """Is this full name of a node or topic in the node's namespace, or below it?"""
    return full_name.startswith(f"{namespace_of(node)}/")


def in_graph(node: Node, name: str) -> str:
    """Return the full name of a topic, named as it is in a graph without a namespace."""
    return name if name in SHARED else namespace_of(node) + name


def topics_of(node: Node) -> dict[str, str]:
    """Return the topics of the node's namespace and those that all share, named as without one: name -> type."""
    found = {}
    for full_name, (msgtype, *_) in node.get_topic_names_and_types():
        if full_name in SHARED:
            found[full_name] = msgtype
        elif below(node, full_name):
            found[full_name.removeprefix(namespace_of(node))] = msgtype
    return found
