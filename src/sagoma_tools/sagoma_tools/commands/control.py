"""``sagoma start | suspend | stop``: drive the lifecycle of a graph that is already running, wherever its nodes are."""

from __future__ import annotations

import argparse

from rclpy.node import Node

from capture_rig.errors import InputError
from sagoma_bringup.graph import CAMERA_NODE, SERVER_NODES

from ..graph.lifecycle_client import LifecycleClient, State
from ..graph.ros_link import RosLink, settled

# verb -> (the state it leads to, whether the cameras go first, help)
VERBS = {
    "start": (State.ACTIVE, False, "configure and activate every node of the running graph"),
    "suspend": (State.INACTIVE, True, "deactivate every node of the running graph; start goes on from there"),
    "stop": (State.UNCONFIGURED, True, "deactivate and clean up every node of the running graph; processes stay"),
}


def add_parser(subparsers: argparse._SubParsersAction) -> None:
    """Add the three subcommands."""
    for verb, (goal, cameras_first, help_text) in VERBS.items():
        parser = subparsers.add_parser(verb, help=help_text)
        parser.add_argument("--expect", type=int, default=1, help="wait until so many nodes of ours are there")
        parser.add_argument("--wait", type=float, default=5.0, help="... but no longer than this, in seconds")
        parser.add_argument("--timeout", type=float, help="seconds to wait for each answer")
        parser.set_defaults(run=run, goal=goal, cameras_first=cameras_first, verb=verb)


def run(args: argparse.Namespace) -> int:
    """Bring every node of ours to the verb's state; 1 when one of them refused or did not answer."""
    with RosLink("sagoma_control") as link:
        names = discover(link.node, args.expect, args.wait)
        server = [name for name in names if not is_camera(name)]
        cameras = [name for name in names if is_camera(name)]
        groups = [cameras, server] if args.cameras_first else [server, cameras]
        client = LifecycleClient(link.node)
        outcome = client.bring(groups, args.goal, args.timeout)
        states = client.states(names)
    for name in names:
        print(f"{name}: {states[name] or 'did not answer'}")
    for failure in outcome.failures:
        print(f"failed: {failure}")
    return 0 if outcome.ok else 1


def discover(node: Node, expect: int, wait_s: float) -> list[str]:
    """Full names of our lifecycle nodes, once ``expect`` are there and no more have joined for a second.

    Discovery has no end: what has not announced itself within ``wait_s`` is not seen. InputError when that is too few.
    """

    def ours() -> set[str]:
        return {
            f"{namespace.rstrip('/')}/{name}"
            for name, namespace in node.get_node_names_and_namespaces()
            if name in (CAMERA_NODE, *SERVER_NODES)
        }

    found = settled(ours, expect, wait_s)
    if len(found) < expect:
        raise InputError(
            f"found {len(found)} nodes of ours, expected {expect}",
            where="the ROS graph",
            remedy="Start them, or check ROS_DOMAIN_ID and ROS_AUTOMATIC_DISCOVERY_RANGE.",
        )
    return found


def is_camera(full_name: str) -> bool:
    """Is this the node of a camera PC?"""
    return full_name.endswith(f"/{CAMERA_NODE}")
