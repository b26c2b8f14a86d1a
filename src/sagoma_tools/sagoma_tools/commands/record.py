"""``sagoma record``: record a graph that is already running into a rosbag2 bag (mcap)."""

from __future__ import annotations

import argparse
from pathlib import Path

from capture_rig.rig import load_rig
from sagoma_bringup.graph import CAMERA_NODE, SERVER_NODES

from ..arguments import StopOnSignal
from ..graph.ros_link import RosLink
from ..graph.topics import DIAGNOSTICS, OUTPUT_TOPICS, camera_topics
from ..recording.recorder import Recorder, read_configuration

PARAMETERS_TIMEOUT_S = 2.0


def add_parser(subparsers: argparse._SubParsersAction) -> None:
    """Add the subcommand."""
    parser = subparsers.add_parser("record", help="record the running graph into a rosbag2 bag (mcap) until Ctrl-C")
    parser.add_argument("bag", help="folder to make")
    parser.add_argument("--rig", help="rig YAML: record its cameras from the first frame on, and copy it into the bag")
    parser.add_argument("--no-diagnostics", action="store_true", help="leave /diagnostics out")
    parser.add_argument("--seconds", type=float, help="stop after so long (default: run until Ctrl-C)")
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Record until stopped; cameras that the rig does not name are found as they appear."""
    cameras = load_rig(args.rig).names if args.rig else ()
    topics = [*(topic for camera in cameras for topic in camera_topics(camera)), *OUTPUT_TOPICS]
    with StopOnSignal() as stop, RosLink("sagoma_recorder") as link:
        recorder = Recorder(link.node, args.bag, topics if args.no_diagnostics else [*topics, DIAGNOSTICS])
        recorder.follow_cameras()
        print(f"recording into {args.bag}; Ctrl-C ends it", flush=True)
        stop.wait(args.seconds)
        nodes = [
            f"{namespace.rstrip('/')}/{name}"
            for name, namespace in link.node.get_node_names_and_namespaces()
            if name in (CAMERA_NODE, *SERVER_NODES)
        ]
        configuration = read_configuration(link.node, nodes, PARAMETERS_TIMEOUT_S)
        counts = recorder.close({"graph": configuration}, Path(args.rig) if args.rig else None)
    for name, count in sorted(counts.items()):
        print(f"{count:7d}  {name}")
    return 0
